"""Checks of what guaranteed bounds cover; messages name the argument that is not covered."""

from __future__ import annotations

import numpy as np
from ngsolve import ET, VOL, CoefficientFunction, IntegrationRule, Mesh

from ngepc.bounds.hexahedra import check_hexahedra
from ngepc.bounds.matching import check_interfaces
from ngepc.bounds.rollers import in_components
from ngepc.checks.sentences import in_words
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.sampling import Scan
from ngepc.local.indicators import COVERS as ESTIMATED
from ngepc.model.elements import (
    SHAPES,
    are_parallelograms,
    elements_by_shape,
    has_straight_simplices,
)
from ngepc.model.features import (
    BASIC_FEATURES,
    FEATURES,
    HISTORY_FEATURES,
    is_covered,
    require_covered,
)
from ngepc.model.material import is_vector
from ngepc.model.problem import Problem

COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | {"friction", "hardening law", "initial strain", "order 2", "plane stress"}
    | {"anisotropic yield", "cyclic hardening", "quadrilaterals", "springs"}
    | {"rate", "two bodies", "held by contact", "hexahedra", "thickness"}
    | {"axisymmetric", "contact at a clamp", "rollers"}
)
"""Features that guaranteed bounds cover.

Two bodies and parts that contact alone holds in the plane and without friction; rollers on
straight sides, of which those along an axis hold a component."""

OF_REVOLUTION = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | {"axisymmetric", "hardening law", "initial strain", "order 2", "rate"}
    | {"contact at a clamp"}
)
"""Features that bounds of bodies of revolution cover."""

HELD = frozenset({"two bodies", "held by contact"})
"""Features that bounds cover in the plane without friction."""

CUT = "; solve_to cuts elements into simplices first"
"""What is advised where a bound on other elements is refused."""

ON_PARALLELOGRAMS = {
    "plane stress": "a bound in plane stress",
    "anisotropic yield": "a bound with Hill's criterion",
    "cyclic hardening": "a bound with sub-elements",
}
"""Features that bounds cover on simplices and on parallelograms of order one.

On other elements no upper bound of the energy is known.
"""

# part of its largest value by which a coefficient may vary on an element and count as constant
CONSTANT = 1e-10
# data that may be affine on triangles for displacements of order two
AFFINE = ("initial_plastic_strain", "initial_hardening (alpha_2)")
# hardening that earlier steps leave
HARDENED = ("initial_hardening", "initial_hardening (alpha_2)", "initial_accumulated")
_INSIDE = {
    ET.TRIG: IntegrationRule(ET.TRIG, 8),
    ET.QUAD: IntegrationRule(ET.QUAD, 8),
    ET.TET: IntegrationRule(ET.TET, 6),
    ET.HEX: IntegrationRule(ET.HEX, 6),
}
"""Points at which polynomials of degree three are determined."""


BUBBLE = -0.5
"""NGSolve's function of an edge is this times the product of the hat functions of its ends."""
MIDDLES = slice(4, 7)
"""Where ``FacetRule`` has the middles of the edges of a triangle."""


