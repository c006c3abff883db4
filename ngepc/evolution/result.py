"""Results of load histories: fields and numbers of each step."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Trace

from ngepc._deprecated import old_names
from ngepc.checks.kinds import require_function
from ngepc.checks.sentences import counted
from ngepc.discretisation.finer import seen_material, seen_problem
from ngepc.discretisation.points import Points
from ngepc.discretisation.spaces import nodal
from ngepc.evolution.distance import DistanceBound, distance_of
from ngepc.evolution.kept import KeptFields, Store
from ngepc.evolution.memory import Memory
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.model.material import Material
from ngepc.model.own import require_same_mesh
from ngepc.model.places import Place
from ngepc.model.problem import Problem
from ngepc.model.processes import nodes_of
from ngepc.results.fields import Fields
from ngepc.results.outcome import Ending, History, Status
from ngepc.results.result import DiscreteSolution, Result


@dataclass(frozen=True, kw_only=True)
class StepRecord:
    """Numbers of one step, for hysteresis curves and tables; forces have N components."""

    time: float  # end of the step
    cuts: int  # how often the interval was halved to get here
    iterations: int  # Newton steps
    contact_force: float
    """Integral of the contact pressure, positive in compression."""
    contact_resultant: list[float]  # of the obstacles on the body, with friction
    reaction: list[float]  # of all supports on the body
    reactions: dict[str, list[float]]
    """Name of each support, ``str(place)`` -> its force on the body."""
    applied_force: list[float]  # of the loads on the body
    primal_energy: float  # J(u, p) of the step, (2.14)
    elastic_energy: float
    """1/2 int C (eps(u) - p) : (eps(u) - p) with the total plastic strain."""
    dissipation: float  # int beta g for the plastic strain gained in the step
    max_plastic_strain: float  # largest |p_0 + p|_F at the points
    nodes: int  # vertices of the mesh of the step
    error_bound: float | None = None  # ``ErrorBound.relative`` where one was asked for
    guaranteed: bool | None = None  # ``ErrorBound.guaranteed``, whether that is proved
    time_error: float | None = None
    """Estimate of the relative time error up to this step, if an accuracy was given."""
    max_contact_pressure: float = 0.0  # largest at the nodes (stress), exact methods
    max_slip: float = 0.0  # largest in this step at the nodes (length), exact methods
    contact_facets: int = 0  # facets all of whose vertices are pressed, exact methods
    contact_nodes: int = 0  # nodes that are pressed, exact methods

    @classmethod
    def of(
        cls, result: Result, fields: Fields, before: Memory, **known: object
    ) -> StepRecord:
        """The numbers of a step; ``known`` are ``time``, ``cuts`` and the bound.

        ``before`` is the history at the beginning of the step.
        """
        problem = fields.problem
        points = before.functions.points
        forces = result.equilibrium.reactions
        gained = points.at(fields.plastic_increment)
        plastic = before.arrays["plastic_strain"] + gained
        if isinstance(result, ExactResult):
            state = result.state
            lost = result.discrete.law.lost(state.at)
            elastic = np.column_stack([state.volume, state.deviator - plastic])
        else:
            beta = seen_problem(problem, points).beta
            lost = points.at(beta) * np.linalg.norm(gained, axis=1)
            elastic = strain_at(points, fields.elastic_strain)
        size = np.linalg.norm(plastic, axis=1)
        vectors = ("contact_resultant", "reaction", "applied_force")
        return cls(
            **{name: getattr(result, name).tolist() for name in vectors},
            iterations=result.iterations,
            contact_force=float(result.contact_force),
            reactions={str(place): force.tolist() for place, force in forces.items()},
            primal_energy=float(result.primal_energy),
            elastic_energy=elastic_energy(points, problem.material, elastic),
            dissipation=points.integral(lost),
            max_plastic_strain=problem.processes.maximum(size),
            nodes=nodes_of(problem.mesh),
            **numbers_of_contact(result),
            **known,
        )


def numbers_of_contact(result: Result) -> dict[str, float]:
    """Largest contact pressure and slip, and what is pressed, where there are contact rows."""
    if not isinstance(result, DiscreteSolution):
        return {}
    maximum = result.problem.processes.maximum
    slip = np.linalg.norm(result.nodal_slip, axis=1)
    return {
        "max_contact_pressure": result.largest_pressure,
        "max_slip": maximum(slip),
        "contact_facets": result.contact_facets,
        "contact_nodes": result.contact_nodes,
    }


def strain_at(points: Points, strain: CoefficientFunction) -> np.ndarray:
    """Tr e and the coordinates of dev e of a strain e at the points, shape (points, 1 + d)."""
    return np.column_stack([points.at(Trace(strain)), points.coordinates(strain)])


def elastic_energy(points: Points, material: Material, e: np.ndarray) -> float:
    """1/2 int C e : e = int lambda/2 (tr e)^2 + mu e : e, with e as of ``strain_at``."""
    material = seen_material(material, points)
    trace = e[:, 0]
    squares = trace**2 / points.kinematics.size + (e[:, 1:] ** 2).sum(axis=1)
    density = points.at(material.lame_lambda) * trace**2 / 2
    return points.integral(density + points.at(material.lame_mu) * squares)


@dataclass(frozen=True, eq=False)
class EvolutionStep:
    """One finished step: its fields, its numbers and the forces of its contact rows.

    ``evolve`` puts the arrays of earlier steps into a temporary file; ``fields`` are made from them
    when they are asked for, and live as long as they are used.

    Parameters
    ----------
    fields
        Displacement and plastic strain of the step, and what follows from them.
    record
        The numbers of the step.
    contact
        Forces of the contact rows as of ``State.contact``, None for a solver that has no such rows.
    """

    fields: Fields
    record: StepRecord
    contact: np.ndarray | None = None

    def __getattr__(self, name: str) -> Fields:
        """The ``fields`` of a step that has been put away."""
        kept = vars(self).get("kept")
        if name == "fields" and kept is not None:
            return kept.fields
        return object.__getattribute__(self, name)  # says what is missing

    def put_away(self, store: Store, before: Memory) -> None:
        """Keep the arrays in a store alone; ``before`` is the history that the step begins with.

        They stay in memory if the disk is full.
        """
        with suppress(OSError):
            vars(self)["kept"] = KeptFields(store, self.fields, before)
            del vars(self)["fields"]

    def __getstate__(self) -> dict:
        """Everything, with the fields in memory."""
        named = {"fields": self.fields} | vars(self)
        return {name: value for name, value in named.items() if name != "kept"}

    def values_of(self, name: str) -> np.ndarray:
        """The vector of "displacement" or "plastic_increment", to be read only."""
        kept = vars(self).get("kept")
        if kept is None:
            return getattr(self.fields, name).vec.FV().NumPy()
        return kept.array(name)

    @property
    def problem(self) -> Problem:
        """The problem of the step, with p_0 and alpha_0 as they were at its beginning.

        ValueError if its mesh has changed since.
        """
        return require_same_mesh(self.fields.problem)

    @cached_property
    def solution(self) -> ExactResult:
        """The step as a result of the exact method: contact pressure, friction, slip, reactions.

        It is made from the displacement and the forces of contact when it is first asked for.
        ValueError for steps of solvers without such forces.
        """
        return self.solution_like(None)

    def solution_like(self, like: DiscreteProblem | None) -> ExactResult:
        """The same with unchanged data of an earlier discrete problem."""
        if self.contact is None:
            raise ValueError(
                "this step was solved with gamma: contact pressures are kept by steps of the "
                "exact methods"
            )
        discrete = DiscreteProblem(self.problem, like=like)
        u = nodal(self.values_of("displacement"), self.problem).copy()
        state = discrete.state(u, contact=self.contact)
        return ExactResult(state, Status.CONVERGED, "", History())

    @property
    def contact_pressure(self) -> GridFunction:
        """The contact pressure (stress), positive in compression, as in a result."""
        # an AttributeError, as pictures test for the attribute
        if self.contact is None:
            raise AttributeError("contact_pressure: this step was solved with gamma")
        return self.solution.contact_pressure

    @property
    def friction_stress(self) -> GridFunction:
        """Friction on the body (stress), as in a result."""
        return self.solution.friction_stress

    @property
    def slip(self) -> np.ndarray:
        """The slip of each contact row in this step (length), shape (rows, N - 1)."""
        return self.solution.nodal_slip

    def __repr__(self) -> str:
        time = self.record.time
        steps = self.record.iterations
        force = self.record.contact_force
        return f"<EvolutionStep: to time {time:g}, Newton steps {steps}, contact force {force:.8g}>"


@dataclass(eq=False)
class Evolution(Ending):
    """The result of ``evolve``: the finished steps, and how the run ended.

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
        The message of a run that was not stopped says what is to be known of it: contact that never
        happens or is on few facets, data known from samples, strains that are not small.
    """

    problem: Problem
    steps: list[EvolutionStep]
    memory: Memory
    status: Status = Status.CONVERGED
    message: str = ""

    def __repr__(self) -> str:
        reached = f", the last one to time {self.times[-1]:g}" if self.steps else ""
        off = ""
        if self.time_error is not None:
            off = f", time error about {100 * self.time_error:.2g} % (estimate)"
        return f"<Evolution: {self.status}, {counted(len(self.steps), 'step')}{reached}{off}>"

    @cached_property
    def distance_bound(self) -> DistanceBound:
        """How far the last step is from that of the continuous problem with the same increments.

        In the energy norm: (2 sum B_n)^(1/2) with the error bound B_n of each step.  Proved for
        order one, linear hardening and no contact, an estimate beyond, see its ``message``: where
        hardening varies inside elements, each step is solved again with its means on elements.
        ValueError for what has no error bound, and for steps that were solved with gamma.
        """
        return distance_of(self.steps)

    @property
    def time_error(self) -> float | None:
        """The largest ``StepRecord.time_error``, an estimate of the error of the increments.

        In histories that were compared with six times as many steps it was within a factor 2 of
        errors above a thousandth, except while the contact is a single node: there halving steps
        changes as much each time, and the error was up to 5.5 times as large.
        None where no accuracy was asked for.
        """
        estimates = [error for error in self.column("time_error") if error is not None]
        return max(estimates, default=None)

    @property
    def times(self) -> list[float]:
        """Ends of the finished steps."""
        return self.column("time")

    def column(self, name: str) -> list:
        """One field of all ``StepRecord``s: 'contact_force', 'dissipation', ..."""
        known = StepRecord.__dataclass_fields__
        if name not in known:
            raise ValueError(f"name={name!r}: one of {', '.join(known)} is needed")
        return [getattr(step.record, name) for step in self.steps]

    def as_rows(self) -> list[dict]:
        """The records as dictionaries, for tables."""
        return [asdict(step.record) for step in self.steps]

    def values(self, quantity: Callable[[Fields], object]) -> list:
        """``quantity(fields)`` of all steps, such as a displacement at a point, for hysteresis."""
        require_function("quantity", quantity, "the fields")
        return [quantity(step.fields) for step in self.steps]

    def reactions(self, support: Place) -> np.ndarray:
        """The force of one support on the body in all steps, shape (steps, N).

        Parameters
        ----------
        support
            Name of a clamped or prescribed boundary, or the ``Point`` or ``Edge``.

        Raises
        ------
        ValueError
            If a step has no such support.
        """
        name = str(support)
        forces_of_steps = self.column("reactions")
        for time, forces in zip(self.times, forces_of_steps, strict=True):
            if name not in forces:
                known = f"the reactions of {', '.join(sorted(forces)) or 'none'}"
                raise ValueError(
                    f"support={support!r}: the step to time {time:g} has {known}"
                )
        return np.reshape(
            [forces[name] for forces in forces_of_steps],
            (len(forces_of_steps), self.problem.N),
        )


__getattr__ = old_names(__name__)
