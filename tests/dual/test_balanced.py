"""Balanced regularisation: counts, exact contact, the predictor, the split, units, recovery."""

import itertools
import math

import numpy as np
import pytest
from netgen.meshing import Element1D, Element2D, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngepc.geometries import block, lshape, wrench
from ngsolve import InnerProduct, Integrate, Mesh, Norm, specialcf

from ngepc import (
    Balanced,
    ExactContact,
    Material,
    NearMinimum,
    NodalContact,
    PenaltyContact,
    Problem,
    ReturnMapping,
    Status,
    SurfaceGradient,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.dual.balanced import FINENESS
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.contact_newton import ConstrainedSystem
from ngepc.dual.functional import DualFunctional
from ngepc.dual.iterates import Iterate, Line
from ngepc.dual.predictor import LocalProblem
from ngepc.linalg.linesearch import Descent
from ngepc.primal.solver import primal_newton

BALANCED = Balanced(1e9)
ELASTIC = {"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": 1.25, "hardening": 100.0}


def problem(name, nodes):
    body, make = {"a": (lshape, lshape_problem), "b": (wrench, wrench_problem)}[name]
    return make(body.paper_mesh(nodes))


@pytest.fixture(scope="module")
def solved_lshape():
    return semismooth_newton(problem("a", 417), regularisation=BALANCED)


@pytest.fixture(scope="module")
def functional():
    blocks = LinearBlocks(problem("a", 113), BALANCED, "sparsecholesky")
    return DualFunctional(blocks, BALANCED, 400)


@pytest.mark.parametrize(
    ("name", "nodes", "most"),
    [("a", 417, 9), ("a", 833, 10), ("a", 1601, 10), ("b", 873, 9), ("b", 1641, 10)],
)
def test_cold_start_needs_a_dozen_steps(name, nodes, most):
    result = semismooth_newton(problem(name, nodes), regularisation=BALANCED)
    assert result.status is Status.CONVERGED
    assert result.iterations <= most
    assert result.residual_norm < 1e-10


def test_nested_starts_need_fewer_steps():
    result, counts = None, []
    for nodes in (417, 833, 1601):
        result = semismooth_newton(problem("a", nodes), start=result, regularisation=BALANCED)
        counts.append(result.iterations)
    assert max(counts[1:]) < counts[0]


@pytest.mark.parametrize(
    ("nodes", "share", "energy"), [(417, 0.9, 0.37814), (833, 0.9, 0.37716), (1601, 0.9, 0.37659)]
)
def test_energies_of_an_independent_code(nodes, share, energy):
    """With (R2) and h_G = h/10; limits in the contact parameter, to the digits given."""
    R = Balanced(1e9, share=share, tichonov=SurfaceGradient())
    V = semismooth_newton(problem("a", nodes), regularisation=R).dual_energy
    assert pytest.approx(energy, abs=1.1e-5) == V


def test_penalty_contact_tends_to_exact_contact_from_below(solved_lshape):
    """V increases with gamma_z, the difference is the adhesion: of order 1/gamma_z."""
    exact = solved_lshape.dual_energy
    gaps = [
        exact
        - semismooth_newton(
            solved_lshape.problem, regularisation=Balanced(1e9, contact=PenaltyContact(gamma=g))
        ).dual_energy
        for g in (1e1, 1e2, 1e3)
    ]
    assert [a / b for a, b in itertools.pairwise(gaps)] == pytest.approx([10, 10], rel=0.01)


def test_contact_conditions_hold_exactly(solved_lshape):
    """z <= 0, lambda >= 0 and lambda z = 0 node by node; the gap is open where z = 0."""
    f = solved_lshape.functional
    z = f.constraint.values(f.blocks.part_of(solved_lshape.v, 0))
    residual = f.residual(solved_lshape.y, solved_lshape.v).FV().NumPy()[f.constraint.nodes.dofs]
    assert z.max() <= 0
    assert (z < 0).any()
    assert (z == 0).any()
    touching, open_gap = z < 0, -residual / f.constraint.masses
    assert np.abs(open_gap[touching]).max() < 1e-9
    assert open_gap[~touching].min() > 1e-4


def test_nodal_contact_keeps_every_node_at_its_gap(solved_lshape):
    """u.n <= psi at the nodes, equality where z < 0, up to the Tichonov term of z."""
    p = solved_lshape.problem
    result = semismooth_newton(p, regularisation=Balanced(1e9, contact=NodalContact()))
    assert result.status is Status.CONVERGED
    assert result.iterations <= 9
    nodes = sorted({v.nr for e in p.mesh.Boundaries("contact").Elements() for v in e.vertices})
    u = result.displacement.components[1].vec.FV().NumPy()[nodes]
    pressure = -result.normal_stress.vec.FV().NumPy()[nodes]
    touching = pressure > 1e-9 * pressure.max()
    assert 3 <= touching.sum() < len(nodes)
    assert np.abs(u[touching] - p.gap).max() < 5e-6
    assert (u[~touching] < p.gap).all()
    masses = result.functional.constraint.masses
    assert masses @ pressure == pytest.approx(result.contact_force, rel=1e-12)
    assert result.contact_resultant[1] == pytest.approx(-result.contact_force, rel=1e-12)
    assert result.contact_force == pytest.approx(primal_newton(p).contact_force, rel=0.01)


def test_solution_is_the_minimiser_over_the_feasible_set(solved_lshape):
    """J* grows along every feasible direction, quadratically at least by the Tichonov term."""
    f, v = solved_lshape.functional, solved_lshape.v
    generator = np.random.default_rng(1)
    V = Iterate.at(f, v).energy
    for size in (1e-3, 1e-1):
        w = v.CreateVector()
        w.FV().NumPy()[:] = v.FV().NumPy() + size * generator.standard_normal(len(v))
        f.make_feasible(w)
        assert Iterate.at(f, w).energy > V


def test_newton_step_minimises_the_model_over_the_feasible_set(functional):
    """At v + dv the gradient of the quadratic model is minus an element of the normal cone."""
    blocks, v = functional.blocks, functional.blocks.H_vector()
    generator = np.random.default_rng(2)
    v.FV().NumPy()[:] = 3 * generator.standard_normal(len(v))
    for i, space in enumerate(blocks.spaces):
        blocks.part_of(v, i).FV().NumPy()[~np.array(space.FreeDofs())] = 0.0
    functional.make_feasible(v)
    here = Iterate.at(functional, v)
    system = ConstrainedSystem(functional, "sparsecholesky")
    for _ in range(2):  # the second time from another set of fixed nodes
        dy, dv = system.step(here.v, here.residual)
        gradient = here.residual.CreateVector()
        gradient.data = here.residual + blocks.Lambda * dy + functional.tichonov_gradient(dv)
        for i, M in enumerate(functional.penalties):
            H = M.hessian(blocks.part_of(v, i))
            blocks.part_of(gradient, i).data += H * blocks.part_of(dv, i)
        new = here.v.CreateVector()
        new.data = here.v + dv
        free = np.concatenate([np.array(s.FreeDofs()) for s in blocks.spaces])
        z = blocks.part_of(new, 0)
        natural = gradient.FV().NumPy().copy()
        natural[: len(z)] = (
            functional.constraint.stationary(z, blocks.part_of(gradient, 0)).FV().NumPy()
        )
        size = np.abs(here.residual.FV().NumPy()[free]).max()
        assert np.abs(natural[free]).max() < 1e-8 * size
        assert functional.constraint.values(z).max() <= 0
        assert system.back_substitutions >= 1


def test_feasible_steps_are_measured(functional):
    constraint, blocks = functional.constraint, functional.blocks
    z, dz = (blocks.part_of(blocks.H_vector(), 0) for _ in range(2))
    z.FV().NumPy()[constraint.nodes.dofs] = -2.0
    assert constraint.longest_step(z, dz) == math.inf
    dz.FV().NumPy()[constraint.nodes.dofs[0]] = 4.0
    dz.FV().NumPy()[constraint.nodes.dofs[1]] = -1.0
    assert constraint.longest_step(z, dz) == pytest.approx(0.5)
    assert constraint.energy(z) == 0.0
    z.FV().NumPy()[constraint.nodes.dofs[0]] = 1e-12
    assert constraint.energy(z) == math.inf
    constraint.project(z)
    assert constraint.energy(z) == 0.0
    assert constraint.active(z) == pytest.approx(constraint.masses[1:].sum())


def test_predictor_changes_the_way_but_not_the_end():
    p = problem("b", 437)
    without = semismooth_newton(p, regularisation=Balanced(1e9, predictor=None))
    with_it = semismooth_newton(p, regularisation=BALANCED)
    assert with_it.dual_energy == pytest.approx(without.dual_energy, rel=1e-12)
    assert with_it.iterations < without.iterations


def test_predicted_dual_variable_is_the_return_mapping(functional):
    """For fixed u the mapped q minimises the local energy: its derivative vanishes."""
    blocks = functional.blocks
    y = blocks.load.CreateVector()
    y[:] = 0.0
    x = np.asarray(blocks.problem.mesh.ngmesh.Coordinates())[:, :2]
    u = y.FV().NumPy()[: 2 * len(x)].reshape(2, -1)
    u[0], u[1] = 0.004 * x[:, 1] ** 2, 0.002 * x[:, 0] * x[:, 1]
    local = LocalProblem(functional, "sparsecholesky", 1e-9)
    q = local.solve(y)
    loose = LocalProblem(functional, "sparsecholesky", 0.5).solve(y)
    assert local._gradient(q).Norm() < 1e-9
    assert local._energy(q) <= local._energy(loose)
    assert functional.penalties[-1].active(q) > 0


def scaled_lshape(stress, length, nodes=113):
    """Example (a) with all stresses and lengths multiplied."""
    old = lshape.paper_mesh(nodes)
    mesh = NetgenMesh(dim=2)
    points = [mesh.Add(MeshPoint(Pnt(*(length * c for c in p.p)))) for p in old.ngmesh.Points()]
    body = mesh.AddRegion("body", dim=2)
    for e in old.ngmesh.Elements2D():
        mesh.Add(Element2D(body, [points[v.nr - 1] for v in e.vertices]))
    names = old.GetBoundaries()
    regions = {name: mesh.AddRegion(name, dim=1) for name in sorted(set(names))}
    for e in old.ngmesh.Elements1D():
        vertices = [points[v.nr - 1] for v in e.vertices]
        mesh.Add(Element1D(vertices, index=regions[names[e.index - 1]]))
    mesh.Update()
    material = Material.kinematic(
        lame_lambda=1e3 * stress,
        lame_mu=1e3 * stress,
        yield_stress=1.25 * stress,
        hardening=100.0 * stress,
    )
    pressure = {"load": -10.0 * stress * specialcf.normal(2)}
    return Problem(Mesh(mesh), material, "clamped", pressure, contact="contact", gap=0.1 * length)


@pytest.mark.parametrize(("stress", "length"), [(8e7, 0.025), (1e-3, 1e3)])
def test_nothing_named_and_nothing_depends_on_units(stress, length):
    plain = semismooth_newton(scaled_lshape(1.0, 1.0))
    other = semismooth_newton(scaled_lshape(stress, length))
    assert other.status is Status.CONVERGED
    assert other.iterations == plain.iterations
    assert other.dual_energy / (stress * length**2) == pytest.approx(plain.dual_energy, rel=1e-9)
    chosen = other.functional.regularisation
    assert chosen.gamma == pytest.approx(plain.functional.regularisation.gamma, rel=1e-9)
    assert chosen.units.length == pytest.approx(length)


def test_default_gamma_grows_with_the_square_of_the_mesh():
    gammas = [Balanced().resolved(problem("a", n)).gamma_tichonov for n in (113, 417, 1601)]
    assert [b / a for a, b in itertools.pairwise(gammas)] == pytest.approx([4, 4])
    assert BALANCED.resolved(problem("a", 113)) is BALANCED


def test_default_gamma_follows_the_small_elements_of_a_graded_mesh():
    """Mean of 1/h_T^2: half of the elements ten times smaller count as 50 times more."""
    mesh = block.structured_mesh(4, 2, simplices=True).ngmesh
    for point in mesh.Points():
        point[0] = 0.1 * min(point.p[0], 0.5) + max(point.p[0] - 0.5, 0.0)
    graded = Problem(Mesh(mesh), Material.kinematic(**ELASTIC), traction={"contact": (0, -1)})
    areas = np.array(Integrate(1.0, graded.mesh, element_wise=True))
    assert areas.max() == pytest.approx(10 * areas.min())
    expected = FINENESS * 2100 * np.mean(1 / areas)
    assert Balanced().resolved(graded).gamma_tichonov == pytest.approx(expected)


def test_fields_are_those_of_the_primal_solver_to_discretisation_accuracy():
    """Distances in L2 to the primal solution fall with h; so do those of force and energy."""
    stress, plastic, force, energy = [], [], [], []
    for nodes in (113, 417, 1601):
        p = problem("a", nodes)
        dual, primal = semismooth_newton(p, regularisation=BALANCED), primal_newton(p)

        def distance(f, g, mesh=p.mesh):
            return math.sqrt(
                Integrate(InnerProduct(f - g, f - g), mesh) / Integrate(InnerProduct(g, g), mesh)
            )

        stress.append(distance(dual.stress, primal.stress))
        plastic.append(distance(dual.plastic_strain, primal.plastic_strain))
        force.append(abs(dual.contact_force / primal.contact_force - 1))
        energy.append(abs(dual.dual_energy / -primal.primal_energy - 1))
    for column in (stress, plastic, force, energy):
        assert column[2] < 0.4 * column[0]
        assert column[2] < column[1] < column[0]
    assert stress[-1] < 0.04
    assert plastic[-1] < 0.03
    assert force[-1] < 0.005
    assert energy[-1] < 0.002


def test_dual_plastic_variable_is_the_papers():
    """q . p = -beta |p|, that is (2.13): |q| = beta and q against p where the body yields."""
    errors = []
    for nodes in (113, 417, 1601):
        result = semismooth_newton(problem("a", nodes), regularisation=BALANCED)
        mesh, q, p = result.problem.mesh, result.plastic_dual, result.plastic_increment
        dissipation = Integrate(1.25 * Norm(p), mesh)
        errors.append(abs(1 + Integrate(InnerProduct(q, p), mesh) / dissipation))
    assert all(b < 0.5 * a for a, b in itertools.pairwise(errors))
    assert errors[-1] < 0.04


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Balanced(0.0), "gamma=0.0"),
        (lambda: Balanced(math.nan), "gamma=nan"),
        (lambda: Balanced(share=1.0), "share=1.0"),
        (lambda: Balanced(share=0.0), "share=0.0"),
        (lambda: PenaltyContact(gamma=-1.0), "gamma=-1.0"),
        (lambda: ExactContact(friction_gamma=0.0), "friction_gamma=0.0"),
        (lambda: ReturnMapping(accuracy=1.0), "accuracy=1.0"),
        (lambda: NearMinimum(flatness=1.0), "flatness=1.0"),
        (lambda: NearMinimum(most=0.5), "most=0.5"),
        (lambda: NearMinimum(evaluations=1), "evaluations=1"),
    ],
)
def test_illegal_numbers_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def search(minimum, stiffness_beyond=1.0, longest=math.inf):
    """NearMinimum on a convex, piecewise quadratic function with a given minimiser."""

    def slope(t):
        s = t - minimum
        return s if s < 0 else stiffness_beyond * s

    def value(t):
        return slope(t) * (t - minimum) / 2

    phi = Descent(
        energy=value,
        derivative=slope,
        energy_0=value(0.0),
        slope_0=slope(0.0),
        magnitude=value(0.0),
        longest=longest,
    )
    return NearMinimum(flatness=0.1).search(phi)