class FacetRule:
    """Points on a boundary facet: its vertices, the middles of it and its edges, those of a rule.

    The interpolation error of a smooth obstacle is largest near the middles.  ``shares`` are the
    barycentric coordinates of the points; ``weights`` add up to one and are zero at vertices and
    middles.
    """

    def __init__(self, shape: ET, order: int) -> None:
        self.shape = shape
        inside = IntegrationRule(shape, order)
        N = 2 if shape == ET.SEGM else 3
        points = np.array(inside.points)[:, : N - 1]
        points = np.column_stack([points, 1 - points.sum(axis=1)])
        vertices = np.eye(N)
        centre = np.full((1, N), 1 / N)
        middles_of_edges = np.zeros((0, N)) if N == 2 else (1 - np.eye(3)) / 2
        watched = np.concatenate([vertices, centre, middles_of_edges])
        self.shares = np.concatenate([watched, points])

        weights = np.array([0.0] * len(watched) + list(inside.weights))
        self.weights = weights / weights.sum()
        places = [tuple(share[:-1]) for share in self.shares.tolist()]
        self.rule = IntegrationRule(places, self.weights.tolist())

    def affine_defect(self, values: np.ndarray) -> np.ndarray:
        """By how much values (facets, points, k) exceed the affine function of their vertices."""
        return values - self.shares @ values[:, : self.shares.shape[1]]

    def quadratic_defect(self, values: np.ndarray) -> np.ndarray:
        """By how much values (facets, points, k) exceed the quadratic of vertices and middles."""
        defect = self.affine_defect(values)
        if self.shares.shape[1] == 2:
            bubble = 4 * self.shares.prod(axis=1)
            return defect - bubble[:, None] * defect[:, 2:3]
        bubbles = edge_functions(self.shares) / (BUBBLE / 4)
        return defect - bubbles @ defect[:, MIDDLES]

    def bubbles(self, values: np.ndarray) -> np.ndarray:
        """Coefficients of edge functions, (facets, 3), of scalars (facets, points) on triangles.

        The quadratic function with these coefficients interpolates at vertices and edge midpoints.
        """
        middles = self.affine_defect(values[:, :, None])[:, MIDDLES, 0]
        return middles / (BUBBLE / 4)

    def bent(self, amount: np.ndarray) -> np.ndarray:
        """Values at the points of edge functions with these coefficients (facets, 3).

        Zero without edge functions.
        """
        if not amount.shape[1]:
            return np.zeros((len(amount), len(self.shares)))
        return amount @ edge_functions(self.shares).T

    def lowest_defect(self, values: np.ndarray) -> np.ndarray:
        """Lower bound of values less their affine interpolant, at most zero, (facets,).

        ``values`` are scalars (facets, points); the bound is exact for quadratic functions.
        """
        defect = self.affine_defect(values[:, :, None])[:, :, 0]
        sampled = defect.min(axis=1, initial=0.0)
        if self.shares.shape[1] == 2:
            return sampled
        return np.minimum(sampled, lowest_of_quadratics(defect[:, MIDDLES]))


def edge_functions(shares: np.ndarray) -> np.ndarray:
    """Functions of the edges opposite to the vertices of a triangle at points (..., 3)."""
    return BUBBLE * shares[..., [[1, 2], [0, 2], [0, 1]]].prod(axis=-1)


def lowest_of_quadratics(middles: np.ndarray) -> np.ndarray:
    """The least value inside a triangle of quadratics that vanish at its vertices, (facets,).

    ``middles`` (facets, 3) are the values a, b, c at the middles of the edges.  The quadratic
    4 (a l_1 l_2 + b l_0 l_2 + c l_0 l_1) is stationary at l_0 = a (b + c - a) / s, ..., where s is
    the sum of the three numerators; its value there is 4 a b c / s.  Zero if that is outside.
    """
    rest = middles.sum(axis=1, keepdims=True) - 2 * middles
    places = middles * rest
    size = places.sum(axis=1)
    inside = (places * np.sign(size)[:, None] > 0).all(axis=1)
    product = 4 * middles.prod(axis=1)
    value = np.divide(product, size, out=np.zeros(len(size)), where=inside)
    return np.minimum(value, 0.0)


FACET_RULES = {2: FacetRule(ET.SEGM, 9), 3: FacetRule(ET.TRIG, 6)}  # by dimension


def check_covered(problem: Problem) -> None:
    """Refuse problems without a guaranteed bound with a ValueError that names the argument."""
    problem = in_components(problem)
    check_features(problem)
    check_data_inside(problem)


def check_data_inside(problem: Problem) -> None:
    """Refuse data inside the body that vary on elements."""
    simplices = has_straight_simplices(problem.mesh)
    material = problem.material
    scalar, back = problem.alpha_0
    coefficients = {
        "lame_lambda": material.lame_lambda,
        "lame_mu": material.lame_mu,
        "yield_stress": material.yield_stress,
        "hardening": material.effective_hardening,
        "initial_plastic_strain": problem.initial_plastic_strain,
        "initial_hardening": None if problem.initial_hardening is None else scalar,
        "initial_hardening (alpha_2)": None
        if problem.initial_hardening is None
        else back,
        "initial_strain": problem.initial_strain,
    }
    if material.law is not None:
        coefficients["initial_accumulated"] = problem.initial_accumulated
        data = enumerate(material.law.data)
        coefficients |= {f"material.law (datum {k})": value for k, value in data}
    if material.rate is not None:
        data = enumerate(material.rate.data)
        coefficients |= {f"material.rate (datum {k})": value for k, value in data}
    if material.hill is not None:
        coefficients |= {f"hill.{k}": value for k, value in vars(material.hill).items()}
    if is_vector(problem.initial_hardening):
        coefficients["initial_hardening"] = problem.initial_hardening
    radial = material.hill is None and material.overlay is None
    for name, value in coefficients.items():
        affine = simplices and problem.order == 2 and name in AFFINE and radial
        affine = affine and not problem.kinematics.hoop
        if isinstance(value, CoefficientFunction) and varies_inside(
            problem, value, affine
        ):
            needed = "affine functions" if affine else "one value"
            as_left = ", as histories with order=1 leave it" if name in HARDENED else ""
            raise ValueError(
                f"{name} varies inside elements: bounds need {needed} on each element{as_left}"
            )


