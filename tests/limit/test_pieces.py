"""Pieces of limit loads beside plain statements: widths, units, moving supports, mechanisms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import ET, IntegrationRule
from scipy.sparse import csr_matrix

from ngepc import LimitStatus, Material, Problem, limit_load
from ngepc.geometries import block
from ngepc.limit.bracket import bracket_on
from ngepc.limit.data import GROWS, STAYS, barycentric
from ngepc.limit.flow_proof import _of_speeds
from ngepc.limit.load import MARKING, Search
from ngepc.limit.outcome import width_of
from ngepc.limit.outline import Outline
from ngepc.limit.reading import growing_names, limit_data
from ngepc.limit.repair import Projection
from ngepc.limit.yielding import SHAPES, SLIP
from ngepc.linalg.bernstein import bernstein_values, multi_indices

CLAY = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=math.sqrt(2), hardening=1.0
)
"""Shear yield stress one."""


def test_widths():
    """(upper - lower) / |lower|; without one of the bounds, or a scale, there is none."""
    assert width_of(2.0, 3.0) == 0.5
    assert width_of(-2.0, -1.0) == 0.5
    for lower, upper in ((0.0, 1.0), (1.0, math.inf), (-math.inf, 1.0)):
        assert width_of(lower, upper) == math.inf


def searched(N, width, tolerance):
    """A search between bounds of this relative width: the share of cells, and whether it ends."""
    cells = SimpleNamespace(N=N)
    search = SimpleNamespace(
        lower=2.0, upper=2.0 + 2.0 * width, tolerance=tolerance, is_last=None
    )
    search.data = SimpleNamespace(cells=cells)
    return Search.share(search), search.is_last


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3])
def test_how_many_cells_are_cut(tolerance):
    """Half of the gap's far from the end; in the plane the next mesh is the last one near to it."""
    for N in (2, 3):
        assert searched(N, math.inf, tolerance)[0] == MARKING
        shares = [searched(N, c * tolerance, tolerance)[0] for c in (1.5, 1.8, 2.0)]
        assert 0.25 <= shares[0] < shares[1] < shares[2] < 0.8
        assert searched(N, 100 * tolerance, tolerance) == (MARKING, False)
    assert searched(2, 3.0 * tolerance, tolerance)[1]
    assert not searched(2, 3.1 * tolerance, tolerance)[1]
    assert not searched(3, 1.5 * tolerance, tolerance)[1]


def test_the_power_of_speeds_is_bounded():
    """By the size of all loads, cell by cell: no less than that of a flow along each of them."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    loads = {"traction": {"right": (3.0, 4.0)}, "body_force": (0.3, -0.4)}
    problem = Problem(mesh, CLAY, "clamped", **loads)
    for growing in (None, ["right"]):
        data = limit_data(problem, growing_names(problem, growing))
        cells = data.cells
        speed = np.random.default_rng(1).uniform(1, 2, len(cells.nodes))
        strained = np.zeros(len(speed))
        found = _of_speeds(data, Outline(cells), speed, strained)
        forces = 0.5 * cells.volume @ speed
        right = [f for f in np.flatnonzero(cells.outer) if data.traction[:, f].any()]
        assert len(right) == 2
        tractions = sum(5 * 0.5 * speed[cells.owners[f, 0]] for f in right)
        powers = {GROWS: tractions, STAYS: 0.0}
        powers[STAYS if growing else GROWS] += forces
        for kind, power in powers.items():
            assert power <= found.power[kind] <= power * (1 + 1e-9)


def test_projections_satisfy_equations_up_to_rounding():
    """Dependent rows among them; the change is the smallest one."""
    random = np.random.default_rng(0)
    A = random.normal(size=(6, 10)) * np.logspace(-3, 3, 6)[:, None]
    A[:, 9] = 0.0
    near = A[1] + 1e-3 * np.linalg.norm(A[1]) * np.append(random.normal(size=9), 0.0)
    A = np.vstack([A, A[0] + 1e-3 * A[1], near])
    solution = random.normal(size=10)
    x = solution + random.normal(size=10)
    projection = Projection(csr_matrix(A), A @ solution)
    found = projection(x)
    assert np.abs(projection.residual(found)).max() < 1e-14 * np.abs(x).max()
    scaled = A / np.linalg.norm(A, axis=1, keepdims=True)
    nearest = x + np.linalg.pinv(scaled, rcond=1e-9) @ (scaled @ (solution - x))
    np.testing.assert_allclose(found, nearest, atol=1e-9)


@pytest.mark.parametrize("loads", [{"traction": 2e-3}, {"body_force": -5e-4}])
def test_numbers_without_units_are_about_one(loads):
    """The largest length, yield bound and load are in [1, 2), also for loads that are small.

    Units are powers of two: numbers keep their digits.
    """
    ((name, size),) = loads.items()
    given = (size, 0.0)
    data = {name: {"right": given} if name == "traction" else given}
    mesh = block.structured_mesh(2, 2, size=(4.0, 1.0), simplices=True)
    names = ("right",) if name == "traction" else (name,)
    plain, unit = limit_data(Problem(mesh, CLAY, "left", **data), names).without_units()
    assert 1 <= np.ptp(plain.cells.points, axis=0).max() < 2
    assert 1 <= plain.bound.max() < 2
    largest = max(np.abs(plain.force[GROWS]).max(), np.abs(plain.traction[GROWS]).max())
    assert 1 <= largest < 2
    assert math.log2(unit) == int(math.log2(unit))
    stress = math.sqrt(2) / plain.bound.max()
    load = abs(size) * (4.0 if name == "body_force" else 1.0)
    assert unit * load / largest == pytest.approx(stress)


def test_a_smooth_plate_moves_a_square():
    """The force is the uniform stress in plane strain, twice the shear yield stress."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None), "contact": (None, -1)}
    found = limit_load(Problem(mesh, CLAY, None, prescribed=supports), 1e-3)
    assert found.lower == pytest.approx(2.0, rel=1e-6)
    assert found.upper == pytest.approx(2.0, rel=1e-6)


