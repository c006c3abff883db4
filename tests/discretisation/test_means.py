"""How much of a strip between the integration points is missed."""

import numpy as np
import pytest
from ngsolve import ET, VOL, CoefficientFunction, ElementId, IfPos, exp, sin, sqrt, x, y
from teams import run

from ngepc import Material, Problem, Voce, semismooth_newton
from ngepc.discretisation.means import differing_means
from ngepc.discretisation.sampled import sampled_inside
from ngepc.discretisation.sampling import Scan
from ngepc.geometries import block
from ngepc.model.elements import plastic_points
from ngepc.model.parts import distribute

CELLS = 4
CELL = 1 / CELLS
WIDTH = 0.02
HARD = 1.25
SOFT = 0.2


def strip(middle: float) -> CoefficientFunction:
    """The yield stress of a body with a soft strip of width ``WIDTH``."""
    return IfPos(WIDTH / 2 - sqrt((x - middle) ** 2), SOFT, HARD)


def pressed(*, order: int = 2, simplices: bool = True, **data) -> Problem:
    """A block with these data of its material."""
    given = {
        "lame_lambda": 1e3,
        "lame_mu": 1e3,
        "yield_stress": HARD,
        "hardening": 10.0,
    }
    mesh = block.structured_mesh(CELLS, CELLS, simplices=simplices)
    load = {"contact": (0.1, 0.0)}
    return Problem(mesh, Material.kinematic(**given | data), traction=load, order=order)


def percent_of(text: str) -> float:
    """The number that a sentence gives."""
    return float(text.partition("by up to ")[2].partition(" percent")[0]) / 100


@pytest.mark.parametrize(
    ("simplices", "middle", "share"),
    [(False, 0.37, WIDTH / CELL), (True, 0.43, 2 * WIDTH * (0.43 - CELL) / CELL**2)],
)
def test_a_strip_that_no_point_sees_is_missed_by_its_part(simplices, middle, share):
    """The mean over an element is less by the strip's part of its area times the depth."""
    text = differing_means(
        pressed(simplices=simplices, order=1, yield_stress=strip(middle))
    )
    count = "8 of 32" if simplices else "4 of 16"
    assert text.startswith(f"yield_stress varies inside elements: in {count} the mean")
    assert percent_of(text) == pytest.approx(share * (HARD - SOFT) / HARD, abs=0.002)
    assert f"near ({middle}, " in text


def test_a_strip_that_points_see_counts_too_much():
    """The middle points of nine on a square have 4/9 of the weight."""
    problem = pressed(simplices=False, order=2, yield_stress=strip(1.5 * CELL))
    missed = (4 / 9 - WIDTH / CELL) * (HARD - SOFT) / HARD
    assert percent_of(differing_means(problem)) == pytest.approx(missed, abs=0.007)


def test_the_adaptive_rule_finds_the_same():
    """An oblique strip, with the means of the rule that cuts elements where values differ."""
    value = IfPos(WIDTH - sqrt((x + 0.4 * y - 0.53) ** 2), SOFT, HARD)
    problem = pressed(yield_stress=value)
    scan = Scan(problem.mesh, value, VOL)
    rule = plastic_points(problem.mesh, 2)[ET.TRIG]
    missed = []
    for number in scan.hidden.tolist():
        finer = scan.rule(number)
        mean = finer.weights @ finer.values[:, 0] / finer.weights.sum()
        mapped = problem.mesh.GetTrafo(ElementId(VOL, number))(rule)
        usual = np.average(value(mapped).ravel(), weights=rule.weights)
        missed.append(abs(usual - mean) / HARD)
    assert max(missed) > 0.1
    assert percent_of(differing_means(problem)) == pytest.approx(max(missed), abs=0.01)


def test_smooth_data_need_no_words():
    for value in (1 + 0.5 * sin(6 * x), exp(3 * x), 1 / (1 + x + y)):
        problem = pressed(yield_stress=value)
        assert sampled_inside(problem) == [("yield_stress", value)]
        assert differing_means(problem) == ""


def test_data_of_the_law_count_and_those_of_the_history_do_not():
    soft = strip(0.37)
    law = Voce(HARD, soft, 2.0)
    material = Material(lame_lambda=1e3, lame_mu=1e3, yield_stress=HARD, law=law)
    problem = Problem(pressed().mesh, material, initial_accumulated=soft)
    assert sampled_inside(problem) == [("material.law", soft)]


def test_it_is_looked_at_when_the_message_is_read(monkeypatch):
    """Once, and not while the problem is solved."""
    seen = []

    def looked_at(problem: Problem) -> str:
        seen.append(problem)
        return differing_means(problem)

    monkeypatch.setattr("ngepc.results.result.differing_means", looked_at)
    result = semismooth_newton(pressed(yield_stress=strip(0.37)))
    assert not seen
    assert result.message == result.message
    assert "yield_stress varies inside elements" in result.message
    assert len(seen) == 1


def test_two_processes_say_the_same():
    """The largest value is at a corner, in the part of one of them."""
    problem = pressed(yield_stress=strip(0.43) + IfPos(x + y - 1.9, 1.0, 0.0))

    def said(comm: object) -> str:
        mesh = distribute(problem.mesh if comm.rank == 0 else None, comm)
        return differing_means(Problem(mesh, problem.material))

    whole = differing_means(Problem(problem.mesh, problem.material))
    assert run(2, said) == [whole, whole]
