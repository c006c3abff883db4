"""The adjoint of the discrete optimality system: one solve for all parameters.

The solution obeys r = B' sigma(u; m) + N' lambda - l(m) = 0 at the free components and N u = gaps
for the closed rows.  With the multipliers z, zeta of K z + N' zeta = F_u, N z = F_lambda,

    dF/dm = F_m - z . r_m + zeta . gaps_m + (F_u - K z - N' zeta) . values_m,

for the prescribed values of the held components.  All that m changes are the data of
``sensitivity.radial.Data``, by which the derivative is taken once, for any number of parameters.
"""

from __future__ import annotations

import numpy as np

from ngepc.discretisation.points import Points
from ngepc.local.system import State
from ngepc.sensitivity.functionals import Slope
from ngepc.sensitivity.held import HeldSystem
from ngepc.sensitivity.radial import Data, RadialDerivative

DENSITIES = ("two_mu", "bulk", "hardening", "beta", "kinematic", "isotropic", "back", "initial")


def derivative_by_data(state: State, system: HeldSystem, slope: Slope) -> Data:
    """The derivative of a functional with respect to all discrete data.

    Those at the points are densities: ``paired`` brings in the weights.

    Raises
    ------
    TangentError
        If the adjoint system is singular.
    """
    discrete = state.discrete
    points, bulk = discrete.points, discrete.law.bulk
    law = RadialDerivative(discrete.law, state.at)
    zero = np.zeros_like(state.deviator)
    direct = law.reverse(zero + slope.p, zero + slope.stress)["strain"]
    force = slope.u + points.forces(bulk * slope.mean, direct)
    shift = np.zeros(len(discrete.rows)) + slope.multipliers
    z, zeta = system.solve(force, shift)
    volume, e = points.strain(z)
    data = law.reverse(zero + slope.p, slope.stress - e)
    support = force - system.internal(z) - discrete.rows.forces(zeta)
    del data["strain"]
    data |= {
        "bulk": (slope.mean - volume) * state.volume,
        "load": z,
        "gaps": zeta,
        "values": np.where(discrete.supports.free, 0.0, support),
    }
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
