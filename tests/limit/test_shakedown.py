"""Shakedown: closed forms, Bree's plate, a plate with a hole, and both theorems by other means."""

import math

import numpy as np
import pytest
from ngsolve import (
    CF,
    ET,
    VOL,
    Grad,
    InnerProduct,
    IntegrationRule,
    LinearForm,
    Sym,
    VectorH1,
    dx,
    y,
)

from ngepc import LimitStatus, Problem, limit_load, shakedown_load
from ngepc.geometries import block
from ngepc.limit.cycles import largest_spread
from ngepc.limit.shakedown import checked_vertices
from ngepc.studies.shakedown_problems import (
    YOUNG,
    bree_problem,
    bree_vertices,
    holed_plate,
    steel,
)


def heated(kinematics, **loads):
    """A square between two walls, warmer at the top than at the bottom."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None), "right": (0, None)}
    strain = {"initial_strain": 2 * (y - 0.5) / YOUNG}
    given = {"prescribed": supports, "kinematics": kinematics}
    return Problem(mesh, steel(0.3), None, **given, **strain, **loads)


@pytest.mark.parametrize(("tension", "thermal"), [(0.8, 0.8), (0.3, 2.0), (0.0, 1.0)])
def test_bree(tension, thermal):
    """Bree, J. Strain Analysis 2 (1967): X + Y / 4 <= 1 (ratchetting), Y <= 2 (alternation)."""
    found = shakedown_load(bree_problem(), bree_vertices(tension, thermal))
    ratchets = 1 / (tension + thermal / 4)
    alternates = 2 / thermal
    exact = min(ratchets, alternates)
    assert found.exact
    assert "guaranteed" in found.message
    assert found.status is LimitStatus.REACHED
    assert found.lower <= exact * (1 + 1e-12)
    assert found.upper >= exact
    assert found.lower == pytest.approx(exact, rel=1e-4)
    assert found.alternating == pytest.approx(alternates, rel=1e-9)
    assert found.alternates == (alternates <= ratchets)


def test_residual_stresses_are_admissible():
    """In equilibrium without loads, and with alpha (X + Y y) within the yield stress, to 1e-12."""
    tension = 0.8
    thermal = 0.8
    found = shakedown_load(bree_problem(), bree_vertices(tension, thermal), 0.05)
    held = {"dirichletx": "left", "dirichlety": "guide"}
    space = VectorH1(found.mesh, order=3, **held)
    w = space.TestFunction()
    form = LinearForm(InnerProduct(found.residual_stress, Sym(Grad(w))) * dx).Assemble()
    free = np.array(list(space.FreeDofs()), dtype=bool)
    assert np.abs(form.vec.FV().NumPy()[free]).max() < 1e-12
    points = found.mesh.MapToAllElements({ET.TRIG: IntegrationRule(ET.TRIG, 4)}, VOL)
    inside = np.asarray(found.mesh.MaterialCF({"plate": 1.0}, default=0.0)(points)) > 0
    cold = CF((tension, 0, 0, 0), dims=(2, 2))
    hot = CF((tension + thermal * y, 0, 0, 0), dims=(2, 2))
    for elastic in (cold, hot):
        s = found.lower * elastic + found.residual_stress
        square = s[0, 0] ** 2 - s[0, 0] * s[1, 1] + s[1, 1] ** 2 + 3 * s[0, 1] ** 2
        values = np.asarray(square(points))[inside]
        assert values.max() <= 1 + 1e-12


@pytest.mark.parametrize("pressure", [0.0, 0.9])
def test_clamped_sheet(pressure):
    """Stresses t and t + Y along it within the ellipse of yield: Y^2 + 3 P^2 <= 4."""
    problem = heated("plane stress", traction={"contact": (0, 1.0)})
    cold = {"contact": pressure}
    hot = {"contact": pressure, "initial_strain": 1.0}
    found = shakedown_load(problem, [cold, hot])
    exact = 2 / math.sqrt(1 + 3 * pressure**2)
    assert found.exact
    assert found.lower == pytest.approx(exact, rel=1e-6)
    assert exact <= found.upper <= 1.01 * found.lower


def test_loads_without_a_factor_stay():
    """The same sheet; the factor multiplies the temperature alone."""
    problem = heated("plane stress", traction={"contact": (0, 0.9)})
    found = shakedown_load(problem, {"initial_strain": (0, 1)}, 0.05)
    exact = 2 * math.sqrt(1 - 0.75 * 0.9**2)
    assert found.lower == pytest.approx(exact, rel=1e-6)
    assert exact <= found.upper <= 1.05 * found.lower


@pytest.mark.parametrize(("top", "right"), [((0, 1), (0, 1)), ((0, 1), (-1, 1))])
def test_loads_that_share_a_key_vary_apart(top, right):
    """A sheet with s_x = -a r, s_y = -a t: a is 1 over the largest (r^2 - r t + t^2)^(1/2)."""
    supports = {"left": (0, None), "clamped": (None, 0)}
    given = {"clamped": None, "prescribed": supports, "kinematics": "plane stress"}
    mesh = block.structured_mesh(2, 2, simplices=True)
    pressed = Problem(mesh, steel(0.3), pressure={"contact|right": 1.0}, **given)
    found = shakedown_load(pressed, {"contact": top, "right": right})
    exact = 1 / max(math.sqrt(r * r - r * t + t * t) for t in top for r in right)
    assert found.exact
    assert found.lower <= exact * (1 + 1e-12)
    assert found.upper >= exact * (1 - 1e-12)
    assert found.relative_width < 0.01


@pytest.mark.parametrize(("right", "exact"), [((0, 0), 2.0), ((0, 1), 1.0)])
def test_supports_that_share_a_key_move_apart(right, exact):
    """A bar of unit length, E u = R: plastic strains alternate where E u varies by 2 R."""
    supports = {"left|right": (1 / YOUNG, None), "clamped": (None, 0)}
    mesh = block.structured_mesh(2, 2, simplices=True)
    given = {"clamped": None, "prescribed": supports, "kinematics": "plane stress"}
    stretched = Problem(mesh, steel(0.3), **given)
    found = shakedown_load(stretched, {"left": (0, 1), "right": right})
    assert found.exact
    assert found.lower <= exact * (1 + 1e-12)
    assert found.upper >= exact * (1 - 1e-12)
    assert found.relative_width < 0.01


def test_plane_strain_keeps_the_stress_across():
    """Both stresses along the walls are E eps / (1 - nu): the range is twice the yield stress.

    A limit load may choose sigma_zz for each load; here it is the elastic one and a residual one.
    """
    found = shakedown_load(heated("plane strain"), {"initial_strain": (0, 1)})
    assert found.exact
    assert found.lower == pytest.approx(2 * (1 - 0.3), rel=1e-6)
    assert found.alternates
    assert found.mechanism is None


def test_one_vertex_is_a_limit_load():
    """One load that only grows: residual stresses make all of the stresses in equilibrium."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None)}
    given = {"prescribed": supports, "traction": {"contact": (0, 1.0)}}
    problem = Problem(mesh, steel(0.3), None, **given)
    found = shakedown_load(problem, [{"contact": 1.0}])
    limit = limit_load(problem)
    assert found.exact
    assert found.lower == pytest.approx(limit.lower, rel=1e-6)
    assert found.upper == pytest.approx(limit.upper, rel=1e-6)
    assert found.mechanism is not None


