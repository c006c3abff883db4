"""Formulas of coefficients are read from NGSolve and enclosed on facets."""

import numpy as np
import pytest
from ngsolve import (
    CF,
    ET,
    H1,
    BSpline,
    GridFunction,
    IfPos,
    InnerProduct,
    IntegrationRule,
    Norm,
    Parameter,
    cos,
    exp,
    floor,
    log,
    sin,
    specialcf,
    sqrt,
    x,
    y,
    z,
)

from ngepc.discretisation.enclosed_gaps import _facets_of
from ngepc.discretisation.formulas import formula_of, formula_on
from ngepc.geometries import block
from ngepc.model.obstacles import Cylinder, Disc, Plane, SignedDistance, Sphere

SQUARE = block.structured_mesh(5, 5, simplices=True)
CUBE = block.structured_mesh(3, 3, 3, simplices=True)
SPLINE = BSpline(2, [-1, -1, 0, 1, 2, 2], [0.0, 1.0, 1.4, 1.8, 2.0])
LEFT = Parameter(0.3)
PLANE = {
    "root": 1 - sqrt(2 - (x - 0.3) ** 2),
    "kink": sqrt((x - 0.55) ** 2),
    "waves": 0.3 * sin(7 * x) / (1 + y) ** 2 + LEFT - cos(3 * x * y),
    "powers": (x + 1) ** 3.5 - (x - 0.4) ** 3 + (2 + x) ** -1,
    "exponentials": exp(-3 * x) * log(x + 0.5),
    "norm": Norm(CF((x - 0.2, y + 1))) - InnerProduct(CF((x, y)), CF((y, 2))),
    "spike": IfPos(0.01 - sqrt((x - 0.55) ** 2), 1.0, x),
    "step": IfPos(x - 0.5, 1 + x, sin(x)),
    "disc": Disc((0.5, 2.0), 1.0).gap(SQUARE, motion=(0, -LEFT)),
    "small disc": Disc((0.5, 1.2), 0.15).gap(SQUARE),
    "plane": Plane((0.0, 1.1), (0.1, -1.0)).gap(SQUARE),
    "distance": SignedDistance(sqrt((x - 0.5) ** 2 + (y - 2) ** 2) - 1).gap(SQUARE),
}
SPACE = {
    "root": 1 - sqrt(1 - (x - 0.5) ** 2 - (y - 0.5) ** 2),
    "waves": sin(3 * x * y) * exp(-z),
    "sphere": Sphere((0.5, 0.5, 2.0), 1.0).gap(CUBE, motion=(0, 0, -0.03)),
    "small sphere": Sphere((0.4, 0.5, 1.1), 0.2).gap(CUBE),
    "cylinder": Cylinder((0.5, 0.5, 2.0), (1, 0.2, 0), 1.0).gap(CUBE),
}
GAPS = [(SQUARE, gap) for gap in PLANE.values()]
GAPS += [(CUBE, gap) for gap in SPACE.values()]
NAMES = [f"{name}, plane" for name in PLANE] + [f"{name}, space" for name in SPACE]
RULES = {2: IntegrationRule(ET.SEGM, 40), 3: IntegrationRule(ET.TRIG, 20)}


def sampled(mesh, value):
    """Values at many points of the facets of the contact boundary, (facets, points)."""
    rule = RULES[mesh.dim]
    shape = ET.SEGM if mesh.dim == 2 else ET.TRIG
    points = mesh.MapToAllElements({shape: rule}, mesh.Boundaries("contact"))
    return np.asarray(value(points)).reshape(-1, len(rule))


@pytest.mark.parametrize(("mesh", "gap"), GAPS, ids=NAMES)
def test_enclosures_contain_dense_samples(mesh, gap):
    (facets,) = _facets_of(mesh, "contact")
    whole = formula_on(formula_of(gap), facets).whole
    values = sampled(mesh, gap)
    rounding = 1e-13 * np.abs(values).max()
    assert whole.finite.all()
    assert (values >= whole.low[:, None] - rounding).all()
    assert (values <= whole.high[:, None] + rounding).all()


