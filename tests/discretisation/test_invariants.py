"""What the objects of the discrete problem owe each other, for any body, state and material.

Adjoints, derivatives, round trips: nothing here knows a solution.
"""

import itertools
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from netgen.meshing import (
    Element1D,
    Element2D,
    Element3D,
    FaceDescriptor,
    MeshPoint,
    Pnt,
)
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import BND, CF, Integrate, Mesh, x, y

from ngepc import Material, Problem
from ngepc.discretisation.element_stiffness import ElementStiffness
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import PointFunctions, Points, interpolated
from ngepc.discretisation.resistance import Resistance
from ngepc.discretisation.rows import contact_rows, meeting_faces
from ngepc.discretisation.spaces import nodal
from ngepc.discretisation.supports import Supports
from ngepc.geometries import block, ring
from ngepc.model.hardening import Swift, Voce

STEEL = Material.kinematic(
    lame_lambda=1000.0, lame_mu=800.0, yield_stress=5.0, hardening=100.0
)
TIGHT = settings(max_examples=80, deadline=None)


def mixed():
    """Two triangles and a rectangle."""
    mesh = NetgenMesh(dim=2)
    places = [(0, 0), (1, 0), (2.2, 0), (0, 1), (1, 1), (2, 1)]
    n = [mesh.Add(MeshPoint(Pnt(*place, 0))) for place in places]
    body = mesh.AddRegion("body", dim=2)
    for corners in ((0, 1, 4, 3), (1, 2, 4), (2, 5, 4)):
        mesh.Add(Element2D(body, [n[i] for i in corners]))
    for name, edges in {
        "clamped": ((0, 1), (1, 2)),
        "contact": ((5, 4), (4, 3)),
    }.items():
        index = mesh.AddRegion(name, dim=1)
        for a, b in edges:
            mesh.Add(Element1D([n[a], n[b]], index=index))
    return Mesh(mesh)


def solid(elements, faces):
    """A unit cube with an inner point, of elements and named faces given by numbers of corners."""
    mesh = NetgenMesh(dim=3)
    corners = itertools.product((0, 1), repeat=3)
    n = [
        mesh.Add(MeshPoint(Pnt(*map(float, c)))) for c in (*corners, (0.55, 0.45, 0.5))
    ]
    for number, name in enumerate(faces):
        mesh.Add(FaceDescriptor(surfnr=number + 1, domin=1, bc=number + 1))
        mesh.SetBCName(number, name)
    mesh.SetMaterial(1, "body")
    for number, parts in enumerate(faces.values()):
        for face in parts:
            mesh.Add(Element2D(number + 1, [n[i] for i in face]))
    for element in elements:
        mesh.Add(Element3D(1, [n[i] for i in element]))
    return Mesh(mesh)


def prisms():
    """Two prisms."""
    names = {
        "clamped": [(0, 2, 4), (2, 6, 4)],
        "contact": [(1, 5, 3), (3, 5, 7)],
        "rest": [(0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)],
    }
    mesh = solid([(0, 4, 2, 1, 5, 3), (2, 4, 6, 3, 5, 7)], names)
    return mesh


def curved():
    """A quarter of a ring with bent edges; its inner edge is clamped."""
    mesh = ring.quarter_mesh(0.7, 1.0, 2.0)
    mesh.Curve(3)
    return mesh


MESHES = {
    "triangles": lambda: block.structured_mesh(2, 3, simplices=True, size=(1.5, 1.0)),
    "rectangles": lambda: block.structured_mesh(3, 2),
    "both": mixed,
    "curved": curved,
    "tetrahedra": lambda: block.structured_mesh(2, 1, 1, simplices=True),
    "hexahedra": lambda: block.structured_mesh(1, 2, 1, size=(1.0, 2.0, 0.5)),
    "prisms": prisms,
}
PLANE = ("plane strain", "plane stress", "two-dimensional", "axisymmetric")
BODIES = [
    *itertools.product(("triangles", "rectangles", "both", "curved"), PLANE, (1, 2)),
    *itertools.product(("tetrahedra", "hexahedra", "prisms"), ("solid",), (1, 2)),
]
NAMES = {"curved": {"clamped": "inner", "contact": "outer"}}