def test_plate_with_a_hole():
    """A fifth as wide as the square plate: an estimate below twice the elastic limit.

    Tabulated values spread: for one load 0.571 to 0.654, for two that vary independently 0.431 to
    0.504 (Belytschko 1972, Corradi and Zavelani 1974, Gross-Weege 1997).  Both are bounded by
    alternation at the hole: 2 over the range of the elastic hoop stress there.
    """
    problem = holed_plate(0.6)
    both = shakedown_load(problem, {"right": (0, 1), "top": (0, 1)}, 0.03)
    one = shakedown_load(problem, {"right": (0, 1), "top": (0, 0)}, 0.06)
    assert not both.exact
    assert both.status is one.status is LimitStatus.REACHED
    assert one.lower == pytest.approx(0.571, rel=0.06)
    assert both.lower == pytest.approx(0.431, rel=0.04)
    assert both.upper < one.upper < 0.8


def test_smallest_balls():
    """Of a segment, and of an equilateral triangle, with its vertices and its centre."""
    turns = 2 * math.pi * np.arange(3) / 3
    corners = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    points = np.concatenate([corners, [[0.0, 0.0]]])[:, None]
    assert 0.99 <= largest_spread(points)[0] <= 1 + 1e-12
    ends = np.array([[[0.0, 0.0]], [[3.0, 4.0]], [[1.5, 2.0]]])
    assert largest_spread(ends)[0] >= 6.25 * 0.99
    assert largest_spread(ends)[0] <= 6.25 * (1 + 1e-12)


