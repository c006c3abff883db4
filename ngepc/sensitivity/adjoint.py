"""The adjoint of the discrete optimality system: one solve for all parameters.

Changes of the solution obey K u' + C' y = -r_m at the free components and R u' - D y = shift_m for
the rows that contact leaves (``sensitivity.contact``).  With the multipliers z, zeta of the
transposed system K z + R' zeta = F_u, C z - D zeta = E' F_x,

    dF/dm = F_m - z . r_m + zeta . shift_m + (F_u - K z - R' zeta) . values_m,

for the prescribed values of the held components, and e . (F_x - R z) per change of a bound.  All
that m changes are the data of ``sensitivity.radial.Data``, by which the derivative is taken once,
for any number of parameters.
"""

from __future__ import annotations

import numpy as np

from ngepc.discretisation.points import Points
from ngepc.local.system import State
from ngepc.sensitivity.functionals import Slope
from ngepc.sensitivity.held import HeldSystem
from ngepc.sensitivity.radial import Data, RadialDerivative

DENSITIES = (
    *("two_mu", "bulk", "hardening", "beta", "kinematic", "isotropic"),
    *("back", "initial", "strain", "volume"),
)


def derivative_by_data(state: State, system: HeldSystem, slope: Slope) -> Data:
    """The derivative of a functional with respect to all discrete data.

    Those at the points are densities: ``paired`` brings in the weights.

    Raises
    ------
    TangentError
        If the adjoint system is singular.
    """
    discrete = state.discrete
    points, bulk, contact = discrete.points, discrete.law.bulk, system.contact
    law = RadialDerivative(discrete.law, state.at)
    zero, force = np.zeros_like(state.deviator), np.zeros_like(state.u) + slope.u
    if any(np.ndim(part) for part in (slope.p, slope.stress, slope.mean)):
        direct = law.reverse(zero + slope.p, zero + slope.stress)["strain"]
        force = force + points.forces(bulk * slope.mean, direct)
    on_contact = np.zeros(len(discrete.contact)) + slope.contact
    z, y, inner = system.solve_transposed(force, contact.given.T @ on_contact)
    zeta = contact.chosen @ y
    volume, e = points.strain(z)
    data = law.reverse(zero + slope.p, slope.stress - e)
    support = force - inner - discrete.contact.forces(zeta)
    data |= {
        "volume": bulk * (slope.mean - volume),
        "bulk": (slope.mean - volume) * state.volume,
        "load": z,
        "values": np.where(discrete.supports.free, 0.0, support),
    }
    data |= contact.slopes(zeta, on_contact - discrete.contact.displacement(z))
    return summed(data, slope.explicit)


def summed(one: Data, other: Data) -> dict[str, np.ndarray]:
    """The sum, name by name."""
    return {
        name: one.get(name, 0.0) + other.get(name, 0.0) for name in dict.fromkeys([*one, *other])
    }


def paired(points: Points, slopes: Data, change: Data) -> float:
    """The derivative in the direction of a change of the data."""
    result = 0.0
    for name in slopes.keys() & change.keys():
        product = slopes[name] * change[name]
        if name in DENSITIES:
            result += points.integral(product.reshape(len(points), -1).sum(axis=1))
        else:
            result += float(product.sum())
    return result
