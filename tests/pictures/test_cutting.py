"""Parts of bodies: sections have the area of geometry, linear fields are exact on them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from ngsolve import CF, x, y, z
from ngsolve.meshes import MakeStructured3DMesh
from solved import two_blocks

from ngepc import Material, Problem, lshape_problem, plot_field, semismooth_newton, show
from ngepc.geometries import block, lshape
from ngepc.pictures import views
from ngepc.pictures.cutting import Part, clipped, part_of, section
from ngepc.pictures.sampling import corners_of, visible
from ngepc.results.fields import Fields

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
)
FIELD = 1 + 2 * x - y + 3 * z


@lru_cache
def at_rest(kind, order=1):
    """The fields of a body at rest: a unit cube of tetrahedra, prisms or hexahedra."""
    if kind == "tetrahedra":
        mesh = block.mesh(0.5)
    else:
        mesh = MakeStructured3DMesh(
            hexes=kind == "hexahedra", prism=kind == "prisms", nx=2, ny=2, nz=2
        )
    names = mesh.GetBoundaries()
    problem = Problem(mesh, STEEL, clamped=names[0], order=order)
    return semismooth_newton(problem).fields


KINDS = ["tetrahedra", "prisms", "hexahedra"]
DIAGONAL = ((0.5, 0.5, 0.5), (1.0, 1.0, 1.0))
PLANES = {
    ((0.3, 0.0, 0.0), (1.0, 0.0, 0.0)): 1.0,
    ((0.5, 0.5, 0.0), (1.0, -1.0, 0.0)): np.sqrt(2),
    DIAGONAL: 0.75 * np.sqrt(3),  # a regular hexagon with sides 1/sqrt(2)
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("plane", PLANES)
def test_sections_have_their_area(kind, plane):
    fields = at_rest(kind)
    found = section(fields, FIELD, Part(cut=plane).checked(fields.problem.mesh))
    # areas of slivers are square roots of rounding
    assert found.measures.sum() == pytest.approx(PLANES[plane], rel=1e-8)
    X, Y, Z = np.moveaxis(found.points, 2, 0)
    np.testing.assert_allclose(found.values, 1 + 2 * X - Y + 3 * Z, atol=1e-12)
    point, normal = plane
    np.testing.assert_allclose((found.points - point) @ normal, 0.0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 2])
def test_triangles_of_a_section_fit_together(kind, order):
    """Each edge within the body has two; others were drawn as lines across the section."""
    oblique = ((0.41, 0.37, 0.45), (0.3, 0.5, 0.8))
    found = section(at_rest(kind, order), FIELD, Part(cut=oblique))
    places, corners = np.unique(
        found.points.reshape(-1, 3).round(9), axis=0, return_inverse=True
    )
    sides = corners.reshape(-1, 3)[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    sides = sides[sides[:, 0] != sides[:, 1]]
    edges, count = np.unique(np.sort(sides), axis=0, return_counts=True)
    ends = places[edges[count == 1]]
    assert len(ends)
    assert ((ends == 0.0).all(axis=1) | (ends == 1.0).all(axis=1)).any(axis=1).all()
    assert count.max() == 2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 2])
def test_what_is_left_is_closed(kind, order):
    """The divergence theorem with the triangles that are drawn: half of the cube."""
    fields = at_rest(kind, order)
    part = Part(cut=DIAGONAL)
    drawn = part_of(fields, visible(fields, FIELD), FIELD, part)
    a, b, c = np.moveaxis(drawn.points - 0.5, 1, 0)
    volume = np.abs(np.einsum("ti,ti->t", a, np.cross(b, c))).sum() / 6
    assert volume == pytest.approx(0.5, rel=1e-9)  # seen from the centre, a star


def test_plane_bodies_are_cut_along_a_line():
    fields = semismooth_newton(lshape_problem(lshape.paper_mesh(113))).fields
    whole = corners_of(fields, CF(1.0))
    left = clipped(whole, ((0.25, 0.0), (1.0, 0.0)))
    right = clipped(whole, ((0.25, 0.0), (-1.0, 0.0)))
    assert left.measures.sum() + right.measures.sum() == pytest.approx(0.75)
    assert left.measures.sum() == pytest.approx(0.25 * 0.5)
    assert left.points[..., 0].max() <= 0.25 + 1e-12


def test_one_of_two_bodies_and_its_inner_face():
    result = two_blocks()
    assert result.status.label == "converged"
    fields = result.fields
    on_surface = visible(fields, CF(1.0))
    upper = part_of(fields, on_surface, CF(1.0), Part(body="upper"))
    assert upper.points[..., 2].min() == pytest.approx(1.0)
    assert upper.measures.sum() == pytest.approx(6.0)
    figure = plot_field(result, "contact_pressure", boundary="over")
    assert figure.axes[1].get_ylabel() == "contact pressure"
    drawn = part_of(fields, result.contact_pressure, None, Part(boundary="over"))
    assert drawn.values.mean() == pytest.approx(0.5, rel=1e-6)
    assert drawn.measures.sum() == pytest.approx(1.0)
    part = Part(boundary="over", cut=((0.25, 0.0, 0.0), (1.0, 0.0, 0.0)))
    beside = part_of(fields, result.contact_pressure, CF(7.0), part)
    assert beside.measures.sum() == pytest.approx(0.25)
    assert beside.values.max() < 1.0


@pytest.mark.parametrize("part", [{"boundary": "under"}, {"body": "lower"}])
def test_the_second_face_of_two_bodies_has_no_pressure_of_its_own(part):
    with pytest.raises(ValueError, match="the first one of two bodies: 'over'"):
        plot_field(two_blocks(), "contact_pressure", **part)


def test_what_is_no_part_is_refused():
    result = two_blocks()
    plane = semismooth_newton(lshape_problem(lshape.paper_mesh(113)))
    for bad, message in (
        ({"body": "middle"}, "one of 'lower', 'upper' is needed"),
        ({"boundary": "inner"}, "there is no boundary 'inner'"),
        ({"cut": (0.5, 0, 0)}, "a pair of a point and a normal"),
        ({"cut": ((0, 0, 9.0), (0, 0, -1.0))}, "nothing is left"),
        ({"cmap": "rainbows"}, "colour map of matplotlib"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            plot_field(result, **bad)
    with pytest.raises(ValueError, match="plot_contact_pressure"):
        plot_field(plane, boundary="contact")
    with pytest.raises(
        ValueError, match=r"draw the result or the step \(.steps\[-1\]\)"
    ):
        plot_field(result.fields, "contact_pressure")


@pytest.mark.skipif(not views.viewer_installed(), reason="no viewer")
def test_pages_show_parts():
    whole = show(two_blocks(), "von_mises")
    cut = show(two_blocks(), "von_mises", cut=((0.5, 0.5, 0.5), (0.0, 1.0, 0.0)))
    assert whole.html != cut.html
    other = show(two_blocks(), "von_mises", body="upper", cmap="magma")
    assert other.html not in (whole.html, cut.html)


def test_fields_of_ones_own_are_cut_too():
    fields = replace(at_rest("tetrahedra"))
    assert isinstance(fields, Fields)
    figure = plot_field(fields, FIELD, cut=DIAGONAL, vmin=0, vmax=5)
    assert figure.axes