def test_vertices_that_are_equal_count_once():
    problem = heated("plane stress", traction={"contact": (0, 1.0)})
    ranges = {"contact": (0, 0), "initial_strain": (0, 1)}
    found = checked_vertices(problem, ranges)
    assert [corner["initial_strain"] for corner in found] == [0, 1]


def test_ranges_are_boxes():
    problem = heated("plane stress", traction={"contact": (0, 1.0)})
    ranges = shakedown_load(
        problem, {"contact": (0, 0.5), "initial_strain": (0, 1)}, 0.1
    )
    corners = [(0, 0), (0, 1), (0.5, 0), (0.5, 1)]
    listed = [{"contact": p, "initial_strain": t} for p, t in corners]
    assert list(ranges.vertices) == listed
    assert shakedown_load(problem, listed, 0.1).lower == ranges.lower


def test_a_plate_that_expands_freely_shakes_down():
    """No stress but rounding: no factor of the temperature is too large."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    given = {"prescribed": {"clamped": (None, 0), "left": (0, None)}}
    given |= {"kinematics": "plane stress", "initial_strain": 1e-3}
    found = shakedown_load(
        Problem(mesh, steel(0.3), None, **given), [{"initial_strain": 1}]
    )
    assert found.status is LimitStatus.UNLIMITED
    assert found.lower == math.inf
    assert "no stresses" in found.message
    assert found.exact


def test_constant_loads_that_are_too_large():
    problem = heated("plane stress", traction={"contact": (0, 3.0)})
    found = shakedown_load(problem, {"initial_strain": (0, 1)})
    assert found.status is LimitStatus.OVERLOADED
    assert "constant loads" in found.message


REFUSED = {
    "'top'": (ValueError, [{"top": 1}]),
    "a real number is needed": (TypeError, [{"initial_strain": "1"}]),
    "a finite number is needed": (ValueError, [{"initial_strain": math.nan}]),
    "smallest and the largest": (TypeError, {"initial_strain": 1}),
    "a load with a factor": (ValueError, [{}]),
    "a mapping of names": (TypeError, ["initial_strain"]),
    "ranges of loads": (TypeError, "initial_strain"),
}


@pytest.mark.parametrize("words", sorted(REFUSED))
def test_vertices_are_checked(words):
    error, vertices = REFUSED[words]
    with pytest.raises(error, match=words):
        shakedown_load(heated("plane stress"), vertices)


def test_solids_and_obstacles_are_refused_by_name():
    solid = block.structured_mesh(1, 1, 1, simplices=True)
    problem = Problem(solid, steel(0.3), "clamped", traction={"contact": (1, 0, 0)})
    with pytest.raises(ValueError, match="solid"):
        shakedown_load(problem, {"contact": (0, 1)})
    touched = heated("plane strain", contact="contact", gap=0.0)
    with pytest.raises(ValueError, match="contact"):
        shakedown_load(touched, {"initial_strain": (0, 1)})


@pytest.mark.parametrize("kinematics", ["plane strain", "plane stress"])
def test_estimates_do_not_exceed_the_limit_load(kinematics):
    """On a few triangles elastic stresses are too small: then bounds of the limit load count.

    The lower number of the estimate was above the limit load.
    """
    mesh = block.structured_mesh(2, 2, simplices=True)
    given = {"traction": {"contact": (1.0, 0.0)}, "kinematics": kinematics}
    problem = Problem(mesh, steel(0.3), "clamped", **given)
    estimate = shakedown_load(problem, {"contact": (0, 1)}, 0.2)
    limit = limit_load(problem, 0.2)
    assert not estimate.exact
    assert "estimate" in estimate.message
    assert estimate.collapses
    assert "limit load" in estimate.message
    assert estimate.lower <= limit.lower
    assert estimate.upper <= limit.upper
    double = shakedown_load(problem, [{"contact": 2.0}], 0.2)
    assert double.lower == pytest.approx(estimate.lower / 2, rel=1e-9)
