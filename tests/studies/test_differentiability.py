"""Definition 6.1 along shrinking directions; Newton counts without the Tichonov term."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from ngsolve import CF, Integrate

from ngepc import Coupled, NewtonOptions, lshape_problem, semismooth_newton
from ngepc.__main__ import main
from ngepc.geometries import lshape
from ngepc.studies.convergence import WITHOUT, with_and_without
from ngepc.studies.differentiability import (
    FAMILIES,
    difference_quotients,
    direction,
    graded_mesh,
    quotients,
)


@pytest.fixture(scope="module")
def rows():
    return difference_quotients(6)


def column(rows, family, name):
    return np.array([row[name] for row in rows if row["family"] == family])


def test_plateaus_show_that_L2_is_not_enough(rows):
    """||h||_L2 -> 0 while the L2 quotient does not move: M is not Newton differentiable there."""
    assert (
        column(rows, "plateau", "h_L2")[-1] < 0.04 * column(rows, "plateau", "h_L2")[0]
    )
    quotients = column(rows, "plateau", "L2_L2")
    assert quotients == pytest.approx(quotients[0], rel=1e-3)
    assert quotients[0] > 0.3
    # such a sequence is no small direction in H1: its norm is that of the dilated function
    assert column(rows, "plateau", "h_H1") == pytest.approx(
        column(rows, "plateau", "h_H1")[0], rel=1e-3
    )


def test_norm_gap_L6_to_L2(rows):
    """Lemma 6.3, 3 s = p = 6: the quotient falls as r^(1 - 1/3) on discs of radius r."""
    norms, quotients = (column(rows, "plateau", name) for name in ("h_L6", "L6_L2"))
    assert norms[-1] < 0.4 * norms[0]
    rates = [np.log2(a / b) for a, b in pairwise(quotients)]
    assert rates == pytest.approx([2 / 3] * len(rates), abs=0.01)


def test_directions_in_H1(rows):
    """Along a null sequence of H1 the quotient H1 -> H^-1 goes to zero, and faster than ||h||."""
    norms, quotients = (column(rows, "log", name) for name in ("h_H1", "H1_dual"))
    assert all(b < a for a, b in pairwise(norms))
    assert norms[-1] < 0.45 * norms[0]
    assert all(b < a for a, b in pairwise(quotients))
    assert quotients[-1] < 0.55 * quotients[0]
    factors = [b / a for a, b in pairwise(quotients)]
    assert factors[-1] < factors[0]
    radii = column(rows, "log", "radius")
    potential = 0.5 * np.sqrt(2 * np.pi / np.log(0.25 / radii))
    assert norms[2:] == pytest.approx(potential[2:], rel=0.03)


def test_L2_quotients_of_the_log_family_do_not_vanish(rows):
    """The same null sequence of H1 as seen by L2: no decrease over these radii."""
    assert column(rows, "log", "L2_L2").min() > 0.3


@pytest.mark.parametrize("family", FAMILIES)
def test_fixed_direction_is_harmless(family):
    """Along t h with h fixed even L2 -> L2 falls like t: it takes concentration to fail."""
    q, found = CF((1.0, 0.0)), []
    for t in (1e-1, 1e-2, 1e-3):
        h = direction(graded_mesh(2), FAMILIES[family], 0.125)
        h.vec.FV().NumPy()[:] *= 2 * t
        found.append(quotients(q, h)["L2_L2"])
    for coarse, fine in pairwise(found):
        assert np.log10(coarse / fine) == pytest.approx(1, abs=0.06)


def test_graded_mesh_covers_the_square():
    mesh = graded_mesh(3)
    assert Integrate(CF(1.0), mesh) == pytest.approx(1.0, rel=1e-12)
    sizes = np.array(Integrate(CF(1.0), mesh, element_wise=True))
    assert sizes.min() < sizes.max() / 50
    assert mesh.nv < 600


@pytest.fixture(scope="module")
def counts():
    problems = [lshape_problem(lshape.paper_mesh(n)) for n in (113, 417)]
    return [
        with_and_without(p, 1e4, NewtonOptions(quadrature_points=25)) for p in problems
    ]


def test_counts_grow_without_the_tichonov_term(counts):
    """With the term 1.3 times as many steps on four times as many nodes; without 1.8 times."""
    assert all(row["status"] == row["status_without"] == "converged" for row in counts)
    growth, growth_without = (
        counts[-1][f"iterations{suffix}"] / counts[0][f"iterations{suffix}"]
        for suffix in ("", "_without")
    )
    assert growth < 1.5
    assert growth_without > 1.5
    for row in counts:
        assert row["iterations_without"] > 2.5 * row["iterations"]
        assert row["halvings_without"] > 3 * row["halvings"]


def test_dropped_term_does_not_act():
    """gamma_T = 1e12 or 1e14: the same V to seven digits."""
    problem = lshape_problem(lshape.paper_mesh(65))
    problem = replace(problem, gap=0.12)
    values = [
        semismooth_newton(
            problem, regularisation=Coupled(1e2, gamma_tichonov=gamma_T)
        ).dual_energy
        for gamma_T in (WITHOUT, 100 * WITHOUT)
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-7)


@pytest.mark.parametrize("levels", [0, 13, 2.5])
def test_illegal_levels_are_refused(levels):
    with pytest.raises((ValueError, TypeError), match=f"levels={levels}"):
        difference_quotients(levels)


@pytest.mark.parametrize(
    "words",
    [["differentiability", "--levels", "2"], ["without_tichonov", "--nodes", "33"]],
)
def test_studies_write_their_tables(words, tmp_path):
    assert main(["study", *words, "--out", str(tmp_path)]) == 0
    head = (tmp_path / f"{words[0]}.md").read_text().splitlines()[2]
    columns = {
        "differentiability": "| L6_L2 |",
        "without_tichonov": "| iterations_without |",
    }
    assert columns[words[0]] in head
