"""Still pictures of solids: what is in front hides what is behind, in the colours of the scale."""

import sys
from functools import cache

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, rgb_to_hsv, to_rgb
from ngsolve import CF
from solved import block_primal

from ngepc.geometries import block
from ngepc.model.problem import Problem
from ngepc.pictures import plot_field, plot_plastic_zone, stills
from ngepc.pictures.stills import solid_image
from ngepc.pictures.style import ELASTIC, PLASTIC
from ngepc.primal.solver import primal_newton

pytestmark = pytest.mark.usefixtures("draws_solids")
SIZE = (3.0, 2.0, 1.0)
CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 0), (1, 1), (0, 1)]).reshape(2, 3, 2)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Coarser pictures than those of users."""
    monkeypatch.setattr(stills, "SIDE", 600)


def box():
    """The surface of a box in triangles, and the number of the face of each: x-, x+, y-, ..."""
    faces = [
        np.insert(CORNERS.astype(float), axis, end, axis=2)
        for axis in range(3)
        for end in (0, 1)
    ]
    return np.concatenate(faces) * SIZE, np.repeat(np.arange(6.0), 6).reshape(12, 3)


@cache
def seen(around, above):
    """A picture of the box from there, and its scale."""
    scale = ScalarMappable(Normalize(0, 5), colormaps["tab10"].resampled(6))
    return solid_image(*box(), scale, view=(around, above)), scale


def opaque(image):
    return image[..., 3] > 128


@pytest.mark.parametrize(
    ("around", "above", "face"), [(180, 0, 0), (90, 0, 3), (30, 90, 5)]
)
def test_the_face_in_front_is_seen_in_its_colour(around, above, face):
    image, scale = seen(around, above)
    rows, columns = np.nonzero(opaque(image))
    middle = image[int(np.median(rows)), int(np.median(columns)), :3] / 255
    hues = [rgb_to_hsv(scale.to_rgba(k)[:3]) for k in range(6)]
    near = [np.abs(np.exp(2j * np.pi * rgb_to_hsv(middle)[0]) - np.exp(2j * np.pi * h[0]))
            + abs(rgb_to_hsv(middle)[1] - h[1]) for h in hues]  # fmt: skip
    assert int(np.argmin(near)) == face


def test_a_plastic_zone_is_dark_and_the_rest_is_light():
    """The mean colour of the body; orange is for contact, in pictures of active sets."""
    for threshold, colour in ((0.0, PLASTIC), (1e9, ELASTIC)):
        image = (
            plot_plastic_zone(block_primal(), threshold).axes[0].images[0].get_array()
        )
        mean = image[opaque(image), :3].mean(axis=0) / 255
        assert mean.tolist() == pytest.approx(to_rgb(colour), abs=0.2)


def test_areas_are_those_of_parallel_projections():
    """Box a x b x c: bc, ac and ab from the axes, and (bc + ac + ab) / sqrt(3) from a diagonal."""
    diagonal = np.degrees(np.arctan(1 / np.sqrt(2)))
    views = [(0, 0), (90, 0), (0, 90), (45, diagonal)]
    areas = np.array([opaque(seen(*view)[0]).sum() for view in views])
    exact = np.array([2.0, 3.0, 6.0, 11 / np.sqrt(3)])
    np.testing.assert_allclose(areas / areas[2], exact / 6, rtol=0.03)


def test_a_field_is_interpolated_inside_triangles():
    points, _ = box()
    scale = ScalarMappable(Normalize(0, SIZE[0]), "gray")
    image = solid_image(points, points[..., 0], scale, view=(-90, 0)).astype(float)
    width = np.flatnonzero(opaque(image)[image.shape[0] // 2])
    row = image[image.shape[0] // 2, width[20] : width[-20], 0]
    straight = np.linspace(row[0], row[-1], len(row))
    assert row[-1] - row[0] > 100
    assert np.abs(row - straight).max() < 0.05 * (row[-1] - row[0])


def test_pictures_take_views_and_lines_and_leave_the_environment(monkeypatch):
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    result = block_primal()
    above, aside = (
        plot_field(result, "displacement_z", view=v).axes[0] for v in ((0, 90), None)
    )
    assert above.images[0].get_size() != aside.images[0].get_size()
    assert len(plot_field({"a": result, "b": result}, view=(20, 10)).axes) == 3
    lines, plain = (
        plot_field(result, mesh_lines=drawn).axes[0].images[0]
        for drawn in (True, False)
    )
    changed = (lines.get_array() != plain.get_array()).any(axis=2).mean()
    assert 0.001 < changed < 0.5
    assert "VTK_DEFAULT_OPENGL_WINDOW" not in stills.os.environ


def test_flat_faces_have_no_sharp_edges():
    """Corners that rounding keeps apart are one: seen from above, the middle is of one colour."""
    body = (
        plot_field(block_primal(), CF(1.0), view=(0, 90)).axes[0].images[0].get_array()
    )
    rows, columns = (slice(n // 10, -n // 10) for n in body.shape[:2])
    assert np.ptp(body[rows, columns].astype(int), axis=(0, 1)).max() < 20


def test_lines_behind_the_body_are_hidden():
    """A segment through the middle of the box is not seen; one in front of it is."""
    points, values = box()
    scale = ScalarMappable(Normalize(0, 5), "viridis")
    plain = solid_image(points, values, scale, view=(-90, 0))
    y = {"inside": 1.0, "in front": 0.0, "behind": 2.0}
    changed = {}
    for where, depth in y.items():
        line = np.array([[(0.5, depth, 0.5), (2.5, depth, 0.5)]])
        image = solid_image(points, values, scale, line, view=(-90, 0))
        changed[where] = (image != plain).any(axis=2).sum()
    assert changed["inside"] == 0
    assert changed["behind"] == 0
    assert changed["in front"] > 200


def test_the_contact_pressure_of_a_solid_is_drawn_where_it_touches():
    body, bar = plot_field(block_primal(), "contact_pressure", view=(0, 90)).axes
    assert bar.get_ylabel() == "contact pressure"
    image = body.images[0].get_array() / 255
    blue = opaque(255 * image) & (image[..., 2] > image[..., 0] + 0.1)
    assert 0.02 < blue.mean() < 0.5


def test_what_is_missing_is_named_with_the_line_that_installs_it(monkeypatch):
    with monkeypatch.context() as bare:
        bare.setitem(sys.modules, "pyvista", None)
        with pytest.raises(ImportError, match=r'pip install "ngepc\[stills\]"'):
            plot_field(block_primal())
    monkeypatch.setattr(stills, "LIBRARY", "libthatisnothere.so.1")
    with pytest.raises(ImportError, match="apt install libegl1"):
        plot_field(block_primal())


@pytest.mark.parametrize("view", ["above", (1.0,), (0, 90, 0), (0, float("nan")), 5])
def test_views_are_pairs_of_angles(view):
    with pytest.raises((TypeError, ValueError), match="view"):
        plot_field(block_primal(), view=view)


def test_solids_of_several_sizes_are_drawn_whole():
    """Each picture ends where its image ends, with the arrows of the axes on its left."""
    slab = Problem(
        block.mesh(0.5, (2.0, 1.0, 0.2)), block_primal().problem.material, order=1
    )
    bodies = {"cube": block_primal(), "slab": primal_newton(slab)}
    figure = plot_field(bodies, "displacement_z", vmin=-1, vmax=1)
    for axes in figure.axes[:2]:
        height, width = axes.images[0].get_size()
        assert axes.get_xlim()[1] == width
        assert axes.get_ylim()[0] == height