@cache
def problem_of(mesh, kinematics, order):
    names = {"clamped": "clamped", "contact": "contact"} | NAMES.get(mesh, {})
    return Problem(
        MESHES[mesh](), STEEL, gap=0.1, kinematics=kinematics, order=order, **names
    )


@cache
def points_of(mesh, kinematics, order, mean_volume=False):
    problem = problem_of(mesh, kinematics, order)
    return Points(problem.mesh, problem.kinematics, order, mean_volume=mean_volume)


@cache
def supports_of(mesh, kinematics, order):
    return Supports(problem_of(mesh, kinematics, order))


bodies = st.sampled_from(BODIES)
generators = st.integers(0, 2**32 - 1).map(np.random.default_rng)
every_body = pytest.mark.parametrize(
    "body", BODIES, ids=lambda b: f"{b[0]}-{b[1]}-{b[2]}"
)


def close(a, b, relative=1e-11):
    scale = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
    return np.abs(np.subtract(a, b)).max(initial=0.0) <= relative * scale


# Points


def test_weights_add_up_to_the_volume_of_the_body():
    for body in BODIES:
        points = points_of(*body)
        volume = Integrate(points.kinematics.weight, points.mesh, order=8)
        tolerance = 1e-3 if body[0] == "curved" else 1e-12  # a circle is no polynomial
        assert points.weights.sum() == pytest.approx(volume, rel=tolerance), body
        assert (points.weights > 0).all(), body


@given(bodies, generators)
@TIGHT
def test_strains_are_those_of_ngsolve(body, random):
    points, supports = points_of(*body), supports_of(*body)
    u = random.normal(size=supports.free.shape)
    volume, deviator = points.strain(u)
    strain = points.kinematics.strain(supports.function(u))
    size = points.kinematics.size
    assert close(volume, sum(points.at(strain[i, i]) for i in range(size)))
    assert close(deviator, points.at(points.kinematics.coordinates(strain)))


@given(bodies, st.booleans(), generators)
@TIGHT
def test_forces_are_the_adjoint_of_the_strain(body, mean_volume, random):
    points = points_of(*body, mean_volume)
    u = random.normal(size=(points.scalar.ndof, points.kinematics.N))
    pressure, stress = (
        random.normal(size=len(points)),
        random.normal(size=points.strain(u)[1].shape),
    )
    volume, deviator = points.strain(u)
    work = points.weights * (pressure * volume + (stress * deviator).sum(1))
    assert np.vdot(points.forces(pressure, stress), u) == pytest.approx(
        work.sum(), abs=1e-12 * np.abs(work).sum()
    )


@given(bodies, generators)
@TIGHT
def test_rigid_motions_strain_nothing(body, random):
    """Those of the body: a ring moves along its axis only."""
    points = points_of(*body)
    N, vertices = points.kinematics.N, np.asarray(points.mesh.ngmesh.Coordinates())
    spin = random.normal(size=(N, N))
    motion = random.normal(size=N) + vertices[: points.mesh.nv, :N] @ (spin - spin.T)
    if points.kinematics.hoop:
        motion = np.tile([0.0, random.normal()], (points.mesh.nv, 1))
    if body[0] == "curved":  # the edges bend: vertices alone do not tell a rotation
        motion = np.tile(motion[0], (points.mesh.nv, 1))
    u = np.zeros((points.scalar.ndof, N))
    u[: points.mesh.nv] = motion
    for strain in points.strain(u):
        assert np.abs(strain).max() <= 1e-12 * np.abs(u).max()


@given(bodies, st.booleans(), generators)
@TIGHT
def test_mean_volume_strain_keeps_the_mean_of_each_element(body, mean_volume, random):
    """And it is constant in each element."""
    plain, averaged = points_of(*body), points_of(*body, True)
    u = random.normal(size=(plain.scalar.ndof, plain.kinematics.N))
    (volume, deviator), (mean, same) = plain.strain(u), averaged.strain(u)
    assert (deviator == same).all()
    for block_of in plain.blocks:
        w, here = plain.weights[block_of.points], block_of.points
        assert close((w * volume[here]).sum(1), (w * mean[here]).sum(1), 1e-10)
        assert np.ptp(mean[here], axis=1).max() <= 1e-10 * np.abs(mean).max()


# Stiffness


