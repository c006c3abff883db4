"""Integration rules for the nonsmooth terms, and where which rule is needed.

|q|_2 is convex and q is affine on a simplex, so that vertex values are sufficient: an element where
all of them satisfy |q| <= threshold contributes nothing to M^2.  Where all of an element is beyond
the threshold the integrand is smooth and a low order is exact to rounding.  Only elements that
the kink |q| = threshold crosses need many points, 400 in the paper.
"""

import numpy as np
from ngsolve import ET, VOL, IntegrationRule, Mesh

from ngepc.checks.arguments import ELEMENT_TYPES, Coefficient, is_number
from ngepc.model.elements import SHAPES, elements_by_shape

SMOOTH_ORDER = 9
SMOOTH_VARIATION = 0.1
"""Where q varies by less than this fraction of its size, that order is exact to rounding."""

IDLE = -1
SMOOTH = 0
KINKED = 1
"""Kinds of elements: below the threshold, smooth beyond it, or with a kink."""

HIGHEST_ORDER = 60


def order_with_points(shape: ET, points: int) -> int:
    """The lowest order whose rule has at least ``points`` points; a ValueError if none up to 60."""
    for order in range(HIGHEST_ORDER + 1):
        most = len(IntegrationRule(shape, order))
        if most >= points:
            return order
    raise ValueError(
        f"quadrature_points={points}: at most {most} are available per {shape.name}"
    )


def fine_rules(dim: int, points: int) -> dict[ET, IntegrationRule]:
    """Rules with at least ``points`` points on each element shape of the dimension."""
    return {
        s: IntegrationRule(s, order_with_points(s, points)) for s in ELEMENT_TYPES[dim]
    }


def rules_of(dim: int, order: int) -> dict[ET, IntegrationRule]:
    """Rules of one order on each element shape of the dimension."""
    return {s: IntegrationRule(s, order) for s in ELEMENT_TYPES[dim]}


def boundary_rules(dim: int, points: int) -> dict[ET, IntegrationRule]:
    """Rules on the boundary elements, of the order that ``points`` means on a simplex."""
    return rules_of(dim - 1, order_with_points(ELEMENT_TYPES[dim][0], points))


def classify(
    q: np.ndarray, nodes: np.ndarray, low: np.ndarray | float, high: np.ndarray | float
) -> np.ndarray:
    """For each element: KINKED if it has a kink of [|q| - threshold]^+, SMOOTH, or IDLE.

    |q| is convex, so that vertex values bound it from above; along the mean direction q is
    affine, so that they bound it from below.

    Of vertex values q (d, vertices), vertices of the elements (elements, corners) and the smallest
    and largest threshold in each element, or in all: IDLE, SMOOTH or KINKED for each element.
    """
    kind = np.full(len(nodes), IDLE)
    low, high = (np.broadcast_to(bound, kind.shape) for bound in (low, high))
    size = np.sqrt((q * q).sum(axis=0))
    touched = np.flatnonzero(size[nodes].max(axis=1) > low)

    corner = q[:, nodes[touched].T]  # components, vertices, elements
    mean = corner.mean(axis=1)
    mean_size = np.sqrt((mean * mean).sum(axis=0))
    direction = mean / (mean_size + 1e-300)
    along = (corner * direction[:, None]).sum(axis=0)
    least = along.min(axis=0)
    off_mean = corner - mean[:, None]
    spread = np.sqrt((off_mean**2).sum(axis=0).max(axis=0))

    above = least > high[touched]
    one_threshold = low[touched] == high[touched]
    nearly_constant = spread < SMOOTH_VARIATION * least
    smooth = above & one_threshold & nearly_constant
    kind[touched] = np.where(smooth, SMOOTH, KINKED)
    return kind


def threshold_bounds(
    mesh: Mesh, threshold: Coefficient, rules: dict[ET, IntegrationRule]
) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest threshold in each element; one that varies is sampled on ``rules``."""
    if is_number(threshold):
        constant = np.full(mesh.ne, float(threshold))
        return constant, constant
    values = np.asarray(threshold(mesh.MapToAllElements(rules, VOL))).ravel()
    count = np.empty(mesh.ne, int)
    for numbers, nodes in elements_by_shape(mesh):
        count[numbers] = len(rules[SHAPES[mesh.dim, nodes.shape[1]][0]])
    first = np.cumsum(count) - count
    return np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
