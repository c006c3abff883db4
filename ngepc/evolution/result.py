"""Results of load histories: history variables, fields and numbers of each step, checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from ngsolve import CoefficientFunction, GridFunction

from ngepc.checks.arguments import is_number
from ngepc.discretisation.law import Law
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.points import PointFunctions, Points, on_children
from ngepc.evolution.distance import DistanceBound, distance_of
from ngepc.evolution.load_path import Schedule
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.model.material import PEEQ, Material
from ngepc.model.problem import Problem
from ngepc.model.processes import nodes_of
from ngepc.results.checkpoint import (
    Checkpoint,
    load,
    problem_fingerprint,
    save,
    work_fingerprint,
)
from ngepc.results.fields import Fields
from ngepc.results.files import check_writable
from ngepc.results.outcome import Ending, History, Status
from ngepc.results.result import DiscreteSolution, Result
from ngepc.results.stored import array_of, reading, value_of


@dataclass(frozen=True, eq=False)
class Memory:
    """The history variables p_0 and alpha_0 of (2.15) and (2.16) at the integration points.

    ``arrays`` are coordinates of "plastic_strain" p_0 (1) and "back_stress" dev alpha_2,0 (stress),
    shape (points, d), "hardening_variable" alpha_1,0 >= 0 (1) and "accumulated", PEEQ (1), shape
    (points,); of ``Material.cyclic`` "parts" too, the plastic strains of n sub-elements, shape
    (points, n d).  ``functions`` are the points, and the polynomials through them, ``material`` is
    that of the stresses.
    """

    functions: PointFunctions
    arrays: dict[str, np.ndarray]
    material: Material

    @classmethod
    def initial(cls, problem: Problem) -> Memory:
        """The initial state that ``problem`` was given."""
        points = Points(problem.mesh, problem.kinematics, problem.order)
        alpha_1, alpha_2 = problem.alpha_0
        coordinates = problem.kinematics.coordinates
        given = {
            "plastic_strain": coordinates(problem.p_0),
            "back_stress": coordinates(alpha_2),
            "hardening_variable": alpha_1,
            "accumulated": problem.accumulated_0,
        }
        arrays = {name: points.at(v) for name, v in given.items()}
        if problem.material.overlay is not None:
            arrays |= law_of(problem, points).own_memory()
        return cls(points.functions, arrays, problem.material)

    def after_step(self, step: EvolutionStep) -> Memory:
        """The history after a step, from its displacement and its plastic strain."""
        points = self.functions.points
        problem = step.problem
        p = points.at(step.fields.plastic_increment)
        material = problem.material
        if material.overlay is None and material.hill is None:
            return self.after(material, p)
        law = law_of(problem, points)
        u = nodal(step.fields.displacement.vec.FV().NumPy(), problem)
        at = law.returned(*law.beyond_initial(*points.strain(u)))
        return self.after(material, p, law.own_memory(at), at.gained)

    def after(
        self,
        material: Material,
        p: np.ndarray,
        own: Mapping[str, np.ndarray] | None = None,
        size: np.ndarray | None = None,
    ) -> Memory:
        """p_0 + p, alpha_2 + k p, alpha_1 + k_1 H sigma_y |p| and PEEQ after a step.

        ``own`` are additional history variables of the law, ``size`` is what takes the place of
        |p| (points,), for a yield surface that is no sphere.
        """
        at = self.functions.points.at
        size = np.linalg.norm(p, axis=1) if size is None else size
        gained = {
            "plastic_strain": p,
            "back_stress": at(material.hardening)[:, None] * p,
            "hardening_variable": at(material.scalar_growth) * size,
            "accumulated": PEEQ * size,
        }
        before = self.with_material(material).arrays
        grown = {name: before[name] + more for name, more in gained.items()}
        return replace(self, arrays=grown | dict(own or {}), material=material)

    def with_material(self, material: Material) -> Memory:
        """The same strains with the moduli of another material.

        The plastic strain, PEEQ, alpha_2 / k and alpha_1 / k_1 are kept: the strains whose
        energy is that of hardening.  The stresses alpha_2 and alpha_1 follow the moduli k and k_1.
        ValueError where a kind of hardening comes or goes, since its strain is not known.
        """
        if material is self.material:
            return self
        at = self.functions.points.at
        moduli = {
            "back_stress": "hardening",
            "hardening_variable": "hardening_stiffness",
        }
        arrays = dict(self.arrays)
        for name, modulus in moduli.items():
            before = at(getattr(self.material, modulus))
            after = at(getattr(material, modulus))
            if ((before == 0) != (after == 0)).any():
                raise ValueError(
                    f"material={material!r}: {modulus} is zero in one of two successive steps; "
                    "all steps need the same kind of hardening"
                )
            factor = after / np.where(before > 0, before, 1.0)
            arrays[name] = (np.where(before > 0, factor, 1.0) * arrays[name].T).T
        return replace(self, arrays=arrays, material=material)

    def on(self, problem: Problem, parents: np.ndarray) -> Memory:
        """The same functions on a mesh whose simplices lie in these ones; PEEQ stays >= 0."""
        points = Points(problem.mesh, problem.kinematics, problem.order)
        before = self.functions.points
        carried = {
            k: on_children(v, before, points, parents) for k, v in self.arrays.items()
        }
        carried["accumulated"] = np.maximum(carried["accumulated"], 0.0)
        return Memory(points.functions, carried, self.material)

    def as_bounds_need_it(self) -> Memory:
        """The same history with one value of hardening on each element.

        Between the points of an element the polynomial of alpha_1 or PEEQ may be negative, and so
        may be its values at the points of smaller elements.  The mean is not.
        """
        arrays = dict(self.arrays)
        names = ["hardening_variable"]
        if self.material.law is not None:
            names.append("accumulated")
        for name in names:
            arrays[name] = self.functions.points.cell_means(arrays[name])
        return replace(self, arrays=arrays)

    def problem(self, base: Problem, changes: Mapping[str, object]) -> Problem:
        """``base`` with the changes of a step and this memory as its initial state."""
        step = base.changed(**changes)
        check_kind(base.material, step.material)
        return self.before(step)

    def before(self, step: Problem, **left: object) -> Problem:
        """A step that is checked, with this memory as its initial state, and what else is left."""
        material = step.material
        tensor = step.kinematics.tensor
        arrays = self.with_material(material).arrays
        given = {name: self.functions.function(v) for name, v in arrays.items()}
        hardening = tensor(given["back_stress"])
        if not is_zero(material.hardening_modulus):
            hardening = given["hardening_variable"], hardening
        if "parts" in given:
            hardening = given["parts"]
        return step.continued(
            initial_plastic_strain=tensor(given["plastic_strain"]),
            initial_hardening=hardening,
            initial_accumulated=given["accumulated"],
            **left,
        )


def check_kind(one: Material, other: Material) -> None:
    """Accept a material of a step with the same history variables as the other one."""
    for name in ("law", "hill", "overlay"):
        before = getattr(one, name)
        after = getattr(other, name)
        if type(before) is not type(after):
            raise ValueError(
                f"material={other!r}: {name} like that of the problem is needed, {before!r}"
            )
    if one.overlay is not None and one.overlay.count != other.overlay.count:
        raise ValueError(
            f"material={other!r}: {one.overlay.count} sub-elements are needed, "
            f"it has {other.overlay.count}"
        )


def is_zero(value: object) -> bool:
    """Whether a coefficient is the number 0."""
    return is_number(value) and value == 0


@dataclass(frozen=True, kw_only=True)
class StepRecord:
    """Numbers of one step, for hysteresis curves and tables; forces have N components."""

    time: float  # end of the step
    cuts: int  # how often the interval was halved to get here
    iterations: int  # Newton steps
    contact_force: (
        float  # resultant of the normal contact pressure, positive in compression
    )
    contact_resultant: list[float]  # of the obstacles on the body, with friction
    reaction: list[float]  # of all supports on the body
    reactions: dict[
        str, list[float]
    ]  # str(place) of each support -> its force on the body
    applied_force: list[float]  # of the loads on the body
    primal_energy: float  # J(u, p) of the step, (2.14)
    elastic_energy: (
        float  # 1/2 int C (eps(u) - p) : (eps(u) - p) with the total plastic strain
    )
    dissipation: float  # int beta g for the plastic strain gained in the step
    max_plastic_strain: float  # largest |p_0 + p|_F at the points
    nodes: int  # vertices of the mesh of the step
    error_bound: float | None = None  # ``ErrorBound.relative`` where one was asked for
    guaranteed: bool | None = None  # ``ErrorBound.guaranteed``, whether that is proved
    time_error: float | None = None
    """Estimate of the relative time error up to this step, if an accuracy was given."""
    max_contact_pressure: float = 0.0  # largest at the nodes (stress), exact methods
    max_slip: float = 0.0  # largest in this step at the nodes (length), exact methods

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
        u = nodal(fields.displacement.vec.FV().NumPy(), problem)
        if isinstance(result, ExactResult):
            lost = result.discrete.law.lost(result.state.at)
        else:
            lost = points.at(problem.beta) * np.linalg.norm(gained, axis=1)
        size = np.linalg.norm(plastic, axis=1)
        vectors = ("contact_resultant", "reaction", "applied_force")
        return cls(
            **{name: getattr(result, name).tolist() for name in vectors},
            iterations=result.iterations,
            contact_force=float(result.contact_force),
            reactions={str(place): force.tolist() for place, force in forces.items()},
            primal_energy=float(result.primal_energy),
            elastic_energy=energy_of_strains(problem, points, u, plastic),
            dissipation=points.integral(lost),
            max_plastic_strain=problem.processes.maximum(size),
            nodes=nodes_of(problem.mesh),
            **largest_at_contact(result),
            **known,
        )


def largest_at_contact(result: Result) -> dict[str, float]:
    """The largest contact pressure and slip of a step, where the solver has contact rows."""
    if not isinstance(result, DiscreteSolution):
        return {}
    maximum = result.problem.processes.maximum
    slip = np.linalg.norm(result.nodal_slip, axis=1)
    return {
        "max_contact_pressure": maximum(result.contact_pressure.vec.FV().NumPy()),
        "max_slip": maximum(slip),
    }


def energy_of_strains(
    problem: Problem, points: Points, u: np.ndarray, plastic: np.ndarray
) -> float:
    """1/2 int C e : e of e = eps(u) - eps_0 - p, from nodal u and coordinates of p.

    In plane stress eps_zz is the one for which sigma_zz = 0.
    """
    kinematics = problem.kinematics
    volume, deviator = points.strain(u)
    if problem.initial_strain is not None:
        swelling, distortion = Law.initial_parts(problem, points)
        volume = volume - swelling
        deviator = deviator - distortion
    deviator = deviator - plastic
    two_mu = points.at(2 * problem.material.lame_mu)
    bulk = points.at(problem.material.lame_lambda) + two_mu / kinematics.size
    if kinematics.thin:
        n = kinematics.across
        stress = bulk * volume + two_mu * (deviator @ n)
        z = -stress / (bulk + two_mu * (n @ n))
        volume = volume + z
        deviator = deviator + z[:, None] * n
    shear = np.einsum("pd,pd->p", deviator, deviator)
    return points.integral(0.5 * (bulk * volume**2 + two_mu * shear))


def tensors(points: Points, value: CoefficientFunction) -> np.ndarray:
    """A tensor at the points, shape (points, size, size)."""
    size = points.kinematics.size
    return points.at(value).reshape(-1, size, size)


def elastic_energy(points: Points, material: Material, e: np.ndarray) -> float:
    """1/2 int C e : e = int lambda/2 (tr e)^2 + mu e : e of strains (points, size, size)."""
    trace = np.trace(e, axis1=1, axis2=2)
    shear = (e**2).sum(axis=(1, 2))
    density = points.at(material.lame_lambda) * trace**2 / 2
    return points.integral(density + points.at(material.lame_mu) * shear)


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
        """The problem of the step, with p_0 and alpha_0 as they were at its beginning."""
        return self.fields.problem

    @cached_property
    def solution(self) -> ExactResult:
        """The step as a result of the exact method: contact pressure, friction, slip, reactions.

        It is made from the displacement and the forces of contact when it is first asked for.
        ValueError for steps of solvers without such forces.
        """
        if self.contact is None:
            raise ValueError(
                "this step was solved with gamma: contact pressures are kept by steps of the "
                "exact methods"
            )
        discrete = DiscreteProblem(self.problem)
        values = self.fields.displacement.vec.FV().NumPy()
        u = nodal(values, self.problem).copy()
        state = discrete.state(u, contact=self.contact)
        return ExactResult(state, Status.CONVERGED, "", History())

    @property
    def contact_pressure(self) -> GridFunction:
        """The contact pressure (stress), positive in compression, as in a result."""
        if (
            self.contact is None
        ):  # an AttributeError, as pictures test for the attribute
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
        happens, data known from samples, strains that are not small.
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
        return f"<Evolution: {self.status}, {len(self.steps)} steps{reached}{off}>"

    def __str__(self) -> str:
        """The summary on one line, and the message below it."""
        return "\n".join(filter(None, (repr(self), self.message)))

    @cached_property
    def distance_bound(self) -> DistanceBound:
        """How far the last step is from that of the continuous problem with the same increments.

        In the energy norm: (2 sum B_n)^(1/2) with the error bound B_n of each step.  Proved for
        order one, linear hardening and no contact, an estimate beyond, see its ``message``.
        ValueError for what has no error bound, and for steps that were solved with gamma.
        """
        return distance_of(self.steps)

    @property
    def time_error(self) -> float | None:
        """The largest ``StepRecord.time_error``, an estimate of the error of the increments.

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
        forces_of_steps = self.column("reactions")
        for time, forces in zip(self.times, forces_of_steps, strict=True):
            if support not in forces:
                known = f"the reactions of {', '.join(sorted(forces)) or 'none'}"
                raise ValueError(
                    f"support={support!r}: the step to time {time:g} has {known}"
                )
        return np.reshape(
            [forces[support] for forces in forces_of_steps],
            (len(forces_of_steps), self.problem.N),
        )


