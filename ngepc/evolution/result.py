"""What several time steps leave: fields and numbers of each, and how the run ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from ngsolve import InnerProduct, Norm

from ngepc.discretisation.points import Points
from ngepc.evolution.memory import Memory
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.processes import nodes_of
from ngepc.results.fields import Fields
from ngepc.results.outcome import Ending, Status

Force = list[float]


@dataclass(frozen=True, kw_only=True)
class StepRecord:
    """Numbers of one step, for hysteresis curves and tables.

    Parameters
    ----------
    time
        End of the step.
    cuts
        How often the interval was halved to get here.
    iterations
        Newton steps.
    contact_force
        Resultant of the normal contact pressure, positive in compression (force).
    contact_resultant
        Force of the obstacles on the body, with friction, N numbers; this and the next three are
        None if the solver does not tell.
    reaction, applied_force
        Forces of all supports and of the loads on the body, N numbers.
    reactions
        Name of each support, ``str(place)`` -> its force on the body, N numbers.
    primal_energy
        J(u, p) of the step, (2.14).
    elastic_energy
        1/2 int C (eps(u) - p) : (eps(u) - p) with the total plastic strain.
    dissipation
        int beta |p| with the plastic strain gained in the step.
    max_plastic_strain
        Largest |p_0 + p|_F at the plastic points.
    nodes
        Vertices of the mesh of the step.
    error_bound
        ``ErrorBound.relative`` of the step; None where none was asked for.
    """

    time: float
    cuts: int
    iterations: int
    contact_force: float
    contact_resultant: Force | None
    reaction: Force | None
    reactions: dict[str, Force] | None
    applied_force: Force | None
    primal_energy: float
    elastic_energy: float
    dissipation: float
    max_plastic_strain: float
    nodes: int | None = None
    error_bound: float | None = None

    @classmethod
    def of(cls, result: object, step_fields: Fields, points: Points, **known: object) -> StepRecord:
        """The numbers of a step from the solver's result and the fields at the points.

        ``known`` are ``time``, ``cuts`` and ``error_bound``.
        """
        problem = step_fields.problem
        elastic = step_fields.strain - problem.eps_0 - step_fields.plastic_strain
        stored = 0.5 * InnerProduct(step_fields.stress, elastic)
        lost = as_scalar(problem.beta) * Norm(step_fields.plastic_increment)
        plastic = points.at(step_fields.equivalent_plastic_strain)
        return cls(
            iterations=result.iterations,
            contact_force=float(result.contact_force),
            **_forces(result),
            primal_energy=float(result.primal_energy),
            elastic_energy=points.integral(points.at(stored)),
            dissipation=points.integral(points.at(lost)),
            max_plastic_strain=problem.processes.most(plastic),
            nodes=nodes_of(problem.mesh),
            **known,
        )


def _forces(result: object) -> dict:
    """What the result tells of forces, as lists."""
    told: dict = {}
    for name in ("contact_resultant", "reaction", "applied_force"):
        force = getattr(result, name, None)
        told[name] = None if force is None else np.asarray(force).tolist()
    each = getattr(getattr(result, "equilibrium", None), "reactions", None)
    return told | {"reactions": each and {str(place): f.tolist() for place, f in each.items()}}


@dataclass(frozen=True, eq=False)
class EvolutionStep:
    """One finished step: its fields and its numbers."""

    fields: Fields
    record: StepRecord

    @property
    def problem(self) -> Problem:
        """The problem of the step, with p_0 and alpha_0 as they were at its begin."""
        return self.fields.problem


@dataclass(eq=False)
class Evolution(Ending):
    """What ``evolve`` returns: the finished steps, and how the run ended.

    Parameters
    ----------
    problem
        The problem that the steps change.
    steps
        The finished steps, in time.
    memory
        p_0 and alpha_0 after the last of them.
    status, message
        CONVERGED if all steps were done, or NOT_UNIQUE; otherwise what stopped the run, and when.
    """

    problem: Problem
    steps: list[EvolutionStep]
    memory: Memory
    status: Status = Status.CONVERGED
    message: str = ""

    @property
    def times(self) -> list[float]:
        """Ends of the finished steps."""
        return self.column("time")

    def column(self, name: str) -> list:
        """One field of all ``StepRecord``s: 'contact_force', 'dissipation', ..."""
        return [getattr(step.record, name) for step in self.steps]

    def as_rows(self) -> list[dict]:
        """The records as dictionaries, for tables."""
        return [asdict(step.record) for step in self.steps]

    def values(self, quantity: Callable[[Fields], object]) -> list:
        """``quantity(fields)`` of all steps, such as a displacement at a point, for hysteresis."""
        return [quantity(step.fields) for step in self.steps]

    def reactions(self, support: str) -> np.ndarray:
        """The force of one support on the body in all steps, shape (steps, N).

        Parameters
        ----------
        support
            Name of a clamped or prescribed boundary.

        Raises
        ------
        ValueError
            If a step has no such support, or its solver did not tell.
        """
        forces = []
        for step in self.steps:
            told = step.record.reactions or {}
            if support not in told:
                names = ", ".join(sorted(told)) or "none"
                raise ValueError(
                    f"support={support!r}: the step to time {step.record.time:g} tells the "
                    f"reactions of {names}"
                )
            forces.append(told[support])
        return np.array(forces).reshape(len(forces), self.problem.N)
