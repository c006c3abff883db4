"""The stress of a bound is admissible: that, and nothing else, is what guarantees it."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import moved_by
from campaigns.crossings import finer
from ngsolve import (
    BND,
    CF,
    ET,
    GridFunction,
    InnerProduct,
    IntegrationRule,
    specialcf,
    x,
    y,
)

from ngepc import (
    Material,
    Problem,
    Roller,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.bounds.bound import error_bound
from ngepc.bounds.element import ELEMENTS, PAIRS
from ngepc.bounds.of_state import data_on
from ngepc.geometries import block, lshape, wrench

MATERIAL = Material(
    lame_lambda=1e3,
    lame_mu=1e3,
    yield_stress=1.25,
    hardening=60.0,
    hardening_modulus=2.0,
    hardening_stiffness=6.0,
)
P_0 = CF((2e-4, 1e-4, 0, 1e-4, -3e-4, 0, 0, 0, 1e-4), dims=(3, 3))
BACK = CF((0.012, 0.006, 0, 0.006, -0.018, 0, 0, 0, 0.006), dims=(3, 3))
TRACTION = CF((3.0, -1.0 - 2 * y))


def pressed_block():
    """Plane strain, a parabola above, body force, history, a traction that is affine."""
    return Problem(
        block.mesh(0.25, (1.0, 1.0)),
        MATERIAL,
        traction={"right": TRACTION},
        contact="contact",
        gap=0.1 * (x - 0.4) ** 2 - 2e-3,
        body_force=(2.0, -1.0),
        initial_plastic_strain=P_0,
        initial_hardening=(0.01, BACK),
        kinematics="plane strain",
    )


def rollers(kinematics="plane strain"):
    """A quarter of a plate with a hole; what is prescribed moves."""
    return Problem(
        block.with_hole(0.12, (1.0, 1.0)),
        MATERIAL,
        clamped=None,
        prescribed={"left": (0, None), "clamped": (None, 0), "right": (2e-3, None)},
        traction={"contact": (0.5, 0.2)},
        kinematics=kinematics,
    )


def tangential_roller():
    """The tangential displacement is held, the normal one is free."""
    return Problem(
        block.mesh(0.3, (1.0, 0.7)),
        MATERIAL,
        prescribed={"right": (None, 1e-3 * y)},
        traction={"left": (-3.0, 2.0)},
        kinematics="two-dimensional",
    )


def dragged():
    """A plate presses the whole top, the block slides under it with friction that varies."""
    return Problem(
        block.mesh(0.12, (1.0, 1.0)),
        MATERIAL,
        traction={"right": (0.4, 0.0)},
        contact="contact",
        gap=-2e-3,
        friction=0.3 + 0.2 * x,
        initial_displacement=(1e-3 * x, 0.0),
    )


def on_springs():
    """A block on a foundation with a load on it, and a side on a normal one."""
    return Problem(
        block.mesh(0.25, (1.0, 0.7)),
        MATERIAL,
        clamped=None,
        traction={"right": TRACTION, "clamped": (0.5, 0.0)},
        springs={"clamped": (2e3, 5e2), "left": 1e2},
        body_force=(1.0, -2.0),
    )


TURN = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
NORMAL = {"clamped": Roller(value=1e-4 * x), "left": Roller(value=-1e-3)}
TANGENTIAL = {"clamped": Roller(tuple(TURN[:, 0])), "left": (0, 0.0)}
COMPONENT = {"clamped": (None, 0), "left": Roller(value=-1e-3)}
OBLIQUE = {"clamped": Roller((0.4, 0.9)), "left": Roller(tuple(TURN[:, 0]), 1e-3)}


def on_slanted_rollers(supports):
    """A turned block on supports that move it, with tractions there, too."""
    return Problem(
        moved_by(TURN, block.mesh(0.12, (1.0, 0.7))),
        MATERIAL,
        clamped=None,
        prescribed=supports,
        traction={"right": TRACTION, "clamped": (0.5, 0.4), "contact": (0.3, 0.6)},
        body_force=(1.0, -2.0),
        kinematics="plane strain",
        order=1,
    )


PROBLEMS = {
    "lshape": lambda: lshape_problem(lshape.paper_mesh(113)),
    "wrench": lambda: wrench_problem(wrench.paper_mesh(245)),
    "pressed block": pressed_block,
    "rollers": rollers,
    "rollers in two dimensions": lambda: rollers("two-dimensional"),
    "tangential roller": tangential_roller,
    "friction": dragged,
    "springs": on_springs,
    "slanted rollers": lambda: on_slanted_rollers(NORMAL),
    "slanted, tangential": lambda: on_slanted_rollers(TANGENTIAL),
    "slanted, oblique": lambda: on_slanted_rollers(OBLIQUE),
    "slanted, a component": lambda: on_slanted_rollers(COMPONENT),
}
TWICE = ("lshape", "wrench", "pressed block", "rollers", "friction", "springs")
TWICE += ("slanted rollers", "slanted, tangential", "slanted, oblique")
TWICE += ("slanted, a component",)
PROBLEMS |= {f"{name}, order 2": lambda name=name: of_order_two(name) for name in TWICE}


def of_order_two(name):
    return replace(PROBLEMS[name](), order=2)


@pytest.fixture(scope="module", params=PROBLEMS)
def result(request):
    return semismooth_newton(PROBLEMS[request.param]())


@pytest.fixture(scope="module")
def bound(result):
    return error_bound(result)


def corners(bound):
    """Stress tensors (nt, 3, k, 2, 2) at the nodes of the sub-triangles, places (nt, 3, 3, 2)."""
    sigma = (
        ELEMENTS[2]
        .tensors(bound.admissible)
        .reshape(len(bound.admissible), 3, -1, 2, 2)
    )
    mesh = bound.state.discrete.problem.mesh
    points = np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, :2]
    nodes = np.array([[v.nr for v in element.vertices] for element in mesh.Elements()])
    places = points[nodes]
    turned = np.linalg.det(places[:, 1:] - places[:, :1]) < 0
    nodes[turned] = nodes[turned][:, [0, 2, 1]]
    places, centres = points[nodes], points[nodes].mean(axis=1)
    around = [np.stack([places[:, i], places[:, j], centres], axis=1) for i, j in PAIRS]
    return sigma, np.stack(around, axis=1), nodes


def on_side(sigma, pair):
    """The nodes of a part on the side between two of its corners: its ends, and the middle."""
    middles = {frozenset(ends): 3 + number for number, ends in enumerate(PAIRS)}
    return [*pair, middles[frozenset(pair)]][: 2 if sigma.shape[2] == 3 else 3]


def tractions(bound):
    """{edge: [(tractions at its ascending vertices and in the middle, outer normal), ...]}"""
    sigma, places, nodes = corners(bound)
    found = {}
    for k, pair in enumerate(PAIRS):
        t = places[:, k, 1] - places[:, k, 0]
        n = np.stack([t[:, 1], -t[:, 0]], axis=1) / np.linalg.norm(t, axis=1)[:, None]
        sn = np.einsum("tnij,tj->tni", sigma[:, k, on_side(sigma, (0, 1))], n)
        for ends, values, normal in zip(nodes[:, pair].tolist(), sn, n, strict=True):
            ordered = values if ends[0] < ends[1] else values[[1, 0, 2][: len(values)]]
            found.setdefault(tuple(sorted(ends)), []).append((ordered, normal))
    return found


def size(bound):
    return np.abs(bound.admissible).max()


def node_slopes(at, count):
    """Derivatives of the functions of 3 or 6 nodes for the barycentric coordinates, at a place."""
    if count == 3:
        return np.eye(3)
    vertices = np.diag(4 * at - 1)
    middles = [4 * (at[i] * np.eye(3)[j] + at[j] * np.eye(3)[i]) for i, j in PAIRS]
    return np.concatenate([vertices, middles])


def test_divergence(bound):
    """At the corners of the parts: what is affine vanishes with its values there."""
    sigma, places, _ = corners(bound)
    frames = places[:, :, 1:] - places[:, :, :1]
    hats = np.linalg.inv(
        frames
    )  # gradients of the hat functions of corners 1 and 2 as columns
    hats = np.concatenate([-hats.sum(axis=3, keepdims=True), hats], axis=3)
    f = bound.problem.body_force or (0.0, 0.0)
    width = np.abs(frames).max(axis=(1, 2, 3)).min()
    for corner in np.eye(3):
        slopes = np.einsum("tkdv,nv->tknd", hats, node_slopes(corner, sigma.shape[2]))
        divergence = np.einsum("tknd,tknid->tki", slopes, sigma)
        assert np.abs(divergence + np.array(f)).max() <= 1e-11 * size(bound) / width


def test_tractions_are_continuous(bound):
    jumps = [
        a + b
        for a, b in (
            [s[0] for s in sides]
            for sides in tractions(bound).values()
            if len(sides) == 2
        )
    ]
    assert np.abs(jumps).max() <= 1e-12 * size(bound)


def test_inner_tractions_are_continuous(bound):
    sigma, places, _ = corners(bound)
    for k, j in (
        (0, 1),
        (1, 2),
        (2, 0),
    ):  # the end j' of k is the end i' of the next one
        shared = next(v for v in PAIRS[k] if v in PAIRS[j])
        a, b = PAIRS[k].index(shared), PAIRS[j].index(shared)
        t = places[:, k, 2] - places[:, k, a]
        n = np.stack([t[:, 1], -t[:, 0]], axis=1) / np.linalg.norm(t, axis=1)[:, None]
        sides = (on_side(sigma, (end, 2)) for end in (a, b))
        for at_k, at_j in zip(*sides, strict=True):
            jump = np.einsum("tij,tj->ti", sigma[:, k, at_k] - sigma[:, j, at_j], n)
            assert np.abs(jump).max() <= 1e-12 * size(bound)


def given_traction(problem, name, points, n):
    """The traction at two points of a boundary with the outer normal n, by hand."""
    if name == "load":
        return np.array([n, n]) * (-10.0 if problem.gap == 0.1 else -6e-3)
    if name == "right" and problem.body_force:
        return np.array([(3.0, -1.0 - 2 * height) for _, height in points])
    g = (problem.traction or {}).get(name, (0.0, 0.0))
    return np.array([g, g])


def pulled_by_springs(bound):
    """{edge: tractions of the springs at its ascending vertices}"""
    foundation = data_on(bound.state.discrete).foundation
    ends = foundation.nodes[:, :2].tolist()
    pulled = -np.matmul(bound.sprung, foundation.stiffness)
    return {tuple(end): traction for end, traction in zip(ends, pulled, strict=True)}


def test_boundary(bound):
    """Given tractions hold; contact presses, with no more shear than friction allows."""
    springs = pulled_by_springs(bound)
    problem, found = bound.problem, tractions(bound)
    known = {name: np.zeros((2, 2)) for name in problem.clamped_names}
    for name, support in problem.single("prescribed").items():
        if not isinstance(support, Roller):
            known[name] = np.diag([float(value is None) for value in support])
    mesh = bound.state.discrete.problem.mesh
    for segment in mesh.Elements(BND):
        ends = tuple(sorted(v.nr for v in segment.vertices))
        ((sn, n),) = found[ends]
        if segment.mat in problem.contact_names:
            pressure = -sn @ n
            assert pressure.min() >= -1e-12 * size(bound)
            points = np.asarray(mesh.ngmesh.Coordinates())[list(ends), :2]
            places = np.concatenate([points, points.mean(axis=0, keepdims=True)])[
                : len(sn)
            ]
            most = 0.3 + 0.2 * places[:, 0] if problem.friction else 0.0
            shear = np.linalg.norm(sn + pressure[:, None] * n, axis=1)
            assert (shear - most).max() <= 1e-12 * size(bound)
            continue
        part = known.get(segment.mat, np.eye(2))
        if segment.mat in problem.rollers:
            d = problem.rollers[segment.mat].direction or n
            part = np.eye(2) - np.outer(d, d) / np.dot(d, d)
        points = np.asarray(mesh.ngmesh.Coordinates())[list(ends), :2]
        expected = given_traction(problem, segment.mat, points, n)
        expected = expected + springs.get(ends, 0.0)
        expected = np.concatenate([expected, expected.mean(axis=0, keepdims=True)])[
            : len(sn)
        ]
        assert np.abs((sn - expected) @ part).max(initial=0.0) <= 1e-12 * size(bound)


def test_indicators_are_nowhere_negative(bound):
    assert bound.per_cell.min() >= -1e-12 * bound.strain_energy
    assert bound.per_cell.sum() == bound.total


def test_the_algebraic_part_is_what_clearing_the_obstacle_costs(result, bound):
    """Solved problems have none but where a displacement is moved: parabolas, convex obstacles."""
    if bound.given is not None:  # on a bisected copy of the mesh nothing is moved
        assert bound.moved < 1e-12
        assert bound.algebraic == pytest.approx(0.0, abs=1e-9 * bound.total)
        return
    added = bound.state.energy - result.state.energy
    assert bound.moved or added == 0
    assert bound.algebraic == pytest.approx(added, rel=0.01, abs=1e-9 * bound.total)


def test_energies_of_meshes_do_not_cross(bound):
    """A lower bound from a coarse mesh is below the energy on every fine one."""
    # errors fall slowly at the corner between two rollers that are not at right angles
    bisections = 2 if bound.problem.prescribed == OBLIQUE else 1
    fine = error_bound(semismooth_newton(finer(bound.problem, bisections)))
    assert bound.least_energy < fine.energy
    assert fine.least_energy < fine.energy < bound.energy
    assert bound.least_energy < fine.least_energy
    # order two: the affine pressure of the bound follows the rows on coarse meshes only so far
    sharp = {1: 1.7, 2: 1.6}[bound.problem.order]
    assert bound.total < sharp * (bound.energy - fine.energy + fine.total / 2)


def test_displacements_are_clear_of_the_obstacle(bound):
    """In many points of each contact edge, where parabolas have their own maximum."""
    problem = bound.problem
    if not problem.contact_names:
        pytest.skip("nothing to touch")
    discrete = bound.state.discrete
    u = GridFunction(discrete.supports.space)
    u.vec.FV().NumPy()[:] = bound.state.u.T.ravel()
    rule = IntegrationRule([(t,) for t in np.linspace(0, 1, 21)], [1 / 21] * 21)
    mesh = discrete.problem.mesh
    region = mesh.Boundaries("|".join(problem.contact_names))
    points = mesh.MapToAllElements({ET.SEGM: rule}, region)
    depth = (InnerProduct(u, specialcf.normal(2)) - problem.psi)(points)
    assert np.max(depth) <= 1e-11 * np.abs(bound.state.u).max()