@pytest.mark.parametrize(("mesh", "gap"), GAPS, ids=NAMES)
def test_second_derivatives_contain_differences(mesh, gap):
    """Second differences along each edge are means of second derivatives."""
    (facets,) = _facets_of(mesh, "contact")
    jet = formula_on(formula_of(gap), facets)
    if jet.second is None:
        return
    corners = np.eye(mesh.dim)[:, :-1]
    count = 20
    places = np.linspace(0, 1, count + 1)
    compared = 0
    for i in range(mesh.dim):
        for j in range(i):
            along = corners[i] - corners[j]
            line = corners[j] + places[:, None] * along
            line = 0.9 * line + 0.1 / mesh.dim  # inside the facet
            values = np.array(_on_lines(mesh, gap, line))
            bends = np.diff(values, 2, axis=1) * (count / 0.9) ** 2
            parts = along[:, None] * along
            with np.errstate(invalid="ignore"):
                low = jet.second.low * parts
                high = jet.second.high * parts
            least = np.minimum(low, high).sum(axis=(1, 2))
            most = np.maximum(low, high).sum(axis=(1, 2))
            smooth = jet.is_smooth
            rounding = 1e-11 * np.abs(values).max() * count**2
            assert (bends[smooth] >= least[smooth, None] - rounding).all()
            assert (bends[smooth] <= most[smooth, None] + rounding).all()
            compared += smooth.sum()
    assert compared > 0


def _on_lines(mesh, value, line):
    rule = IntegrationRule([tuple(p) for p in line.tolist()], [0.0] * len(line))
    shape = ET.SEGM if mesh.dim == 2 else ET.TRIG
    points = mesh.MapToAllElements({shape: rule}, mesh.Boundaries("contact"))
    return np.asarray(value(points)).reshape(-1, len(line))


@pytest.mark.parametrize(
    "value",
    [
        SPLINE(x),
        floor(10 * x),
        sqrt(1 + x).Compile(),
        sqrt(1 + GridFunction(H1(SQUARE))),
        sqrt(1 + x * specialcf.mesh_size),
    ],
)
def test_what_is_not_known_by_name_is_no_formula(value):
    assert formula_of(value) is None


def test_a_parameter_has_its_present_value():
    height = Parameter(1.0)
    gap = sqrt(1 + x) * height
    (facets,) = _facets_of(SQUARE, "contact")
    before = formula_on(formula_of(gap), facets).whole
    height.Set(3.0)
    after = formula_on(formula_of(gap), facets).whole
    assert after.low == pytest.approx(3 * before.low, rel=1e-13)


def test_derivatives_of_a_parabola_are_exact():
    (facets,) = _facets_of(SQUARE, "contact")
    jet = formula_on(formula_of(3 * x * x - x), facets)
    assert jet.second.low == pytest.approx(6 / 25, rel=1e-13)
    assert jet.second.high == pytest.approx(6 / 25, rel=1e-13)


def test_nothing_is_known_of_derivatives_at_a_step():
    (facets,) = _facets_of(SQUARE, "contact")
    for gap in (PLANE["step"], PLANE["kink"], PLANE["spike"]):
        jet = formula_on(formula_of(gap), facets)
        assert (~jet.is_smooth).sum() == 1


def test_a_step_at_a_vertex_is_none_on_facets():
    (facets,) = _facets_of(SQUARE, "contact")
    for sign in (1, -1):
        gap = IfPos(sign * (x - 0.2), sin(x), 2.0)
        assert formula_on(formula_of(gap), facets).is_smooth.all()


def test_a_condition_that_is_zero_on_a_part_of_a_facet_is_undecided():
    (facets,) = _facets_of(SQUARE, "contact")
    flat = IfPos(x - 0.5, x - 0.5, 0.0)  # zero on the left
    whole = formula_on(formula_of(IfPos(flat, 1.0, 2.0)), facets).whole
    assert (whole.high == 2.0).sum() == 3
    assert (whole.low == 1.0).sum() == 3


def test_derivatives_in_a_part_of_a_facet_say_nothing_about_its_corners():
    """On the right half the fourth power is flat, on the left it is steep."""
    mesh = block.structured_mesh(1, 1, simplices=True)
    (facets,) = _facets_of(mesh, "contact")
    right = x - 0.5
    gap = IfPos(right, -right - (right - 0.5) ** 4, -0.5)
    whole = formula_on(formula_of(gap), facets).whole
    assert whole.high >= -0.0625  # its limit in the middle, from the right
