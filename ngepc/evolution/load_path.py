"""Load paths: loads, gaps and prescribed displacements as functions of time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import (
    Coefficient,
    is_number,
    require_components,
    require_integer,
    require_number,
)
from ngepc.checks.coefficients import with_own_functions
from ngepc.checks.kinds import require_function, require_instance
from ngepc.checks.sentences import in_words
from ngepc.model.places import Roller
from ngepc.model.problem import Problem

Changes = Mapping[str, object]
"""Field of ``Problem`` -> its value in the step; other fields are those of the problem."""

Motion = CoefficientFunction | Sequence[Coefficient]
"""A vector-valued coefficient, or N numbers and scalar coefficients (length)."""

# The body, and what earlier steps decide, do not change; a load cycle scales its loads
CARRIED = ("mesh", "kinematics", "order", "thickness", "initial_plastic_strain")
CARRIED += ("initial_hardening", "initial_accumulated")
CARRIED += ("initial_displacement", "duration")
LOADS = ("traction", "pressure", "body_force", "initial_strain", "prescribed")


class Listed(dict[float, Changes]):
    """Changes at some times, called like a function of time."""

    def __call__(self, time: float) -> Changes:
        """The changes at one of these times."""
        return self[time]


@dataclass(frozen=True)
class Schedule:
    """Steps at given times, with changes that are known at every time.

    A step that fails can be halved, because ``changes`` is a function of time.
    ``Schedule.listed`` makes a schedule whose changes are known at the ends of steps only.

    Parameters
    ----------
    times
        Ends of the steps, increasing, after ``begin``.
    changes
        Time -> changes of the problem, such as {'gap': 0.1 - t}.  A 'material' of the step may have
        other moduli, yield stress and hardening, for example at another temperature, but the same
        kind of hardening: plastic strain and PEEQ are kept, back stresses follow the new moduli.
    begin
        Time of the initial state, the beginning of the first step.  None if it is unknown.
    obstacle_motion
        Time -> displacement of the surface of the obstacles (length), N numbers or a vector
        coefficient, for friction: slip is the motion of the body relative to this surface.  The
        gap is given separately in ``changes``.  None if the surface does not move tangentially.

    Raises
    ------
    TypeError, ValueError
        If the times do not increase or ``changes`` is no function.
    """

    times: Sequence[float]
    changes: Callable[[float], Changes]
    begin: float | None = 0.0
    obstacle_motion: Callable[[float], Motion] | None = None

    def __post_init__(self) -> None:
        require_function("changes", self.changes, "time")
        require_function("obstacle_motion", self.obstacle_motion, "time", optional=True)
        times = numbers_in("times", self.times)
        if not times:
            raise ValueError(
                f"times={in_words(self.times)}: at least one time is needed"
            )
        known = () if self.begin is None else (require_number("begin", self.begin),)
        for before, after in pairwise((*known, *times)):
            if not before < after:
                raise ValueError(
                    f"times={in_words(times)}, begin={self.begin!r}: increasing "
                    "numbers are needed, "
                    f"{after:g} does not come after {before:g}"
                )
        object.__setattr__(self, "times", times)

    @classmethod
    def listed(
        cls, pairs: Iterable[tuple[float, Changes]], begin: float | None = None
    ) -> Schedule:
        """Steps with changes that are known at their ends only.

        Parameters
        ----------
        pairs
            (time, changes) for each step.
        begin
            Time of the given initial state.  None for 0, or for unknown if the first time is not
            after 0: then the first step has no length, which matters where a material has a rate.

        Raises
        ------
        TypeError, ValueError
            If there are no pairs, or the times do not increase from ``begin``.
        """
        steps = pairs_in(pairs)
        if not steps:
            raise ValueError(f"steps={in_words(pairs)}: at least one step is needed")
        times = numbers_in("times", [time for time, _ in steps])
        changes = Listed(zip(times, (changes for _, changes in steps), strict=True))
        if begin is None:
            begin = 0.0 if times[0] > 0 else None
        return cls(times, changes, begin)

    @property
    def divisible(self) -> bool:
        """Whether steps can be cut: their beginning and the changes in between are known."""
        return self.begin is not None and not isinstance(self.changes, Listed)

    def dragged(
        self, before: float | None, time: float, dimension: int
    ) -> CoefficientFunction | None:
        """What the surface of the obstacles moves from a time to another one; None if it does not.

        TypeError, ValueError if it is no vector of so many components, or begins at no known time.
        """
        if self.obstacle_motion is None:
            return None
        if before is None:
            raise ValueError(
                "obstacle_motion with begin=None: the time of the initial state is needed"
            )
        motions = []
        vectors = []
        for t in (before, time):
            name = f"obstacle_motion at time {t:g}"
            motion = self.obstacle_motion(t)
            vector = require_components(name, motion, dimension)
            # the next call may change this motion, its Parameters and functions in place
            vectors.append(with_own_functions(name, vector))
            is_one = isinstance(motion, CoefficientFunction)
            motions.append(motion if is_one else tuple(motion))
        return None if are_same_numbers(*motions) else vectors[1] - vectors[0]

    def at(self, time: float) -> Changes:
        """The changes at a time; an error if they are not a mapping of legal fields."""
        changes = self.changes(time)
        if not isinstance(changes, Mapping):
            raise TypeError(
                f"changes at time {time:g} are {in_words(changes)}: a mapping is needed"
            )
        legal = [f.name for f in fields(Problem) if f.name not in CARRIED]
        for name in changes:
            if name not in legal:
                prefix = f"changes at time {time:g} name {name!r}"
                raise ValueError(f"{prefix}: a step can change {', '.join(legal)}")
        return changes


def as_schedule(steps: object) -> Schedule:
    """``steps`` as a schedule: itself, or an iterable of (time, changes); else an error."""
    if isinstance(steps, Schedule):
        return steps
    return Schedule.listed(steps)


def are_same_numbers(one: Motion, other: Motion) -> bool:
    """Whether two vectors, of legal components, are the same numbers."""
    if isinstance(one, CoefficientFunction) or isinstance(other, CoefficientFunction):
        return False
    return all(map(is_number, (*one, *other))) and one == other


def numbers_in(name: str, values: object) -> tuple[float, ...]:
    """``values``, a sequence of finite numbers, as floats."""
    if not isinstance(values, Sequence | np.ndarray) or isinstance(values, str | bytes):
        raise TypeError(f"{name}={in_words(values)}: a sequence of numbers is needed")
    return tuple(
        require_number(f"{name}[{i}]", value) for i, value in enumerate(values)
    )


def load_cycle(problem: Problem, factors: Sequence[float], steps: int = 1) -> Schedule:
    """All loads of ``problem`` times a factor that runs linearly from 0 through ``factors``.

    The factor is 0 at time 0, ``factors[0]`` at time 1, ``factors[1]`` at time 2, and so on:
    ``load_cycle(problem, [1, -1, 1], steps=4)`` loads, reverses and reloads in 4 steps each.
    Loads, pressures, initial strains and prescribed displacements are scaled; gaps are not.

    Parameters
    ----------
    problem
        Its loads are those at factor 1.
    factors
        Corners of the path, at least one finite number.
    steps
        Steps from one corner to the next, >= 1.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem has no loads but its gaps.
    """
    require_instance("problem", problem, Problem, "a Problem")
    steps = require_integer("steps", steps, 1)
    corners = [0.0, *numbers_in("factors", factors)]
    if len(corners) < 2:
        raise ValueError(f"factors={factors!r}: at least one number is needed")
    times = np.arange(1, steps * (len(corners) - 1) + 1) / steps
    loads = {name: getattr(problem, name) for name in LOADS}
    if not any(_is_load(name, value) for name, value in loads.items()):
        raise ValueError(
            f"problem has no loads to scale: one of {', '.join(LOADS)} is needed, of supports "
            "other than zero (gaps are not scaled: a Schedule changes them)"
        )
    factor = partial(np.interp, xp=np.arange(len(corners)), fp=corners)
    return Schedule(
        tuple(times.tolist()), lambda time: scaled(loads, float(factor(time)))
    )


def _is_load(name: str, data: object) -> bool:
    """Whether data of a problem are more than nothing; prescribed zeros are supports."""
    if isinstance(data, Mapping):
        return any(_is_load(name, one) for one in data.values())
    if name != "prescribed":
        return data is not None
    if isinstance(data, Roller):
        return _is_load(name, data.value)
    if isinstance(data, Sequence):
        return any(_is_load(name, one) for one in data)
    return data is not None and not (is_number(data) and data == 0)


def pairs_in(given: object) -> list[tuple[float, Changes]]:
    """The pairs (time, changes) of an iterable; TypeError for anything else.

    What an iterable of the user raises itself is left as it is.
    """
    needed = f"steps={in_words(given)}: a Schedule or pairs (time, changes) are needed"
    if not isinstance(given, Iterable):
        raise TypeError(needed)
    steps = list(given)
    try:
        return [(time, changes) for time, changes in steps]
    except (TypeError, ValueError):
        raise TypeError(needed) from None


def scaled(data: object, factor: float) -> object:
    """Data of a problem times a factor: numbers, coefficients, and containers of these."""
    if data is None:
        return None
    if isinstance(data, Mapping):
        return {key: scaled(one, factor) for key, one in data.items()}
    if isinstance(data, Roller):
        return replace(data, value=factor * data.value)
    if isinstance(data, Sequence):
        return tuple(scaled(one, factor) for one in data)
    return factor * data
