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
from ngepc.results.result import Result

Force = list[float]
"""N components."""


@dataclass(frozen=True, kw_only=True)
class StepRecord:
    """Numbers of one step, for hysteresis curves and tables."""

    time: float  # end of the step
    cuts: int  # how often the interval was halved to get here
    iterations: int  # Newton steps
    contact_force: float  # resultant of the normal contact pressure, positive in compression
    contact_resultant: Force  # of the obstacles on the body, with friction
    reaction: Force  # of all supports on the body
    reactions: dict[str, Force]  # str(place) of each support -> its force on the body
    applied_force: Force  # of the loads on the body
    primal_energy: float  # J(u, p) of the step, (2.14)
    elastic_energy: float  # 1/2 int C (eps(u) - p) : (eps(u) - p) with the total plastic strain
    dissipation: float  # int beta |p| with the plastic strain gained in the step
    max_plastic_strain: float  # largest |p_0 + p|_F at the points
    nodes: int  # vertices of the mesh of the step
    error_bound: float | None = None  # ``ErrorBound.relative`` where one was asked for

    @classmethod
    def of(cls, result: Result, fields: Fields, points: Points, **known: object) -> StepRecord:
        """The numbers of a step; ``known`` are ``time``, ``cuts`` and ``error_bound``."""
        problem, forces = fields.problem, result.equilibrium.reactions
        elastic = fields.strain - problem.eps_0 - fields.plastic_strain
        stored = 0.5 * InnerProduct(fields.stress, elastic)
        lost = as_scalar(problem.beta) * Norm(fields.plastic_increment)
        return cls(
            iterations=result.iterations,
            contact_force=float(result.contact_force),
            contact_resultant=result.contact_resultant.tolist(),
            reaction=result.reaction.tolist(),
            reactions={str(place): force.tolist() for place, force in forces.items()},
            applied_force=result.applied_force.tolist(),
            primal_energy=float(result.primal_energy),
            elastic_energy=points.integral(points.at(stored)),
            dissipation=points.integral(points.at(lost)),
            max_plastic_strain=problem.processes.most(points.at(fields.equivalent_plastic_strain)),
            nodes=nodes_of(problem.mesh),
            **known,
        )


@dataclass(frozen=True, eq=False)
class EvolutionStep:
    """One finished step: its fields, its numbers and the forces of its contact rows.

    ``contact`` are those of ``State.contact``, None for a solver that has no such rows.
    """

    fields: Fields
    record: StepRecord
    contact: np.ndarray | None = None

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
            If a step has no such support.
        """
        forces = []
        for step in self.steps:
            told, time = step.record.reactions, step.record.time
            if support not in told:
                names = ", ".join(sorted(told)) or "none"
                raise ValueError(
                    f"support={support!r}: the step to time {time:g} tells the reactions of {names}"
                )
            forces.append(told[support])
        return np.array(forces).reshape(len(forces), self.problem.N)
