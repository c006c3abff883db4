"""Integration rules for the nonsmooth terms, and where which rule is needed.

|q|_2 is convex and q is affine on a simplex, so that its vertex values decide: an element where
all of them satisfy |q| <= threshold contributes nothing to M^2.  Where all of an element is beyond
the threshold the integrand is smooth and a low order is exact to rounding.  Only elements that
the kink |q| = threshold crosses need many points, 400 in the paper.
"""

from dataclasses import dataclass

import numpy as np
from ngsolve import ET, VOL, BitArray, IntegrationRule, Mesh

from ngepc.checks.arguments import ELEMENT_TYPES, Coefficient, is_number
from ngepc.discretisation.elements import element_numbers, element_vertices

SMOOTH_ORDER = 9
SMOOTH_VARIATION = 0.1
HIGHEST_ORDER = 60

_SHAPES = {
    **{(2, 3): ET.TRIG, (2, 4): ET.QUAD},
    **{(3, 4): ET.TET, (3, 5): ET.PYRAMID, (3, 6): ET.PRISM, (3, 8): ET.HEX},
}


def order_with_points(shape: ET, points: int) -> int:
    """The lowest order whose rule on ``shape`` has at least ``points`` points.

    Raises
    ------
    ValueError
        If no rule up to order 60 has so many.
    """
    for order in range(HIGHEST_ORDER + 1):
        if len(IntegrationRule(shape, order)) >= points:
            return order
    most = len(IntegrationRule(shape, HIGHEST_ORDER))
    raise ValueError(f"quadrature_points={points}: at most {most} are available per {shape.name}")


def fine_rules(dim: int, points: int) -> dict[ET, IntegrationRule]:
    """Rules with at least ``points`` points on each element shape of the dimension."""
    return {
        s: IntegrationRule(s, min(order_with_points(s, points), HIGHEST_ORDER))
        for s in ELEMENT_TYPES[dim]
    }


def boundary_rules(dim: int, points: int) -> dict[ET, IntegrationRule]:
    """Rules on the boundary elements, of the order that ``points`` means on a simplex."""
    simplex = ELEMENT_TYPES[dim][0]
    order = order_with_points(simplex, points)
    return {s: IntegrationRule(s, order) for s in ELEMENT_TYPES[dim - 1]}


def vertex_rules(dim: int) -> dict[ET, IntegrationRule]:
    """The rules on boundary elements whose points are the vertices, equally weighted."""
    if dim == 2:
        return {ET.SEGM: IntegrationRule([(0.0,), (1.0,)], [1 / 2] * 2)}
    triangle = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
    return {
        ET.TRIG: IntegrationRule(triangle, [1 / 6] * 3),
        ET.QUAD: IntegrationRule([*triangle, (1.0, 1.0)], [1 / 4] * 4),
    }


def smooth_rules(dim: int) -> dict[ET, IntegrationRule]:
    """Rules for elements without a kink."""
    return {s: IntegrationRule(s, SMOOTH_ORDER) for s in ELEMENT_TYPES[dim]}


@dataclass
class ElementSplit:
    """Which elements carry a kink of [|q| - threshold]^+, which are smooth, which are idle.

    Parameters
    ----------
    mesh
        The mesh.
    threshold
        beta_gamma - nu^/gamma, a number or coefficient (stress).
    rules
        The rules on which a threshold that varies is sampled.
    """

    mesh: Mesh
    threshold: Coefficient
    rules: dict[ET, IntegrationRule]

    def __post_init__(self) -> None:
        self.kinked, self.smooth = BitArray(self.mesh.ne), BitArray(self.mesh.ne)
        self._nodes, self._numbers = element_vertices(self.mesh), element_numbers(self.mesh)
        self._low, self._high = self._bounds()

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest sampled threshold in each element."""
        if is_number(self.threshold):
            constant = np.full(self.mesh.ne, float(self.threshold))
            return constant, constant
        values = np.asarray(self.threshold(self.mesh.MapToAllElements(self.rules, VOL))).ravel()
        count = np.empty(self.mesh.ne, int)
        for nodes, numbers in zip(self._nodes, self._numbers, strict=True):
            count[numbers] = len(self.rules[_SHAPES[self.mesh.dim, nodes.shape[1]]])
        first = np.cumsum(count) - count
        return np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)

    def update(self, q: np.ndarray) -> None:
        """Sort the elements by the vertex values ``q``, shape (vertices, d)."""
        kinked, smooth = np.zeros(self.mesh.ne, bool), np.zeros(self.mesh.ne, bool)
        size = np.sqrt((q * q).sum(axis=1))
        for nodes, numbers in zip(self._nodes, self._numbers, strict=True):
            low, high = self._low[numbers], self._high[numbers]
            touched = np.flatnonzero(size[nodes].max(axis=1) > low)
            corner = q[nodes[touched]]
            mean = corner.mean(axis=1)
            length = np.sqrt((mean * mean).sum(axis=1)) + 1e-300
            along = (corner * (mean / length[:, None])[:, None, :]).sum(axis=2).min(axis=1)
            spread = np.sqrt(((corner - mean[:, None, :]) ** 2).sum(axis=2)).max(axis=1)
            no_kink = (along > high[touched]) & (spread < SMOOTH_VARIATION * along)
            no_kink &= low[touched] == high[touched]
            smooth[numbers[touched[no_kink]]] = True
            kinked[numbers[touched[~no_kink]]] = True
        _assign(self.kinked, kinked)
        _assign(self.smooth, smooth)


def _assign(bits: BitArray, values: np.ndarray) -> None:
    bits.Clear()
    bits |= BitArray(values.tolist())
