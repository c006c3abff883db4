"""Still pictures of solids: triangles in parallel projection, drawn by a depth buffer in numpy."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from ngepc.pictures.style import DEFORMED, GUIDE

Angles = tuple[float, float]
VIEW: Angles = (-60.0, 25.0)
"""Where solids are seen from, in degrees: around the z axis from x, and above the xy plane."""

SIZE = 1000  # pixels of the diagonal of a body
FINE = 2  # parts of a pixel's side that are drawn and averaged
AMBIENT = 0.6  # light on a face that is parallel to the direction of view, 1 for one that faces it
SHARP = 30.0  # degrees by which the surface turns at an edge that is drawn as a line
IN_FRONT = 0.004  # lines are drawn if they are not farther than this behind a surface (of the size)
ROUNDED = 1e-9  # by which barycentric coordinates of points on edges may be negative
FLAT = 1e-12  # twice the area (pixels) of triangles that are left out
AT_ONCE = 2**18  # pixels of triangles that are treated together


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
    towards, right, up = camera(view)
    axes = np.stack([right, -up, towards])  # columns, rows, depth
    places = points @ axes.T
    corner = places.min(axis=(0, 1))
    size = np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0))
    pixel = size / (FINE * SIZE)
    places = (places - corner) / pixel

    edges = points[:, 1:] - points[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    light = AMBIENT + (1.0 - AMBIENT) * np.abs(normals @ towards)

    canvas = Canvas(places)
    canvas.draw(places, values, light)
    image = canvas.image(colours)
    lines = [(sharp_edges(points, normals), 2)]
    if segments is not None:
        lines.append((segments.reshape(-1, 2, 3), 1))
    for ends, width in lines:
        canvas.draw_lines(image, (ends @ axes.T - corner) / pixel, width)
    return in_whole_pixels(image.reshape(canvas.rows, canvas.columns, 4))


class Canvas:
    """Pixels with the depth, the value and the light of what is in front."""

    def __init__(self, places: np.ndarray) -> None:
        extent = np.ptp(places[..., :2].reshape(-1, 2), axis=0)
        columns, rows = np.ceil(extent).astype(int) + 1
        self.rows = int(-(-rows // FINE) * FINE)
        self.columns = int(-(-columns // FINE) * FINE)
        count = self.rows * self.columns
        self.depth = np.full(count, -np.inf)
        self.value = np.zeros(count)
        self.light = np.zeros(count)

    def draw(self, places: np.ndarray, values: np.ndarray, light: np.ndarray) -> None:
        """Draw triangles with values at their corners and one light each."""
        for triangle, pixel, weights in covered(places[..., :2], self.columns):
            depth = (weights * places[triangle, :, 2]).sum(axis=1)
            np.maximum.at(self.depth, pixel, depth)
            front = depth >= self.depth[pixel]
            seen = pixel[front]
            own = triangle[front]
            self.value[seen] = (weights[front] * values[own]).sum(axis=1)
            self.light[seen] = light[own]

    def image(self, colours: ScalarMappable) -> np.ndarray:
        """The colours (rows * columns, 4), between 0 and 1; transparent where nothing is."""
        image = np.zeros((len(self.depth), 4))
        seen = np.isfinite(self.depth)
        image[seen] = colours.cmap(colours.norm(self.value[seen]))
        image[seen, :3] *= self.light[seen, None]
        return image

    def draw_lines(self, image: np.ndarray, ends: np.ndarray, width: int) -> None:
        """Draw segments (n, 2, 3) that no surface hides."""
        if not len(ends):
            return
        first = ends[:, 0]
        along = ends[:, 1] - first
        counts = np.ceil(np.abs(along[:, :2]).max(axis=1)).astype(int) + 1
        line = np.repeat(np.arange(len(ends)), counts)
        step = np.arange(len(line)) - np.repeat(np.cumsum(counts) - counts, counts)
        part = step / np.maximum(counts[line] - 1, 1)
        places = first[line] + part[:, None] * along[line]
        reach = IN_FRONT * FINE * SIZE
        for across in range(width + 1):
            for down in range(width + 1):
                column = np.rint(places[:, 0] + across - width / 2).astype(int)
                row = np.rint(places[:, 1] + down - width / 2).astype(int)
                inside = (column >= 0) & (column < self.columns)
                inside &= (row >= 0) & (row < self.rows)
                pixel = row[inside] * self.columns + column[inside]
                seen = places[inside, 2] + reach >= self.depth[pixel]
                seen &= np.isfinite(self.depth[pixel])
                image[pixel[seen], :3] = to_rgb(DEFORMED)


def covered(
    corners: np.ndarray, columns: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The pixels whose middle is inside triangles (n, 3, 2), in parts.

    Yields the number of the triangle, that of the pixel, and the barycentric coordinates (k, 3).
    """
    first = np.floor(corners.min(axis=1)).astype(int)
    reach = (np.floor(corners.max(axis=1)).astype(int) - first).max(axis=1) + 2
    width = 2 ** np.ceil(np.log2(reach)).astype(int)
    start, slopes = affine_weights(corners, first)
    for side in np.unique(width):
        chosen = np.flatnonzero(width == side)
        steps = np.arange(side)
        each = max(1, AT_ONCE // side**2)
        for begin in range(0, len(chosen), each):
            some = chosen[begin : begin + each]
            along = slopes[some, :, 0, None] * steps
            down = slopes[some, :, 1, None] * steps + start[some, :, None]
            second, third = (
                down[:, k, :, None] + along[:, k, None, :] for k in range(2)
            )
            inside = (second >= -ROUNDED) & (third >= -ROUNDED)
            inside &= second + third <= 1.0 + ROUNDED
            number, row, column = np.nonzero(inside)
            weights = np.stack([second[inside], third[inside]], axis=1)
            weights = np.column_stack([1.0 - weights.sum(axis=1), weights])
            corner = first[some][number]
            pixel = (corner[:, 1] + row) * columns + corner[:, 0] + column
            yield some[number], pixel, weights


def affine_weights(
    corners: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The last two barycentric coordinates of triangles (n, 3, 2) at one place each.

    Also returns their slopes (n, 2, 2).  They are negative for triangles without area.
    """
    one = corners[:, 1] - corners[:, 0]
    two = corners[:, 2] - corners[:, 0]
    area = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    flat = np.abs(area) < FLAT
    area = np.where(flat, 1.0, area)
    second = np.stack([two[:, 1], -two[:, 0]], axis=1)
    third = np.stack([-one[:, 1], one[:, 0]], axis=1)
    slopes = np.stack([second, third], axis=1) / area[:, None, None]
    slopes[flat] = 0.0
    start = (slopes * (places - corners[:, 0])[:, None]).sum(axis=2)
    start[flat] = -1.0
    return start, slopes


def sharp_edges(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Edges (n, 2, 3) at which the surface of triangles (n, 3, 3) turns, or ends."""
    flat = points.reshape(-1, 3)
    low = flat.min(axis=0)
    size = np.ptp(flat, axis=0).max() or 1.0
    cells = np.rint((flat - low) / size * 2**20 + 0.357).astype(np.int64)
    _, one, number = np.unique(
        cells @ np.array([2**42, 2**21, 1]), return_index=True, return_inverse=True
    )
    corners = number.reshape(-1, 3)
    ends = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = ends[:, 0] * len(one) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    begin = np.flatnonzero(np.diff(keys[order], prepend=-1))
    count = np.diff(begin, append=len(keys))
    face = order // 3
    second = np.minimum(begin + 1, len(keys) - 1)
    turn = np.abs((normals[face[begin]] * normals[face[second]]).sum(axis=1))
    smooth = (count == 2) & (turn > np.cos(np.radians(SHARP)))
    edges = ends[order[begin[~smooth]]]
    edges = edges[edges[:, 0] != edges[:, 1]]
    return flat[one[edges]]


def in_whole_pixels(image: np.ndarray) -> np.ndarray:
    """The image of fine pixels with whole ones, as bytes."""
    rows, columns, _ = image.shape
    parts = image.reshape(rows // FINE, FINE, columns // FINE, FINE, 4)
    alpha = parts[..., 3:]
    opaque = alpha.sum(axis=(1, 3))
    colour = (parts[..., :3] * alpha).sum(axis=(1, 3)) / np.maximum(opaque, 1e-9)
    pixels = np.concatenate([colour, opaque / FINE**2], axis=2)
    return np.rint(255 * np.clip(pixels, 0.0, 1.0)).astype(np.uint8)


def camera(view: Angles | None) -> np.ndarray:
    """The rotation whose rows are the directions to the eye, to the right, and up."""
    around, above = VIEW if view is None else view
    return Rotation.from_euler("ZY", (around, -above), degrees=True).as_matrix().T