def some_moduli(points, random):
    d = random.normal(size=(len(points), points.kinematics.d))
    d /= np.linalg.norm(d, axis=1)[:, None]
    bulk, across = random.uniform(0.5, 2.0, size=(2, len(points)))
    extra = -across * random.uniform(0.0, 1.0, size=len(points))
    if random.integers(2):
        return Moduli(bulk, across, extra, d)
    size = 1 + points.kinematics.d
    coupling = random.normal(size=(len(points), size, size))
    return Moduli(bulk, across, extra, d, coupling + coupling.swapaxes(1, 2))


@given(bodies, st.booleans(), generators)
@TIGHT
def test_the_filled_matrix_is_the_strain_law_and_forces_applied(
    body, mean_volume, random
):
    """B' C B on what is free, the identity on what is held, twice in the same matrix."""
    points, free = points_of(*body, mean_volume), supports_of(*body).free
    stiffness = ElementStiffness(points, free)
    matrix = stiffness.matrix()
    right, left = (matrix.CreateColVector() for _ in range(2))
    for _ in range(2):
        moduli = some_moduli(points, random)
        stiffness.entries(matrix)[:] = stiffness.values(moduli)
        u = random.normal(size=free.shape)
        right.FV().NumPy()[:] = u.ravel()
        left.data = matrix * right
        volume, deviator = points.strain(np.where(free, u, 0.0))
        forces = points.forces(*moduli.stress(volume, deviator))
        assert close(left.FV().NumPy().reshape(u.shape), np.where(free, forces, u))


@given(bodies, generators)
@TIGHT
def test_the_diagonal_is_that_of_the_matrix(body, random):
    points, free = points_of(*body), supports_of(*body).free
    bulk, shear = random.uniform(0.5, 2.0, size=(2, len(points)))
    node, component = (int(random.integers(n)) for n in free.shape)
    unit = np.zeros(free.shape)
    unit[node, component] = 1.0
    volume, deviator = points.strain(unit)
    entry = points.forces(bulk * volume, shear[:, None] * deviator)[node, component]
    assert points.diagonal(bulk, shear)[node, component] == pytest.approx(
        entry, rel=1e-12
    )


# Functions of the points


@given(bodies, generators)
@TIGHT
def test_values_at_points_become_a_function_and_values_again(body, random):
    points = points_of(*body)
    functions = PointFunctions(points)
    for shape in ((len(points),), (len(points), points.kinematics.d)):
        values = random.normal(size=shape)
        function = functions.function(values)
        assert close(points.at(function), values, 1e-10)
        again = functions.function(points.at(function))
        assert close(again.vec.FV().NumPy(), function.vec.FV().NumPy(), 1e-9)


def test_a_coefficient_is_met_at_the_points():
    for body in BODIES:
        points, value = points_of(*body), CF((x * y, 1 / (1 + x), y))
        function = interpolated(problem_of(*body), value)
        assert close(points.at(function), points.at(value), 1e-10), body


# The law

POINTS = {
    "plane strain": 3,
    "plane stress": 3,
    "two-dimensional": 2,
    "axisymmetric": 3,
    "solid": 5,
}
positive = st.floats(0.01, 100.0)
strains = {d: arrays(float, (2, d), elements=st.floats(-8.0, 8.0)) for d in (2, 3, 5)}


@st.composite
def laws(draw):
    """A law with a history at the two points of some mesh, and pairs of strains there."""
    mesh, kinematics = draw(
        st.sampled_from([("flat", k) for k in PLANE] + [("solid", "solid")])
    )
    problem, points = law_places(mesh, kinematics)
    law = law_of(problem, points)
    for name in ("two_mu", "bulk", "hardening"):
        setattr(law, name, np.array([draw(positive), draw(positive)]))
    beta = np.array([draw(positive), draw(positive)])
    d = points.kinematics.d
    law.initial, law.back = draw(strains[d]), draw(strains[d])
    isotropic = None
    accumulated = np.zeros(2)
    if draw(st.booleans()):
        some = draw(st.sampled_from([Voce, Swift]))
        data = st.floats(0.1, 3.0)
        isotropic = some(1.0, 1.0, 1.0).at(lambda _: np.array([draw(data), draw(data)]))
        accumulated = np.array([draw(st.floats(0, 3)), draw(st.floats(0, 3))])
    law.resistance = Resistance(beta, isotropic, accumulated)
    return law, draw(strains[d]), draw(strains[d])


