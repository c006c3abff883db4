"""Still pictures of solids: VTK draws their triangles, without a screen, into an image."""

from __future__ import annotations

import ctypes
import os
import sys
from types import ModuleType
from unittest.mock import patch

import numpy as np
from matplotlib.cm import ScalarMappable

from ngepc.pictures.style import DEFORMED

Angles = tuple[float, float]
VIEW: Angles = (-60.0, 25.0)
"""Where solids are seen from, in degrees: around the z axis from x, and above the xy plane."""
PIXELS, SHARP = 1400, 30.0
"""Width of the square window; edges where the surface turns by more degrees are drawn."""
INSTALL = 'pictures of solids need pyvista: pip install "ngepc[stills]"'
LIBRARY, SYSTEM = "libEGL.so.1", "pictures of solids need libEGL, in Debian: apt install libegl1"
NO_SCREEN = {"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"} if sys.platform == "linux" else {}
"""What tells VTK not to look for a screen first."""


def renderer() -> ModuleType:
    """The module pyvista.

    Raises
    ------
    ImportError
        If it or the system's library is missing; the message says what to install.
    """
    try:
        import pyvista
    except ImportError as error:
        raise ImportError(INSTALL) from error
    if NO_SCREEN.keys() - os.environ:
        try:
            ctypes.CDLL(LIBRARY)
        except OSError as error:  # VTK itself would end in a segmentation fault
            raise ImportError(SYSTEM) from error
    return pyvista


def solid_image(
    points: np.ndarray,
    values: np.ndarray,
    scale: ScalarMappable,
    segments: np.ndarray | None = None,
    view: Angles | None = None,
) -> np.ndarray:
    """Triangles in space, lit and with their sharp edges, as an RGBA image without margins.

    Parameters
    ----------
    points, values
        Corners (triangles, 3, 3) and the values there (triangles, 3).
    scale
        Colours of the values.
    segments
        Further lines (lines, 2, 3), such as those of the mesh.
    view
        Degrees around the z axis and above the xy plane; ``VIEW`` for None.
    """
    pyvista = renderer()
    faces = np.arange(points.size // 3).reshape(-1, 3)
    body = pyvista.PolyData.from_regular_faces(points.reshape(-1, 3), faces)
    with patch.dict(os.environ, NO_SCREEN | os.environ):
        plotter = pyvista.Plotter(off_screen=True, window_size=(PIXELS, PIXELS))
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    light = {"ambient": 0.55, "diffuse": 0.5, "specular": 0.0, "show_scalar_bar": False}
    colours = {"scalars": values.ravel(), "clim": scale.get_clim(), "cmap": scale.get_cmap()}
    plotter.add_mesh(body, **colours, **light)
    sharp = body.clean().extract_feature_edges(SHARP, manifold_edges=False)
    line = {"color": DEFORMED, "lighting": False}
    if sharp.n_cells:
        plotter.add_mesh(sharp, line_width=2.0, **line)
    if segments is not None:
        lines = pyvista.line_segments_from_points(segments.reshape(-1, 3))
        plotter.add_mesh(lines, line_width=1.0, **line)
    _, up, eye = camera(view)
    plotter.enable_parallel_projection()
    plotter.view_vector(eye, viewup=up)
    image = plotter.screenshot(transparent_background=True, return_img=True)
    plotter.close()
    rows, columns = (np.flatnonzero(image[..., 3].any(axis=axis)) for axis in (1, 0))
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def camera(view: Angles | None = None) -> np.ndarray:
    """Where the picture's right and up, and the eye, are in space: the rows of a rotation."""
    around, above = np.radians(VIEW if view is None else view)
    level = np.array([np.cos(around), np.sin(around), 0.0])
    right, top = np.array([-level[1], level[0], 0.0]), np.array([0.0, 0.0, 1.0])
    rise, reach = np.sin(above), np.cos(above)
    return np.array([right, reach * top - rise * level, reach * level + rise * top])
