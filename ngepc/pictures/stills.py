"""Still pictures of solids: VTK draws their triangles, without a screen, into an image."""

import ctypes
import os
import sys
from types import ModuleType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from scipy.spatial.transform import Rotation

from ngepc.pictures.style import DEFORMED, GUIDE

Angles = tuple[float, float]
VIEW: Angles = (-60.0, 25.0)
"""Where solids are seen from, in degrees: around the z axis from x, and above the xy plane."""
LIBRARY = "libEGL.so.1"
WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
SIDE = 1400
"""Of the square in which a solid is drawn, in pixels."""


def renderer() -> ModuleType:
    """The module pyvista; ImportError says what to install if it or a library is missing."""
    needed = 'pyvista: pip install "ngepc[stills]"'
    try:
        import pyvista

        needed = "libEGL, in Debian: apt install libegl1"
        if sys.platform == "linux" and WINDOW not in os.environ:
            ctypes.CDLL(LIBRARY)  # VTK crashes without this library
    except (ImportError, OSError) as error:
        raise ImportError(f"pictures of solids need {needed}") from error
    return pyvista


def draw_solid(axes: Axes, image: np.ndarray, view: Angles | None) -> None:
    """A ``solid_image``, and arrows along x, y and z on its left, in place of other axes."""
    height, width, _ = image.shape
    size = 0.08 * max(height, width)
    start = np.array([-1.2 * size, height - size])
    axes.imshow(image)
    axes.set(xlim=(-2.6 * size, width), ylim=(height, 0))
    axes.set_axis_off()
    arrow = {"arrowstyle": "<|-", "color": GUIDE, "shrinkB": 0, "linewidth": 0.8}
    at = {"ha": "center", "va": "center", "color": GUIDE, "fontsize": 8}
    for letter, along in zip("xyz", camera(view)[1:].T * (size, -size), strict=True):
        if np.linalg.norm(along) > 0.2 * size:
            axes.annotate(letter, start, start + 1.25 * along, arrowprops=arrow, **at)


def solid_image(
    points: np.ndarray,
    values: np.ndarray,
    colours: ScalarMappable,
    segments: np.ndarray | None = None,
    view: Angles | None = None,
) -> np.ndarray:
    """Triangles (n, 3, 3) with values at their corners (n, 3), lit, as an RGBA image.

    Edges where it turns by 30 degrees, and ``segments`` (lines, 2, 3), are lines; there are no
    margins.
    """
    pyvista = renderer()
    faces = np.arange(points.size // 3).reshape(-1, 3)
    body = pyvista.PolyData.from_regular_faces(points.reshape(-1, 3), faces)
    blind = sys.platform == "linux" and WINDOW not in os.environ
    try:  # otherwise VTK tries a screen first
        os.environ |= {WINDOW: "vtkEGLRenderWindow"} if blind else {}
        plotter = pyvista.Plotter(off_screen=True, window_size=(SIDE, SIDE))
    finally:
        if blind:
            del os.environ[WINDOW]
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    light = {"ambient": 0.55, "diffuse": 0.5, "specular": 0.0, "show_scalar_bar": False}
    shade = {
        "scalars": values.ravel(),
        "clim": colours.get_clim(),
        "cmap": colours.get_cmap(),
    }
    plotter.add_mesh(body, **shade, **light)
    sharp = body.clean(tolerance=1e-6).extract_feature_edges(30.0, manifold_edges=False)
    line = {"color": DEFORMED, "lighting": False}
    if sharp.n_cells:
        plotter.add_mesh(sharp, line_width=2.0, **line)
    if segments is not None:
        lines = pyvista.line_segments_from_points(segments.reshape(-1, 3))
        plotter.add_mesh(lines, line_width=1.0, **line)
    eye, _, up = camera(view)
    plotter.enable_parallel_projection()
    plotter.view_vector(eye, viewup=up)
    image = plotter.screenshot(transparent_background=True, return_img=True)
    plotter.close()
    rows, columns = (np.flatnonzero(image[..., 3].any(axis=axis)) for axis in (1, 0))
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def camera(view: Angles | None) -> np.ndarray:
    """The rotation whose rows are the directions to the right, up and to the eye."""
    around, above = VIEW if view is None else view
    return Rotation.from_euler("ZY", (around, -above), degrees=True).as_matrix().T