def slopes_of_degree_two():
    """Derivatives of the B_a of degree two by barycentric coordinates at vertices, (4, 10, 4)."""
    indices = multi_indices(3, 2)
    result = np.zeros((4, len(indices), 4))
    for vertex, point in enumerate(np.eye(4)):
        for place, a in enumerate(indices):
            for i in np.flatnonzero(a):
                lower = a - np.eye(4, dtype=int)[i]
                result[vertex, place, i] = 2 * point @ lower
    return result


DEGREE_TWO_SLOPES = slopes_of_degree_two()


@pytest.mark.parametrize("size", [1e-2, 1.0])
def test_a_mechanism_in_space_dissipates_what_it_says(size):
    """Strain rates are the gradients of the velocity; cells and slips dissipate the upper bound."""
    mesh = block.structured_mesh(1, 1, 1, simplices=True)
    problem = Problem(mesh, CLAY, "clamped", traction={"contact": (size, 0, 0)})
    data = limit_data(problem, ("contact",))
    shape = SHAPES["solid"]
    bracket, _ = bracket_on(data, shape, None)
    found = bracket.mechanism
    cells = data.cells
    slopes = DEGREE_TWO_SLOPES @ cells.gradients[:, None]
    gradients = np.einsum("tni,tmnj->tmij", found.values, slopes)
    rates = np.einsum("tmij,cij->tmc", gradients, shape.basis)
    assert np.abs(rates).max() > 0
    corners = bernstein_values(1, np.eye(4)) @ found.strain
    np.testing.assert_allclose(corners, rates, atol=1e-9 * np.abs(rates).max())
    assert np.abs(rates[:, :, 0]).max() <= 1e-9 * np.abs(rates).max()
    rule = IntegrationRule(ET.TET, 14)
    points = np.array(rule.points)
    points = np.column_stack([1 - points.sum(axis=1), points])
    sizes = np.linalg.norm(points @ rates[:, :, shape.free :], axis=2)
    dissipated = data.bound * cells.volume * (sizes @ np.array(rule.weights)) * 6
    excess = found.dissipated - dissipated
    assert (excess >= -1e-4 * dissipated.max()).all()
    assert excess.sum() <= 0.02 * found.factor
    total = found.dissipated.sum() + found.slipped.sum()
    assert total == pytest.approx(found.factor, rel=1e-9)
    assert bracket.lower <= bracket.upper


def test_normal_velocities_in_space_are_continuous():
    """Both cells of a facet have one normal velocity there; slips dissipate what jumps do."""
    mesh = block.structured_mesh(1, 1, 1, simplices=True)
    problem = Problem(mesh, CLAY, "clamped", traction={"contact": (1, 0, 0)})
    data = limit_data(problem, ("contact",))
    found = bracket_on(data, SHAPES["solid"], None)[0].mechanism
    cells = data.cells
    rule = IntegrationRule(ET.TRIG, 20)
    x = np.array(rule.points)[:, :2]
    shares = np.column_stack([1 - x.sum(axis=1), x])
    points = shares @ cells.points[cells.facets]
    held = data.held == 3
    speeds = []
    for side in (0, 1):
        owner = cells.owners[:, side]
        values = np.zeros(points.shape)
        for f in np.flatnonzero(owner >= 0):
            place = barycentric(cells, owner[f : f + 1], points[f : f + 1])[0]
            values[f] = bernstein_values(2, place) @ found.values[owner[f]]
        speeds.append(values)
    jumps = speeds[0] - speeds[1]
    closed = ~cells.outer | held
    normal = np.einsum("fkp,fp->fk", jumps, cells.normal)
    size = np.abs(found.values).max()
    assert np.abs(normal[closed]).max() <= 1e-12 * size
    weights = 2 * np.array(rule.weights)
    slipped = cells.measure * (np.linalg.norm(jumps, axis=2) @ weights)
    slipped = SLIP * data.bound[0] * np.where(closed, slipped, 0.0)
    assert slipped.sum() > 0
    assert (found.slipped >= slipped - 1e-4 * slipped.max()).all()
    assert found.slipped.sum() <= 1.02 * slipped.sum()


def pressed_on(traction):
    """The limit load of a block on a smooth obstacle, which leaves it free to slide."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    loads = {"traction": {"contact": traction}}
    problem = Problem(mesh, CLAY, None, contact="clamped", gap=0.0, **loads)
    return limit_load(problem, 1e-3, max_cells=8)


def test_loads_that_move_a_free_body_have_the_factor_zero():
    """A smooth obstacle holds a body against pressure, not against sliding or lifting."""
    assert pressed_on((0, -1)).lower == pytest.approx(2.0, rel=1e-6)
    for traction in ((1, 0), (0, 1), (1, -1), (1e-3, -1)):
        found = pressed_on(traction)
        assert found.status is LimitStatus.FREE
        assert (found.lower, found.upper) == (0.0, 0.0)


def test_a_search_in_space_without_a_lower_bound_ends():
    """A shear traction up to free edges: no affine stress of these cells carries any of it."""
    mesh = block.structured_mesh(1, 1, 1, simplices=True)
    loads = {"traction": {"contact": (0.3, 0, -1)}}
    problem = Problem(
        mesh, CLAY, None, contact="clamped", gap=0.0, friction=0.5, **loads
    )
    found = limit_load(problem, 0.05, max_cells=60)
    assert len(found.records) <= 3
    assert found.lower <= found.upper
