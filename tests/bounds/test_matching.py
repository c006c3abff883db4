"""Error bounds of two bodies that meet on a line, and of parts that contact alone holds."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from campaigns.crossings import finer
from netgen.meshing import Element1D, Element2D, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from netgen.occ import Compound, MoveTo, OCCGeometry, Rectangle
from ngsolve import Mesh
from pairs import in_turn
from stacked import (
    ELASTIC,
    LEFT,
    PAIR,
    TURNED,
    YIELDING,
    between,
    blocks,
    named,
    on_a_floor,
    pressed,
    pushed,
)

from ngepc import (
    Contact,
    Coulomb,
    Problem,
    confidence,
    error_bound,
    primal_newton,
    semismooth_newton,
    solve_to,
)
from ngepc.bounds.matching import Interface, matched
from ngepc.bounds.of_state import bound_data_of, bound_of
from ngepc.bounds.simplices import Simplices


def grids(shift, bodies=("lower", "upper")):
    """The same bodies with uniform nodes; those of the square are shifted."""
    mesh = NetgenMesh(dim=2)
    names = ("bottom", "right", "below", "left", "above", "top")
    number = {name: mesh.AddRegion(name, dim=1) for name in names}

    def add(body, count, corner, width, sides):
        """A rectangle of height one with names of its sides."""
        n, m = count
        region = mesh.AddRegion(body, dim=2)
        x = corner[0] + width * (np.arange(n + 1) / n)
        y = corner[1] + np.arange(m + 1) / m
        at = [[mesh.Add(MeshPoint(Pnt(a, b, 0))) for a in x] for b in y]
        for low, high in pairwise(at):
            for a, b, c, d in zip(low, low[1:], high[1:], high, strict=False):
                mesh.Add(Element2D(region, [a, b, c]))
                mesh.Add(Element2D(region, [a, c, d]))
        lines = at[0], [row[-1] for row in at], at[-1], [row[0] for row in at]
        for line, name in zip(lines, sides, strict=True):
            for ends in pairwise(line):
                mesh.Add(Element1D(list(ends), index=number[name]))

    if "lower" in bodies:
        add("lower", (8, 4), (0, 0), 2, ("bottom", "right", "below", "left"))
    if "upper" in bodies:
        add("upper", (4, 4), (0.5 + shift, 1), 1, ("above", "right", "top", "left"))
    return Mesh(mesh)


def test_facets_are_cut_where_a_node_faces_them():
    mesh = blocks()
    finer_mesh, parents = matched(mesh, [PAIR])
    cells = Simplices.of(mesh)
    children = Simplices.of(finer_mesh)
    assert np.bincount(parents, children.volume) == pytest.approx(
        cells.volume, rel=1e-13
    )
    assert np.array_equal(children.points[: mesh.nv], cells.points)
    assert finer_mesh.GetBoundaries() == mesh.GetBoundaries()
    assert finer_mesh.GetMaterials() == mesh.GetMaterials()
    middle = children.points[children.nodes].mean(axis=1)
    from_corner = middle - cells.points[cells.nodes[parents, 0]]
    share = np.einsum("tij,tj->ti", cells.inverse[parents], from_corner)
    assert (share > 0).all()
    assert (share.sum(axis=1) < 1).all()
    assert matched(finer_mesh, [PAIR, TURNED]) is None
    facing = Interface(children, PAIR).facing()
    apart = children.points[facing.first] - children.points[facing.second]
    assert np.abs(apart).max() < 1e-14
    assert np.abs(
        np.diff(children.points[facing.first][:, :, 0])
    ).sum() == pytest.approx(1)


@pytest.mark.parametrize(
    ("order", "pair", "gap"),
    [(1, PAIR, 0.0), (2, TURNED, 0.0), (1, TURNED, 1e-3), (2, PAIR, 1e-3)],
)
def test_the_bound_of_a_constant_stress_is_zero(order, pair, gap):
    """One square above the other: floating, or pushed, with meshes that do not match."""
    lower = named(Rectangle(1, 1).Face(), 0.31, "bottom", "below")
    upper = named(MoveTo(0, 1 + gap).Rectangle(1, 1).Face(), 0.17, "above", "top")
    mesh = Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=1))
    held = LEFT | {"bottom": (None, 0)}
    floating = Problem(
        mesh,
        ELASTIC,
        None,
        {"top": (0, -3)},
        prescribed=held,
        contact=pair,
        order=order,
    )
    moved = {"top": (None, -0.02 - gap)}
    driven = Problem(
        mesh, ELASTIC, None, prescribed=held | moved, contact=pair, order=order
    )
    for problem in (floating, driven):
        bound = error_bound(semismooth_newton(problem))
        assert abs(bound.total) < 1e-11 * bound.strain_energy
        assert np.ptp(bound.pressure) < 1e-9 * bound.pressure.max()


@pytest.mark.parametrize(
    ("order", "made", "pair"),
    [(1, pressed, PAIR), (2, pressed, TURNED), (1, pushed, TURNED), (2, pushed, PAIR)],
)
def test_energies_do_not_cross(order, made, pair):
    problem = made(order, pair)
    bound = error_bound(semismooth_newton(problem))
    fine = error_bound(semismooth_newton(finer(problem, 2)))
    assert bound.least_energy < fine.energy
    assert fine.least_energy < bound.energy
    assert bound.total < 2.0 * (bound.energy - fine.least_energy)
    assert -1e-12 * bound.total < bound.algebraic < bound.total
    assert bound.per_cell.min() > -1e-9 * bound.total
    assert len(bound.per_cell) == problem.mesh.ne


@pytest.mark.parametrize("order", [1, 2])
def test_meshes_that_match_need_no_copy(order):
    """The displacement of the result is that of the bound."""
    result = semismooth_newton(pressed(order, mesh=grids(0.0)))
    bound = error_bound(result)
    assert bound.moved <= 1e-12 * np.abs(result.state.u).max()
    assert bound.algebraic < 1e-9 * bound.total


@pytest.mark.parametrize(("shift", "order"), in_turn([1e-1, 1e-2, 1e-4], [1, 2]))
def test_nodes_close_to_each_other(shift, order):
    """Flat elements make the bound less sharp, most of all at the corners of the square."""
    least = error_bound(semismooth_newton(pressed(order, mesh=grids(0.0))))
    bound = error_bound(semismooth_newton(pressed(order, mesh=grids(shift))))
    assert 0.5 * least.total < bound.total < 8 * least.total


def test_nodes_too_close_to_each_other_are_refused():
    result = semismooth_newton(pressed(mesh=grids(1e-7)))
    with pytest.raises(RuntimeError, match="nodes that nearly coincide"):
        error_bound(result)
    assert confidence(result).startswith("Estimate")
    rounded = error_bound(semismooth_newton(pressed(mesh=grids(1e-13))))
    exact = error_bound(semismooth_newton(pressed(mesh=grids(0.0))))
    assert rounded.total == pytest.approx(exact.total, rel=1e-6)


def keel(maxh=0.4):
    """A block, and a body above it whose lower side consists of two inclined edges."""
    lower = named(Rectangle(2, 1).Face(), 0.5, "bottom", "below")
    points = [(0.5, 1.02), (0.9, 1.0), (1.5, 1.03), (1.5, 1.8), (0.5, 1.8)]
    line = MoveTo(*points[0])
    for point in points[1:]:
        line = line.LineTo(*point)
    upper = line.Close().Face()
    upper = named(upper, maxh, "above", "top")
    for edge in upper.edges:
        if edge.center.y < 1.1:
            edge.name = "above"
    return Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=1))


@pytest.mark.parametrize("order", [1, 2])
def test_the_second_boundary_may_be_inclined(order):
    held = {"top": (0.0, -0.03)}
    problem = Problem(
        keel(), YIELDING, "bottom", prescribed=held, contact=TURNED, order=order
    )
    bound = error_bound(semismooth_newton(problem))
    fine = error_bound(semismooth_newton(finer(problem, 2)))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.total < 2.5 * (bound.energy - fine.least_energy)


@pytest.mark.parametrize("order", [1, 2])
def test_a_body_without_loads_between_two_others(order):
    """What its pressures leave was compared with its loads, which are zero."""
    squeezed = Problem(
        between(0.25, 2),
        YIELDING,
        "bottom",
        prescribed=LEFT | {"top": (0, -4e-3)},
        contact=[PAIR, Contact("under", "over")],
        order=order,
    )
    bound = error_bound(semismooth_newton(squeezed))
    fine = error_bound(semismooth_newton(finer(squeezed, 2)))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.total < 2.5 * (bound.energy - fine.least_energy)


@pytest.mark.parametrize("mesh", [blocks(), keel()], ids=["straight", "inclined"])
def test_action_is_reaction(mesh):
    """The tractions of the stress on facing facets, per length of the first, add up to zero."""
    held = {"top": (0.0, -0.03)}
    problem = Problem(mesh, ELASTIC, "bottom", prescribed=held, contact=TURNED, order=1)
    bound = error_bound(semismooth_newton(problem))
    cells = Simplices.of(bound.state.discrete.problem.mesh)
    facing = Interface(cells, TURNED).facing()
    first = tractions(bound, cells, facing.first)
    second = tractions(bound, cells, facing.second)
    size = np.abs(bound.admissible).max()
    assert np.abs(first + second).max() < 1e-9 * size
    assert np.abs(first @ [1.0, 0.0]).max() < 1e-9 * size
    assert (first @ [0.0, 1.0]).max() < 1e-9 * size
    assert np.abs(first).max() > 0.1 * bound.pressure.max()


def tractions(bound, cells, ends):
    """Tractions at the ends of facets (facets, 2, 2), per length of their projection on x."""
    facets = cells.facets_between(ends)
    owner = cells.owners[facets, 0]
    result = np.empty((len(facets), 2, 2))
    for k, (facet, cell) in enumerate(zip(facets, owner, strict=True)):
        local = list(cells.facet_of[cell]).index(facet)
        corners = cells.nodes[cell]
        length = cells.measure[facet] / abs(np.diff(cells.points[ends[k], 0])[0])
        for place, end in enumerate(ends[k]):
            s = stress_at(bound.admissible[cell], local, list(corners).index(end))
            result[k, place] = s @ cells.normal[facet] * length
    return result


def stress_at(values, part, corner):
    """The stress at a corner, of the part of a triangle opposite to vertex ``part``."""
    nodes = [(part + 1) % 3, (part + 2) % 3]
    mean, half, shear = values.reshape(3, 3, 3)[part, nodes.index(corner)]
    root = 2**0.5
    return np.array(
        [[mean + half / root, shear / root], [shear / root, mean - half / root]]
    )


def test_three_bodies_on_top_of_each_other():
    """Two of them float; the exact stress is constant."""
    bodies = []
    sides = (("bottom", "a"), ("b", "c"), ("d", "top"))
    for level, (maxh, names) in enumerate(zip((0.3, 0.2, 0.4), sides, strict=True)):
        body = MoveTo(0, level).Rectangle(1, 1).Face()
        bodies.append(named(body, maxh, *names))
    mesh = Mesh(OCCGeometry(Compound(bodies), dim=2).GenerateMesh(maxh=1))
    problem = Problem(
        mesh,
        ELASTIC,
        None,
        {"top": (0, -3)},
        prescribed=LEFT | {"bottom": (None, 0)},
        contact=[Contact("b", "a"), Contact("d", "c")],
        order=1,
    )
    bound = error_bound(semismooth_newton(problem))
    assert abs(bound.total) < 1e-10 * bound.strain_energy


@pytest.mark.parametrize("order", [1, 2])
def test_a_square_that_may_slide(order):
    """Nothing holds it but contact: it may also rotate, and slide."""
    problem = replace(pressed(order), prescribed=None)
    result = semismooth_newton(problem)
    assert result.undetermined_motions == 1
    bound = error_bound(result)
    fine = error_bound(semismooth_newton(finer(problem, 2)))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.total < 2.0 * (bound.energy - fine.least_energy)


@pytest.mark.parametrize("order", [1, 2])
def test_a_column_on_a_rigid_floor(order):
    """Contact alone holds it; the exact stress is constant."""
    bound = error_bound(semismooth_newton(on_a_floor(order)))
    assert abs(bound.total) < 1e-11 * bound.strain_energy
    assert bound.pressure == pytest.approx(np.full(bound.pressure.shape, 2.0), rel=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_bounds_of_bodies_that_never_meet_add_up(order):
    """Two rectangles that nothing connects have the sum of the bounds of both."""
    load = {"top": (0.4, -0.2), "below": (0.2, -0.1)}
    held = {"lower": "bottom", "upper": "above"}

    def bound(*bodies):
        """The bound of some of the bodies, without a copy."""
        clamped = "|".join(held[body] for body in bodies)
        names = {"lower": "below", "upper": "top"}
        loads = {names[body]: load[names[body]] for body in bodies}
        problem = Problem(grids(0.0, bodies), YIELDING, clamped, loads, order=order)
        result = semismooth_newton(problem)
        return bound_of(bound_data_of(result.discrete), result.state)

    both = bound("lower", "upper")
    alone = [bound("lower"), bound("upper")]
    assert both.state.at.yields.any()
    assert both.energy == pytest.approx(sum(one.energy for one in alone), rel=1e-10)
    assert both.total == pytest.approx(sum(one.total for one in alone), rel=0.02)


@pytest.mark.parametrize("order", [1, 2])
def test_solve_to(order):
    run = solve_to(pressed(order), 0.02)
    assert run.reached
    assert run.guaranteed
    fine = error_bound(semismooth_newton(finer(run.result.problem, 2)))
    assert run.bound.least_energy < fine.least_energy < fine.energy < run.bound.energy
    assert confidence(run.result).startswith("Guaranteed")
    assert all(mesh.algebraic < 0.3 * mesh.total for mesh in run.records)


def test_other_methods_and_stopped_results():
    problem = pressed()
    exact = error_bound(semismooth_newton(problem))
    other = error_bound(primal_newton(problem))
    assert other.total == pytest.approx(exact.total, rel=1e-6)


REFUSED = {
    "an inclined first boundary": (
        lambda: pressed(mesh=keel()),
        "needs a straight first boundary; around an edge give one pair for each side",
    ),
    "tied": (
        lambda: pressed(pair=Contact("above", "below", tied=True)),
        "bodies that are not tied",
    ),
    "friction": (
        lambda: pressed(friction=0.1),
        r"friction needs rigid obstacles only, not two bodies; error_indicators\(result\)",
    ),
    "Coulomb": (lambda: pressed(friction=Coulomb(0.3)), "a given bound F"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_bounds_do_not_cover_is_refused(name):
    made, message = REFUSED[name]
    problem = made()
    with pytest.raises(ValueError, match=message):
        solve_to(problem)


def test_quadrilaterals_of_two_bodies_are_refused_with_the_remedy():
    """Which is ``solve_to``: it cuts them."""
    lower = named(Rectangle(2, 1).Face(), 0.5, "bottom", "below")
    upper = named(MoveTo(0.5, 1).Rectangle(1, 1).Face(), 0.5, "above", "top")
    bodies = OCCGeometry(Compound([lower, upper]), dim=2)
    problem = pressed(mesh=Mesh(bodies.GenerateMesh(maxh=1, quad_dominated=True)))
    assert "quadrilaterals" in problem.features
    with pytest.raises(ValueError, match="not two bodies; solve_to cuts elements"):
        error_bound(semismooth_newton(problem))
    assert solve_to(problem, relative_error=0.9).bound.guaranteed