def check_each_feature(problem: Problem) -> None:
    """Refuse features that no bound covers."""
    require_covered(problem, "a bound", COVERS, estimate_for(problem))


def estimate_for(problem: Problem) -> str:
    """What is advised where a bound is refused: the estimate, if the problem has one."""
    if not is_covered(problem, ESTIMATED):
        return ""
    return "; error_indicators(result) estimates, without a guarantee"


def check_features(problem: Problem) -> None:
    """Refuse features, and pairs of features, that no bound covers."""
    check_each_feature(problem)
    if problem.kinematics.hoop:
        require_covered(problem, "a bound of a body of revolution", OF_REVOLUTION)
    if problem.N == 3:
        advice = estimate_for(problem)
        require_covered(problem, "a bound in three dimensions", COVERS - HELD, advice)
    if problem.friction is not None:
        advice = estimate_for(problem)
        require_covered(problem, "a bound with friction", COVERS - HELD, advice)
    if FEATURES["quadrilaterals"].found(problem):
        require_covered(problem, "a bound on quadrilaterals", COVERS - HELD, CUT)
    if FEATURES["hexahedra"].found(problem):
        check_hexahedra(problem.mesh)
        if problem.order == 2:
            covers = COVERS - {"friction"}
            require_covered(problem, "a bound on hexahedra of order 2", covers)
    check_pairs(problem)
    for feature, what in ON_PARALLELOGRAMS.items():
        if FEATURES[feature].found(problem) and not is_bilinear(problem):
            covers = COVERS - {"quadrilaterals", "hexahedra"}
            advice = ", or parallelograms and order=1" if problem.N == 2 else ""
            require_covered(problem, what, covers, advice + CUT)


def is_bilinear(problem: Problem) -> bool:
    """Whether displacements of a plane body are polynomials of degree two on each element."""
    plane = problem.N == 2
    return plane and problem.order == 1 and are_parallelograms(problem.mesh)


def check_pairs(problem: Problem) -> None:
    """Refuse tied bodies, and pairs whose first boundary is not straight."""
    for pair in problem.contact_pairs:
        if pair.tied:
            raise ValueError(
                f"contact={in_words(pair)}: a bound needs bodies that are not tied"
            )
    check_interfaces(problem.mesh, problem.contact_pairs)


def varies_inside(
    problem: Problem, value: CoefficientFunction, affine: bool = False
) -> bool:
    """Whether a coefficient is not constant, or not affine on simplices, on some element."""
    mesh = problem.mesh
    if is_polynomial(value, mesh, highest=int(affine)):
        return False
    if len(Scan(mesh, value, VOL).hidden):
        return True
    points = mesh.MapToAllElements(_INSIDE, VOL)
    values = np.asarray(value(points)).reshape(-1, value.dim)
    size = np.abs(values).max(initial=1e-300)
    variation = 0.0
    for rule, places in places_by_shape(mesh):
        own = values[places]
        if affine:
            known = np.array([(1.0, *p) for p in rule.points])[:, : problem.N + 1]
            own = own - known @ (np.linalg.pinv(known) @ own)
        variation = max(variation, np.ptp(own, axis=1).max())
    return variation > CONSTANT * size


def places_by_shape(mesh: Mesh) -> list[tuple[IntegrationRule, np.ndarray]]:
    """For each shape its rule, and which points of ``MapToAllElements`` each element has."""
    alike = elements_by_shape(mesh)
    rules = [_INSIDE[SHAPES[mesh.dim, nodes.shape[1]][0]] for _, nodes in alike]
    counts = np.zeros(mesh.ne, dtype=int)
    for (numbers, _), rule in zip(alike, rules, strict=True):
        counts[numbers] = len(rule)
    first = np.cumsum(counts) - counts
    return [
        (rule, first[numbers][:, None] + np.arange(len(rule)))
        for (numbers, _), rule in zip(alike, rules, strict=True)
    ]
