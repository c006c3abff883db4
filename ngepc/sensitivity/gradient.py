"""Gradients of functionals by the adjoint, backwards through the time steps.

Changes of the solution obey K u' + C' y = -r_m at the free components and R u' - D y = shift_m for
the rows that contact leaves (``sensitivity.contact``).  With the multipliers z, zeta of the
transposed system K z + R' zeta = F_u, C z - D zeta = E' F_x,

    dF/dm = F_m - z . r_m + zeta . shift_m + (F_u - K z - R' zeta) . values_m,

for the prescribed values of the held components, and e . (F_x - R z) per change of a bound: one
solve for any number of parameters.  One step is a history of one.  Backwards from the last one the
derivative with respect to what a step has inherited, p_0, dev alpha_2, alpha_1 and u_0, is carried
to the step before, which left

    p_0 + p,    dev alpha_2 + k p,    alpha_1 + k_1 H sigma_y |p|    and, with friction, u_0 = u.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ngepc.checks.arguments import require_integer
from ngepc.local.system import State
from ngepc.sensitivity.biactive import Biactive, biactive_set, told
from ngepc.sensitivity.forms import Form, as_functional
from ngepc.sensitivity.functionals import Functional, Slope
from ngepc.sensitivity.held import HeldSystem
from ngepc.sensitivity.parameters import Constants, Parameters, changed_data, directions
from ngepc.sensitivity.radial import Data, RadialDerivative, paired, summed
from ngepc.sensitivity.shape import MovingBody
from ngepc.sensitivity.states import Solution, states_of


@dataclass(frozen=True, eq=False)
class Gradient(Mapping):
    """Name of each parameter -> derivative, and whether the functional has one.

    Parameters
    ----------
    derivatives
        The derivatives by name.
    functional
        The value of the functional.
    biactive
        The weakly active rows and points of each time step that the functional depends on.
    """

    derivatives: Mapping[str, float]
    functional: float
    biactive: tuple[Biactive, ...]

    def __getitem__(self, name: str) -> float:
        return self.derivatives[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.derivatives)

    def __len__(self) -> int:
        return len(self.derivatives)

    @property
    def differentiable(self) -> bool:
        """Whether no row and no point is biactive; if False the numbers are those of one side."""
        return not any(len(found) for found in self.biactive)

    @property
    def message(self) -> str:
        """What is biactive, step by step; empty where the functional is differentiable."""
        return told(self.biactive)


def gradient(
    result: Solution, functional: str | Form | Functional, parameters: Parameters, *, step: int = -1
) -> Gradient:
    """The derivatives of a functional of a solution with respect to data of its problem.

    Parameters
    ----------
    result
        A converged result of ``semismooth_newton`` without gamma, or of ``evolve``.
    functional
        "contact_force", "primal_energy", "elastic_energy", "dissipation", ``DisplacementAt``,
        ``Reaction``, ``misfit``, or a form, see ``FormFunctional``.
    parameters
        Names such as ["hardening", "traction"], or name -> ``Direction``.  In a history a load or
        gap changes in all steps, an initial plastic strain at the begin.
    step
        The time step of a history whose solution the functional is of.

    Returns
    -------
    Gradient
        A mapping; look at ``differentiable`` or ``message``.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem lacks such data.
    SolverError
        If the result is not that of a converged run.
    TangentError
        If the derivative does not exist because the tangent is singular.
    """
    wanted, functional = directions(parameters), as_functional(functional)
    steps = states_of(result)
    last = range(len(steps))[require_integer("step", step, -len(steps), len(steps) - 1)]
    derivatives, found = dict.fromkeys(wanted, 0.0), []
    later, value = {}, 0.0
    for number in range(last, -1, -1):
        state = steps[number]()
        found.insert(0, biactive_set(state))
        constants, slope = Constants(state), Slope(0.0)
        if number == last:
            slope = functional.slope(state)
            value = slope.value
        slopes = derivative_by_data(state, with_memory(constants, slope, later))
        for name, direction in wanted.items():
            if number == 0 or not direction.inherited:
                change = changed_data(constants, direction)
                derivatives[name] += paired(state.discrete.points, slopes, change)
                if "shape" in change and number == last:
                    moving = MovingBody(state, change["shape"])
                    derivatives[name] += moving.explicit(functional, change)
        later = inherited(constants, slopes, later)
    return Gradient(derivatives, value, tuple(found))


def with_memory(constants: Constants, slope: Slope, later: Data) -> Slope:
    """The slope of a step's functional plus what later steps depend on through its memory."""
    if not later:
        return slope
    at = constants.state.at
    on_size = constants.growth * later["alpha_1"]
    p = later["initial"] + constants.k[:, None] * later["back"] + on_size[:, None] * at.direction
    explicit = {
        "initial": later["initial"],
        "back": later["back"],
        "kinematic": np.einsum("pd,pd->p", later["back"], at.plastic_strain),
        "isotropic": later["alpha_1"] * at.gained,
    }
    u = slope.u + later.get("start", 0.0)
    return replace(slope, u=u, p=slope.p + p, explicit=summed(slope.explicit, explicit))


def inherited(constants: Constants, slopes: Data, later: Data) -> Data:
    """The derivative with respect to p_0, dev alpha_2, alpha_1 and u_0 at the begin of a step."""
    remembered = later.get("alpha_1", 0.0) + constants.memory * slopes["beta"]
    kept = {name: slopes[name] for name in ("initial", "back", "start") if name in slopes}
    return kept | {"alpha_1": remembered}


def derivative_by_data(state: State, slope: Slope) -> Data:
    """The derivative of a functional with respect to all discrete data, see ``Data``.

    TangentError if the adjoint system is singular.
    """
    discrete, law, system = state.discrete, RadialDerivative(state), HeldSystem(state)
    contact = system.contact
    zero, points = np.zeros_like(state.deviator), discrete.points
    force = np.zeros_like(state.u) + slope.u
    if any(np.ndim(part) for part in (slope.p, slope.stress, slope.mean)):
        direct = law.reverse(zero + slope.p, zero + slope.stress, zero[:, 0] + slope.mean)
        force = force + points.forces(direct["volume"], direct["strain"])
    on_contact = np.zeros(len(discrete.contact)) + slope.contact
    z, y = system.solve(force, contact.given.T @ on_contact, transposed=True)
    zeta = contact.chosen @ y
    volume, e = points.strain(z)
    data = law.reverse(zero + slope.p, slope.stress - e, slope.mean - volume)
    support = force - system.internal(z) - discrete.contact.forces(zeta)
    data |= {"load": z, "values": np.where(discrete.supports.free, 0.0, support)}
    data |= contact.slopes(zeta, on_contact - discrete.contact.displacement(z))
    return summed(data, slope.explicit)
