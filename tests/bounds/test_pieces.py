"""Pieces of the bounds beside plain statements: balance, the adjoint's rows, the third stress."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import x

from ngepc import Material, Problem, Reaction, Swift, Tabulated, Voce, semismooth_newton
from ngepc.bounds.airy import AirySpace, kept_entries
from ngepc.bounds.balance import spring_energy
from ngepc.bounds.bound import state_of
from ngepc.bounds.conjugate import R6, Conjugate
from ngepc.bounds.coordinates import stress_coordinates
from ngepc.bounds.levels import TwoLevels
from ngepc.bounds.of_state import bound_data_of
from ngepc.bounds.plane import strain_of
from ngepc.bounds.vertex_matrix import BLOCKS
from ngepc.discretisation.factors import Factors
from ngepc.geometries import block
from ngepc.goals.adjoint import AdjointProblem
from ngepc.goals.goal_terms import terms_of
from ngepc.goals.integrand import completed_near

METAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)


def solved(material=METAL, **data):
    """A block on a floor, and what its bounds start from."""
    mesh = block.structured_mesh(3, 3, size=(1.0, 1.0), simplices=True)
    result = semismooth_newton(Problem(mesh, material, order=1, **data))
    bound_data = bound_data_of(result.discrete)
    return bound_data, state_of(bound_data.discrete, result)


@pytest.mark.parametrize("factor", [0.5, 1.5])
@pytest.mark.parametrize("load", [(0.0, -2.0), (1.0, 2.0)])
def test_stresses_are_put_into_equilibrium_with_other_loads(load, factor):
    """Virtual work for displacements that keep the supports, whatever the sign of the defect."""
    bound_data, state = solved(traction={"contact": load})
    discrete = bound_data.discrete
    points = discrete.points
    given = factor * discrete.load
    stress, _ = bound_data.balanced(state, Factors(discrete, "sparsecholesky"), given)
    random = np.random.default_rng(0)
    for _ in range(3):
        v = np.where(discrete.free, random.normal(size=given.shape), 0.0)
        strain = stress_coordinates(*points.strain(v), 0.0)
        work = points.integral(np.einsum("pc,pc->p", stress, strain))
        assert work == pytest.approx(float((given * v).sum()), rel=1e-9)


def test_the_third_stress_is_the_nearest():
    """In plane strain: the energy of the difference to a given stress is least among all zeta."""
    random = np.random.default_rng(0)
    bulk = np.array([2.0, 3.0])
    two_mu = np.array([1.5, 0.7])
    law = SimpleNamespace(bulk=bulk, two_mu=two_mu, across=None)
    stress = random.normal(size=(2, 5, 3))
    wanted = random.normal(size=(2, 5, 4))
    found = completed_near(stress, wanted, law, 1)

    def energy(zeta):
        mean = stress[..., 0] - zeta / R6
        deviator = np.stack([stress[..., 1], zeta, stress[..., 2]], axis=-1)
        square = ((deviator - wanted[..., 1:]) ** 2).sum(axis=2)
        of_mean = (mean - wanted[..., 0]) ** 2 / bulk[:, None]
        return of_mean + square / two_mu[:, None]

    zeta = found[..., 2]
    np.testing.assert_allclose(found[..., 0], stress[..., 0] - zeta / R6)
    np.testing.assert_array_equal(found[..., [1, 3]], stress[..., 1:])
    slope = (energy(zeta + 1e-3) - energy(zeta - 1e-3)) / 2e-3
    np.testing.assert_allclose(slope, 0.0, atol=1e-10)


@pytest.mark.parametrize("law", [None, Voce(1.5, 1.0, 50.0), Swift(1.5, 0.004, 0.4)])
def test_the_third_stress_makes_the_dual_density_least(law):
    """In plane strain: its derivative by zeta vanishes, whether the stress yields or not."""
    material = METAL
    if law is not None:
        material = Material.with_law(lame_lambda=1.5e3, lame_mu=1e3, law=law)
        material = replace(material, hardening=40.0)
    bound_data, _ = solved(material, traction={"contact": (0.0, -1.0)})
    conjugate = bound_data.conjugate
    count = len(conjugate.bulk)
    z = 4.0 * np.random.default_rng(0).normal(size=(count, 9, 3))
    at = conjugate.completed(z)
    assert 0 < np.count_nonzero(at.over) < at.over.size
    strain = conjugate.deviatoric_strain(at)[..., 1]
    volume = at.mean / conjugate.bulk[:, None]
    slope = strain - volume / R6
    assert np.abs(slope).max() <= 1e-7 * np.abs(strain).max()


@pytest.mark.parametrize("degree", [3, 4])
def test_stiffness_matrices_belong_to_the_map_of_the_unknowns(degree):
    """Blocks, stresses and forces are those of one matrix for each triangle."""
    bound_data, _ = solved()
    space = AirySpace(bound_data.boundary, degree, bound_data.piola)
    n, count = space.unknowns.shape
    unit = np.broadcast_to(np.eye(n)[:, :, None], (n, n, count))
    columns = [space._on_reference(unit[k]) for k in range(n)]
    rows = [space._from_reference(unit[k]) for k in range(n)]
    T = np.stack(columns, axis=1)
    np.testing.assert_allclose(np.stack(rows), T, atol=1e-14)

    random = np.random.default_rng(0).normal(size=(n, n, count))
    K = random + random.swapaxes(0, 1)
    whole = np.einsum("kit,klt,ljt->ijt", T, K, T, optimize=True)
    blocks = space._blocks(K.reshape(n * n, count)[kept_entries(n)])
    a, b = BLOCKS
    pairs = whole[:9, :9].reshape(3, 3, 3, 3, count)[a, :, b]
    wanted = pairs.transpose(1, 2, 0, 3), whole[:9, 9:], whole[9:, 9:]
    for given, part in zip(blocks, wanted, strict=True):
        np.testing.assert_allclose(given, part, atol=1e-10)


@pytest.mark.parametrize("degree", [3, 4])
def test_some_triangles_alone_have_the_matrix_of_the_whole(degree):
    """Of the whole all rows but those of held edges, of some triangles those that are free."""
    bound_data, _ = solved()
    cells = bound_data.cells
    space = AirySpace(bound_data.boundary, degree, bound_data.piola)
    chosen = cells.around(np.arange(3), 2)
    part = space.alone(chosen)
    H = np.tile(np.diag([1.0, 2.0, 3.0]), (len(cells.nodes), 1, 1, 1))
    for own, there in ((space, slice(None)), (part, chosen)):
        system = TwoLevels(own)
        system.update(own.stiffness(H[there]))
        free = own.free.copy()
        if own is space:
            free[: own.vertices] = True
        x = system.inside(np.random.default_rng(1).normal(size=len(free)) * free)
        same = np.zeros(len(space.free))
        same[own.numbers] = system.outside(x)
        strain = strain_of(H, space.stress(same))
        forces = space.gathered(space.forces(strain))[own.numbers]
        wanted = system.inside(forces)
        rows = system.inside(np.ones(len(free)) * free) != 0
        np.testing.assert_allclose(system.product(x)[rows], wanted[rows], atol=1e-9)
        np.testing.assert_allclose(
            own.stress(system.outside(x)),
            space.stress(same)[there],
            rtol=1e-12,
            atol=1e-9,
        )
    assert 0 < np.count_nonzero(part.free) < np.count_nonzero(space.free)


@pytest.mark.parametrize("degree", [3, 4])
@pytest.mark.parametrize("supported", [True, False])
def test_the_preconditioner_knows_what_the_matrix_does(degree, supported):
    """It is symmetric and positive, on two clamped sides with resultants between them, too."""
    bound_data, _ = solved(clamped="left|right" if supported else "left")
    space = AirySpace(bound_data.boundary, degree, bound_data.piola)
    system = TwoLevels(space, bound_data.cells)
    H = np.tile(np.diag([1.0, 2.0, 3.0]), (len(space.det), 1, 1, 1))
    system.update(space.stiffness(H))
    solver = system.focused()
    assert (len(solver._modes) > 0) == supported
    random = np.random.default_rng(3)
    r = [system.inside(random.normal(size=len(space.free))) for _ in range(2)]
    z = [solver.answered(one) for one in r]
    for answer, image in z:
        scale = np.abs(image).max()
        np.testing.assert_allclose(image, solver.product(answer), atol=1e-12 * scale)
    assert z[0][0] @ r[1] == pytest.approx(z[1][0] @ r[0], rel=1e-9)
    assert z[0][0] @ r[0] > 0


@pytest.mark.parametrize("count", [1, 2, 5])
def test_the_direct_solver_of_some_vertices_inverts_their_block(count):
    """K_vv x on the free unknowns of some vertices gives x back; single blocks do so alone."""
    bound_data, _ = solved()
    space = AirySpace(bound_data.boundary, 3, bound_data.piola)
    system = TwoLevels(space, bound_data.cells)
    H = np.tile(np.diag([1.0, 2.0, 3.0]), (len(space.det), 1, 1, 1))
    system.update(space.stiffness(H))
    free = space.free[: space.vertices].reshape(-1, 3).T
    vertices = np.flatnonzero(free.any(axis=0))[:count]
    chosen = np.zeros_like(free)
    chosen[:, vertices] = free[:, vertices]
    x = np.random.default_rng(count).normal(size=chosen.shape) * chosen
    r = system._vertices.product(x.ravel())
    found = np.zeros_like(r)
    system._vertices.inverse(chosen).solve(r, found)
    np.testing.assert_allclose(found, x.ravel(), atol=1e-12)

    one = vertices[-1]
    alone = np.zeros_like(x)
    alone[:, one] = x[:, one]
    r = system._vertices.product(alone.ravel()).reshape(3, -1)
    inverse = system._vertices.inverse_blocks(free)
    np.testing.assert_allclose(inverse[..., one] @ r[:, one], x[:, one], atol=1e-12)
    assert not inverse[..., ~free.any(axis=0)].any()


def test_what_nodal_forces_miss_is_no_reason_for_another_pass():
    """Residuals at corners without it vanish after one pass, for any sums at the corners."""
    bound_data, _ = solved(traction={"contact": (1.0, -2.0)})
    patches = bound_data.patches
    missing = np.random.default_rng(0).normal(size=(len(patches._order), 2))
    change = np.stack([patches._answers(k, missing[:, k]) for k in range(2)], axis=1)
    rest = missing - patches._sum @ (patches._free * (patches._jump @ change))
    assert np.abs(rest).max() > 0.1
    assert patches._mendable(rest) < 1e-12
    assert patches._mendable(missing) > 0.1


@pytest.mark.parametrize("goal", ["work", Reaction("clamped", 1)])
def test_the_energy_of_an_adjoint_is_that_of_its_strains(goal):
    """Also where a support moves: products of forces and displacements beside the integral."""
    data = {"traction": {"right": (0.0, -1.0)}, "springs": {"right": 30.0}}
    bound_data, state = solved(contact="contact", gap=-1e-2, **data)
    discrete = bound_data.discrete
    P = bound_data.contact.from_rows.pressure(state.multipliers)
    adjoints = AdjointProblem(bound_data, state, P)
    start = adjoints.start(terms_of(goal, bound_data))
    z = start.base.z + start.lift
    strain = discrete.points.strain(z)
    mean, deviator = adjoints.tangent.moduli.stress(*strain)
    density = mean * strain[0] + np.einsum("pd,pd->p", deviator, strain[1])
    stored = discrete.points.integral(density) / 2 + spring_energy(discrete, z)
    assert stored > 0
    assert adjoints.energy(start) == pytest.approx(stored, rel=1e-9)


def test_a_straight_law_beyond_yield_is_integrated_exactly():
    """Where all stresses of a part are parallel: F is quadratic, so is (|s| - beta)^2."""
    straight = Material.with_law(
        lame_lambda=1e3, lame_mu=1e3, law=Tabulated((0.0, 5.0), (1.5, 301.5))
    )
    bound_data, _ = solved(straight, traction={"contact": (0.0, -1.0)})
    conjugate = Conjugate(bound_data.discrete.law, 3).of(np.array([0]))
    conjugate.whole = True
    sizes = np.array([2.5, 4.0, 9.0, 3.0, 3.5, 5.0, 2.0, 8.0, 6.0]) * conjugate.beta
    z = np.zeros((1, 9, 4))
    z[0, :, 1] = 0.6 * sizes
    z[0, :, 3] = 0.8 * sizes
    middles = (np.ones((3, 3)) - np.eye(3)) / 2  # a rule that is exact for squares
    values = np.matmul(middles, z.reshape(3, 3, 4))
    exact = conjugate.value(conjugate.completed(values.reshape(1, 9, 4))).mean()
    bound = conjugate.integrals(z, np.ones(1), np.zeros(1))
    assert bound[0] == pytest.approx(exact, rel=1e-9)


def test_rows_of_the_adjoint_that_touch_nothing_stay_within_their_gap():
    """|c - z . n| <= lambda gap, for forces either way: rows are held where they were pushed."""
    bound_data, state = solved(
        contact="contact", gap=0.02 * (x - 0.3) ** 2 - 2e-3, traction={"right": (3, 0)}
    )
    adjoints = AdjointProblem(bound_data, state, np.zeros((0, 2)))
    open_rows = ~adjoints.presses
    assert open_rows.any()
    assert adjoints.presses.any()
    gap = np.maximum(state.gaps, 0.0)
    for sign in (-1.0, 1.0):
        forces = np.zeros_like(bound_data.discrete.load)
        forces[:, 1] = sign
        wanted = np.zeros(len(gap))
        pushed = adjoints.rows.matrix @ adjoints.tangent.solve(forces).ravel()
        factor = 0.1 * np.abs(pushed).max() / gap.max()
        base = adjoints.pressed_rows(forces, wanted)
        z = adjoints._steered(base, wanted, factor)
        moved = adjoints.rows.matrix @ z.ravel()
        rounding = adjoints.rows.tolerance * np.abs(z).max()
        assert (np.abs(moved) <= factor * gap + rounding).all()
        held = open_rows & (np.abs(moved) >= factor * gap - rounding)
        assert held.any()
        np.testing.assert_array_equal(np.sign(moved)[held], np.sign(pushed)[held])
