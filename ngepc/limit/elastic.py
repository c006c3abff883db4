"""Elastic stresses of single loads, from displacements of degree two.

They are affine on each triangle.  Where they are also in equilibrium with the load, point by point,
they are the elastic stresses of the body: stresses of a compatible displacement that are in
equilibrium are unique.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from ngsolve import TRIG, VOL, IntegrationRule, Norm, x, y

from ngepc.checks.arguments import Coefficient
from ngepc.limit.data import STAYS, LimitData, barycentric
from ngepc.limit.reading import BODY_FORCE, limit_data
from ngepc.limit.static import Statics
from ngepc.limit.yielding import YieldShape
from ngepc.methods.newton import semismooth_newton
from ngepc.model.material import Material
from ngepc.model.places import Roller
from ngepc.model.problem import Problem

INITIAL_STRAIN = "initial_strain"
"""The name of the initial strain among loads that vary."""

STRONG = 1e6
"""Yield stress over the shear modulus of the material that stays elastic."""

EXACT = 1e-9
"""Largest residual of equilibrium, over the largest stress, of stresses that count as exact."""

SAMPLES = IntegrationRule(TRIG, 4)
POINTS = len(SAMPLES.weights)
"""Points at which stresses are evaluated."""


def without_loads(problem: Problem, names: Sequence[str]) -> Problem:
    """The problem without the loads ``names``; supports of these names get zero displacement."""
    kept = {}
    for field in ("traction", "pressure"):
        given = problem.single(field).items()
        kept[field] = {name: g for name, g in given if name not in names}
    for field in (BODY_FORCE, INITIAL_STRAIN):
        kept[field] = None if field in names else getattr(problem, field)
    kept["prescribed"] = {
        name: at_rest(given) if name in names else given
        for name, given in problem.single("prescribed").items()
    }
    return problem.changed(**kept)


def at_rest(given: Sequence[Coefficient | None] | Roller) -> Sequence | Roller:
    """The support with zero displacement."""
    if isinstance(given, Roller):
        return replace(given, value=0.0)
    return tuple(None if value is None else 0.0 for value in given)


def elastic_stress(
    problem: Problem, shape: YieldShape, name: str, loads: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, LimitData]:
    """The elastic stress of one load, its residuals, and the load.

    Parameters
    ----------
    problem
        The problem with all loads.
    shape
        The yield condition.
    name, loads
        The load, and all loads of the problem.

    Returns
    -------
    tuple
        Coordinates at the vertices of the triangles, (nc, 3, s) (stress); the residuals of
        equilibrium and the differences from an affine function, a vector (stress); the data with
        this load as the one that grows.  Stresses that are zero up to rounding are zero.
    """
    alone = without_loads(problem, [other for other in loads if other != name])
    old = problem.material
    strong = Material.kinematic(
        lame_lambda=old.lame_lambda,
        lame_mu=old.lame_mu,
        yield_stress=STRONG * old.lame_mu,
        hardening=old.lame_mu,
    )
    solid = alone.changed(material=strong, order=2)
    result = semismooth_newton(solid).or_interrupted().raise_for_status()
    data = replace(limit_data(alone, (name,)), moves=False)
    cells = data.cells
    points = problem.mesh.MapToAllElements({TRIG: SAMPLES}, VOL)
    count = len(cells.nodes)
    tensors = np.asarray(result.stress(points))
    tensors = tensors.reshape(count, POINTS, *result.stress.dims)
    k = shape.tensors.shape[1]
    tensors = tensors[:, :, :k, :k].reshape(count, POINTS, -1)
    places = np.stack([np.asarray(x(points)), np.asarray(y(points))], axis=-1)
    shares = barycentric(cells, np.arange(count), places.reshape(count, -1, 2))
    corners = np.linalg.pinv(shares) @ tensors
    coordinates = corners @ shape.reading
    uneven = tensors - shares @ corners
    # the stress of strains of this size, if they are prevented
    prevented = np.asarray((old.lame_mu * Norm(result.displacement))(points)).max()
    prevented = prevented / np.ptp(cells.points, axis=0).max()
    if np.abs(tensors).max() <= EXACT * prevented:
        coordinates = np.zeros(coordinates.shape)
        uneven = np.zeros(uneven.shape)
    residual = imbalance(data, shape, coordinates)
    return coordinates, np.concatenate([uneven.ravel(), residual]), data


def imbalance(
    data: LimitData, shape: YieldShape, coordinates: np.ndarray
) -> np.ndarray:
    """Residual of the equilibrium of a stress with the growing loads (stress)."""
    force = data.force.copy()
    traction = data.traction.copy()
    force[STAYS] = 0.0
    traction[STAYS] = 0.0
    statics = Statics(replace(data, force=force, traction=traction), shape)
    unknowns = np.append(coordinates.ravel(), 1.0)
    return statics.equations @ unknowns - statics.values