@pytest.mark.parametrize(
    ("minimum", "beyond"), [(1.0, 1.0), (0.3, 1.0), (0.02, 50.0), (2.5, 1.0), (1.7, 30.0)]
)
def test_line_search_comes_near_the_minimum(minimum, beyond):
    step = search(minimum, beyond)
    assert abs(step.length - minimum) <= 0.1 * minimum + 1e-15
    assert step.halvings <= 12


def test_line_search_takes_full_newton_steps_and_keeps_to_the_feasible_set():
    assert search(1.05).length == 1.0
    assert search(1.05).halvings == 0
    assert search(9.0).length == 4.0
    assert search(9.0, longest=1.5).length == 1.5
    assert search(9.0, longest=1.0).length == 1.0


def test_line_knows_the_energy_of_exact_contact(functional):
    """Along a Newton direction the parabola plus M^2 is J*, also with given z at some nodes."""
    here = Iterate.at(functional, functional.blocks.H_vector())
    system = ConstrainedSystem(functional, "sparsecholesky")
    dy, dv = system.step(here.v, here.residual)
    line = Line(functional, here, dy, dv)
    for alpha in (0.25, 1.0):
        direct = Iterate.at(functional, line.dual(alpha)).energy
        assert line.energy(alpha) == pytest.approx(direct, rel=1e-9)