@cache
def law_places(mesh, kinematics):
    made = {"flat": (1, 1), "solid": (1, 1, 1)}[mesh]
    simplices = block.structured_mesh(*made, simplices=True)
    problem = Problem(simplices, STEEL, kinematics=kinematics)
    return problem, Points(simplices, problem.kinematics, 1)


def dot(a, b):
    return np.einsum("pd,pd->p", a, b)


def scale_of(law, *strains_):
    """A bound for the energy densities that appear, for rounding."""
    size = 1 + sum(np.linalg.norm(e, axis=1) for e in (law.initial, *strains_))
    back = np.linalg.norm(law.back, axis=1)
    return (law.two_mu + law.bulk) * size**2 + back * size + back**2 / law.two_mu


@given(laws(), st.floats(-5, 5), st.floats(-5, 5))
@settings(max_examples=200, deadline=None)
def test_the_stress_is_the_derivative_of_the_energy_density(case, v, other_v):
    """Between any two strains, 0 <= psi(e') - psi(e) - sigma . (e' - e) <= (sigma' - sigma) ...

    Both hold if and only if psi is convex and sigma its derivative: no difference quotient.
    """
    law, e, other = case
    volume = np.full(len(e), v)
    volume_there = np.full(len(e), other_v)
    at = law.returned(volume, e)
    there = law.returned(volume_there, other)
    change = law.energy_density(there) - law.energy_density(at)

    def power(stress):
        """A stress times the change of the strain."""
        mean, deviator = stress
        return mean * (volume_there - volume) + dot(deviator, other - e)

    here = power(law.stress(at))
    beyond = power(law.stress(there))
    rounding = 1e-12 * scale_of(law, e, other) + 2e-9 * law.beta * np.linalg.norm(
        other - e, axis=1
    )
    assert (change - here >= -rounding).all()
    assert (change - beyond <= rounding).all()


@given(laws())
@settings(max_examples=200, deadline=None)
def test_the_return_solves_its_conditions(case):
    """Moreau: s is w, |w| <= beta, and (2 mu + h) p; p points along w; sigma is Hooke's."""
    law, e, _ = case
    at = law.returned(np.zeros(len(e)), e)
    w, p, rounding = law.yielding_part(at), at.plastic_strain, 2e-9 * (1 + at.size)
    M = law.two_mu + law.hardening
    assert (np.abs(at.trial - w - M[:, None] * p).max(1) <= rounding).all()
    bound = law.resistance.bound(at.gained)
    assert (np.linalg.norm(w, axis=1) <= bound * (1 + 1e-14)).all()
    assert (np.abs(dot(p, w) - bound * at.gained) <= rounding * at.gained).all()
    hooke = law.two_mu[:, None] * (at.deviator - law.initial - p)
    assert (np.abs(law.stress(at)[1] - hooke).max(1) <= 1e-12 * scale_of(law, e)).all()
    assert np.allclose(law.moved(at, w, np.zeros_like(w)), w, rtol=1e-8)


@given(laws())
@settings(max_examples=200, deadline=None)
def test_moduli_with_w_on_the_sphere_are_the_derivative_of_the_stress(case):
    law, e, direction = case
    still = np.zeros(len(e))
    at = law.returned(still, e)
    smooth = np.abs(at.size - law.beta) > 1e-2 * (law.beta + at.size)
    t = (
        1e-5
        * np.maximum(at.size, law.beta)
        / (law.two_mu * (1 + np.linalg.norm(direction, axis=1)))
    )
    ahead, back = (
        law.stress(law.returned(still, e + s * t[:, None] * direction))[1]
        for s in (1, -1)
    )
    quotient = (ahead - back) / (2 * t[:, None])
    tangent = law.moduli(at, law.yielding_part(at))(direction)
    rounding = 1e-15 * scale_of(law, e) / t + 1e-7 * law.two_mu
    error = np.abs(quotient - tangent).max(1)
    assert (error[smooth] <= (rounding * (1 + np.abs(direction).max(1)))[smooth]).all()