class EvolutionFile:
    """The checkpoint of an evolution, written atomically; OSError if it cannot be written.

    Processes that share the mesh have one each, '<stem>_0000<suffix>', ..., with what is on their
    parts.
    """

    def __init__(
        self, path: Path, problem: Problem, schedule: Schedule, solver: object
    ) -> None:
        self._processes = problem.processes
        self._rows = []
        name = getattr(solver, "__qualname__", type(solver).__qualname__)
        settings = {
            "times": list(schedule.times),
            "solver": name,
            "keeps": "forces of contact",
        }
        if self._processes.size > 1:
            path = path.with_name(
                f"{path.stem}_{self._processes.rank:04d}{path.suffix}"
            )
            settings["processes"] = self._processes.size
        self._processes.together(partial(check_writable, path))
        self.path = path
        self.fingerprint = work_fingerprint("evolution", problem, **settings)

    def load(self) -> tuple[list[tuple[dict, dict]], list[tuple[float, int]]]:
        """Rows and arrays of the steps of an earlier run, and the pending steps.

        ValueError if the file is damaged or belongs to other work.
        """
        stored = self._processes.together(partial(load, self.path, self.fingerprint))
        found = {"steps": [], "pending": []}
        if stored is not None:
            found = self._processes.together(partial(self._checked, stored))
        reached = self._processes.all((len(found["steps"]), found["pending"]))
        count, pending = min(
            reached, key=itemgetter(0)
        )  # a run may end between two files
        names = ("u", "p", "contact")
        rows = found["steps"][:count]
        arrays = [
            {n: stored.arrays.get(f"{n}{i}") for n in names} for i in range(count)
        ]
        return list(zip(rows, arrays, strict=True)), pending

    def _checked(self, stored: Checkpoint) -> dict:
        """The record of a file, with steps and pending times as they must be."""
        with reading(self.path):
            steps = stored.record["steps"]
            pending = stored.record["pending"]
            if not all(isinstance(row["fingerprint"], str) for row in steps):
                raise TypeError("steps without fingerprints")
            for time, level in pending:
                value_of("pending time", float, time)
                value_of("level", int, level)
            sizes = set()
            for number in range(len(steps)):
                forces = stored.arrays.get(f"contact{number}")
                if forces is not None:
                    array_of(self.path, {"contact": forces}, "contact", forces.size)
                sizes.add(None if forces is None else forces.size)
            if len(sizes) > 1:
                raise ValueError(f"forces of contact of different sizes, {sizes}")
            return {"steps": steps, "pending": pending}

    def check(self, problem: Problem, time: float, digest: str) -> None:
        """ValueError if ``problem`` is not what the step to a time was solved for."""
        differs = problem_fingerprint(problem) != digest
        if self._processes.any(np.array(differs)):
            other = f"the step to time {time:g} had other data; move it away"
            raise ValueError(f"checkpoint {self.path} belongs to other work: {other}")

    def save(
        self, steps: list[EvolutionStep], pending: list[tuple[float, int]]
    ) -> None:
        """Write all finished steps and the pending times."""
        arrays = {}
        for i, step in enumerate(steps):
            u = step.fields.displacement
            p = step.fields.plastic_increment
            arrays |= {f"u{i}": u.vec.FV().NumPy(), f"p{i}": p.vec.FV().NumPy()}
            arrays |= {} if step.contact is None else {f"contact{i}": step.contact}
        for step in steps[len(self._rows) :]:
            digest = problem_fingerprint(step.problem)
            self._rows.append(vars(step.record) | {"fingerprint": digest})
        record = {"steps": self._rows, "pending": pending}
        self._processes.together(
            partial(save, self.path, self.fingerprint, record, arrays)
        )