@given(laws(), st.floats(0.0, 1.0))
@settings(max_examples=200, deadline=None)
def test_moduli_are_positive_definite_for_every_w_in_the_ball(case, part):
    """Not below the plastic modulus 2 mu h / (2 mu + h), not above 2 mu."""
    law, e, direction = case
    at = law.returned(np.zeros(len(e)), e)
    length = np.linalg.norm(direction, axis=1)
    w = (part * at.radius / np.where(length > 0, length, 1.0))[:, None] * direction
    moduli = law.moduli(at, w)
    d = moduli.direction
    C = moduli.across[:, None, None] * np.eye(d.shape[1])
    C = C + moduli.extra[:, None, None] * d[:, :, None] * d[:, None, :]
    values = np.linalg.eigvalsh(C)
    least = law.two_mu * law.hardening / (law.two_mu + law.hardening)
    assert (values.min(1) >= least * (1 - 1e-12) - 1e-13 * law.two_mu).all()
    assert (values.max(1) <= law.two_mu * (1 + 1e-12)).all()
    assert (moduli.bulk == law.bulk).all()


# Supports and contact rows


@every_body
def test_shapes_of_nodal_arrays(body):
    problem, supports = problem_of(*body), supports_of(*body)
    nodes, N = points_of(*body).scalar.ndof, problem.N
    assert supports.free.shape == supports.values.shape == (nodes, N)
    rows = contact_rows(problem, supports)
    m = len(rows)
    assert m > 0
    assert rows.normal.shape == (m, nodes * N)
    assert rows.tangential.shape == (m * (N - 1), nodes * N)
    assert rows.gaps.shape == rows.weights.shape == rows.nodes.shape == (m,)
    assert (rows.normals.shape, rows.tangents.shape) == ((m, N), (m, N - 1, N))
    frames = np.concatenate([rows.normals[:, None], rows.tangents], axis=1)
    assert close(
        frames @ frames.swapaxes(1, 2), np.broadcast_to(np.eye(N), (m, N, N)), 1e-14
    )
    assert rows.gaps == pytest.approx(0.1, rel=1e-12)
    names = "|".join(problem.contact_names)
    weight = problem.kinematics.weight
    area = Integrate(
        weight, problem.mesh, BND, definedon=problem.mesh.Boundaries(names), order=8
    )
    assert rows.weights.sum() == pytest.approx(
        area, rel=1e-3 if body[0] == "curved" else 1e-12
    )


@given(bodies, generators)
@TIGHT
def test_forces_of_rows_are_their_adjoints_and_translations_pass_through(body, random):
    problem, supports = problem_of(*body), supports_of(*body)
    rows = contact_rows(problem, supports)
    u = random.normal(size=supports.free.shape)
    pressing = random.normal(size=len(rows))
    work, scale = pressing @ (rows.normal @ u.ravel()), 1e-12 * u.size
    assert np.vdot(rows.normal.T @ pressing, u.ravel()) == pytest.approx(
        work, abs=scale
    )
    shift, constant = random.normal(size=problem.N), np.zeros(u.shape)
    constant[: problem.mesh.nv] = shift
    # A row between vertices of a curved facet has the normals of several nodes.
    own = rows.nodes < problem.mesh.nv if body[0] == "curved" else slice(None)
    along = rows.normal @ constant.ravel()
    assert close(along[own], (rows.normals @ shift)[own], 1e-12)
    assert close(
        rows.tangential @ constant.ravel(), (rows.tangents @ shift).ravel(), 1e-12
    )


@given(bodies, generators)
@TIGHT
def test_nodal_values_become_a_function_and_nodal_values_again(body, random):
    supports = supports_of(*body)
    u = random.normal(size=supports.free.shape)
    back = nodal(supports.function(u).vec.FV().NumPy(), supports.problem)
    assert (back == u).all()


@given(generators)
@TIGHT
def test_faces_at_a_node_do_not_depend_on_the_order_of_its_facets(random):
    normals = random.normal(loc=(0.0, 0.0, 1.5), size=(12, 3))
    nodes, names = random.integers(0, 3, 12), random.integers(0, 2, 12)
    order, found = random.permutation(12), []
    for turn in (np.arange(12), order):
        at, sums = meeting_faces(nodes[turn], names[turn], normals[turn])
        assert (sums.sum(axis=0) == 1).all()  # each facet belongs to one face
        found.append(np.column_stack([at, sums @ normals[turn]]))
    first, second = (np.sort(faces @ [100.0, 1.0, 10.0, 3.0]) for faces in found)
    assert first == pytest.approx(second)
