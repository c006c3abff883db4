"""A material point: the law alone under given strains or stresses, without a body."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import scipy
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import Coefficient, require_integer, require_number
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.discretisation.law import Return
from ngepc.discretisation.laws import law_of
from ngepc.evolution.load_path import numbers_in
from ngepc.evolution.memory import Memory
from ngepc.geometries import block
from ngepc.linalg.blas import one_blas_thread
from ngepc.model.data import ProblemData
from ngepc.model.kinematics import SOLID
from ngepc.model.material import Material
from ngepc.results.outcome import Status

COMPONENTS = ("xx", "yy", "zz", "xy", "xz", "yz")  # of a symmetric tensor
_PLACES = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])
"""Number of each entry of a tensor."""

_UNITS = (np.arange(6)[:, None, None] == _PLACES).astype(float)
"""The tensor of each component."""

_ENTRIES = _UNITS.sum(axis=(1, 2))
_TRACES = np.trace(_UNITS, axis1=1, axis2=2)
_DEVIATORS = np.einsum("kij,dij->kd", _UNITS, SOLID.basis)
"""Deviatoric coordinates of the tensor of each component."""

# Relative change of a strain that ends a search, and the tolerance of the stress
PRECISE = 1e-15
ACCEPTED = 1e-11

ROUNDED = 1e-14
"""Stress residual at which Newton's method ends, relative to yield stress and given stresses."""

NEWTON_STEPS = 20

Path = Mapping[str, float | Sequence[float]]


@dataclass(frozen=True, eq=False)
class PointHistory:
    """The history of a material point, at the end of each increment.

    Parameters
    ----------
    strain, stress, plastic_strain
        Tensors, shape (increments, 3, 3); of strains the tensor components.
    accumulated_plastic_strain, corners
        PEEQ, shape (increments,); numbers of the increments that end at a corner of the path.
    status
        CONVERGED, or LIMIT_LOAD where the stress cannot be reached: the history ends before.
    """

    strain: np.ndarray
    stress: np.ndarray
    plastic_strain: np.ndarray
    accumulated_plastic_strain: np.ndarray
    corners: np.ndarray
    status: Status

    @property
    def von_mises(self) -> np.ndarray:
        """(3/2)^(1/2) |dev sigma|_F, shape (increments,)."""
        mean = np.trace(self.stress, axis1=1, axis2=2)[:, None, None] / 3
        return np.sqrt(1.5) * np.linalg.norm(
            self.stress - mean * np.eye(3), axis=(1, 2)
        )

    def curve(self, component: str = "xx") -> tuple[np.ndarray, np.ndarray]:
        """Strain and stress of a component from the origin on, shape (1 + increments,) each.

        ``axes.plot(*history.curve("xx"))`` draws the curve of a bar.  ValueError for a component
        that is none of 'xx', 'yy', 'zz', 'xy', 'xz', 'yz'.
        """
        if component not in COMPONENTS:
            legal = ", ".join(COMPONENTS)
            raise ValueError(
                f"component={in_words(component)}: one of {legal} is needed"
            )
        i, j = ("xyz".index(letter) for letter in component)
        tensors = (self.strain, self.stress)
        strain, stress = (np.append(0.0, tensor[:, i, j]) for tensor in tensors)
        return strain, stress


@one_blas_thread
def material_point(
    material: Material,
    strain: Path | None = None,
    stress: Path | None = None,
    steps: int = 1,
    duration: float | None = None,
) -> PointHistory:
    """Drive a point in three dimensions along straight lines from zero through given corners.

    ``material_point(steel, strain={"xx": [0.02, -0.02]}, steps=50)`` is a bar pulled and pushed.

    Parameters
    ----------
    material
        The law; of coefficients the value at the middle of the unit cube counts.
    strain, stress
        'xx', 'yy', 'zz', 'xy', 'xz' or 'yz' -> values at the corners, or one for all.  Strains are
        tensor components.  Components that are given in neither are free of stress.
    steps
        Increments from one corner to the next, implicit Euler steps of first order.
    duration
        Time from one corner to the next, for a material with a rate.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or a component is given twice.
    """
    require_instance("material", material, Material, "a Material")
    steps = require_integer("steps", steps, 1)
    path = _path_between_corners(strain, stress, steps)
    held = np.array([name in (strain or {}) for name in COMPONENTS])
    if duration is not None:
        duration = require_number("duration", duration, 0, strict=True) / steps

    point = _Point(material, duration)
    e = np.zeros(6)
    found = []
    for target in path:
        e = point.solved(e, target, held)
        if e is None:
            break
        found.append((e, *point.accept(e)))
    *tensors, peeq = zip(*found, strict=True) if found else ((), (), (), ())
    return PointHistory(
        *(np.reshape(values, (-1, 6))[:, _PLACES] for values in tensors),
        accumulated_plastic_strain=np.array(peeq),
        corners=np.arange(steps - 1, len(found), steps),
        status=Status.LIMIT_LOAD if e is None else Status.CONVERGED,
    )


def value_in_the_middle(value: Coefficient) -> float:
    """A datum of a material point: that of the middle of the unit cube."""
    if not isinstance(value, CoefficientFunction):
        return float(value)
    cube = block.structured_mesh(1, 1, 1)
    return float(value(cube(0.5, 0.5, 0.5)))


def _path_between_corners(
    strain: Path | None, stress: Path | None, steps: int
) -> np.ndarray:
    """The given components at the end of each increment, shape (increments, 6)."""
    strains = _corners("strain", strain)
    stresses = _corners("stress", stress)
    twice = sorted(set(strains) & set(stresses))
    if twice:
        raise ValueError(
            f"stress={in_words(stress)}: {twice[0]!r} is given in strain too, leave one out"
        )
    given = strains | stresses
    lengths = {len(values) for values in given.values()} - {1} or {1}
    if len(lengths) > 1:
        raise ValueError(
            f"strain={in_words(strain)}, stress={in_words(stress)}: the same number "
            "of corners for each "
            "component is needed"
        )
    (count,) = lengths
    corners = np.arange(count + 1)
    times = np.arange(1, count * steps + 1) / steps
    columns = []
    for name in COMPONENTS:
        values = np.append(0.0, np.ones(count) * given.get(name, (0.0,)))
        columns.append(np.interp(times, corners, values))
    return np.column_stack(columns)


class _Point:
    """``Law`` at one point; strains and stresses by their six ``COMPONENTS``."""

    kinematics = SOLID
    mesh = None  # nothing is between the points of one

    def __init__(self, material: Material, duration: float | None) -> None:
        mesh = block.structured_mesh(1, 1, 1)
        self._middle = mesh(0.5, 0.5, 0.5)
        self.material = material
        data = ProblemData(mesh, material, kinematics=SOLID, duration=duration)
        self.law = law_of(data, self)
        names = ("plastic_strain", "back_stress")
        zero = np.zeros((1, SOLID.d))
        arrays = dict.fromkeys(names, zero)
        arrays |= dict.fromkeys(("hardening_variable", "accumulated"), zero[:, 0])
        arrays |= self.law.own_memory()
        self.memory = Memory(SimpleNamespace(points=self), arrays, material)

    def __len__(self) -> int:
        return 1

    def at(self, value: object) -> np.ndarray:
        """A number or a coefficient at the point, shape (1,)."""
        return np.array([float(value(self._middle) if callable(value) else value)])

    def stress(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, Return]:
        """The stress at a strain, its derivative, and the return of the law."""
        law = self.law
        bulk = law.bulk[0]
        at = law.returned((e @ _TRACES)[None], (e @ _DEVIATORS)[None])
        moduli = law.moduli(at, law.yielding_part(at))
        D = np.concatenate([moduli(row[None]) for row in np.eye(SOLID.d)])
        tangent = bulk * np.outer(_TRACES, _TRACES) + _DEVIATORS @ D @ _DEVIATORS.T
        mean, deviator = law.stress(at)
        stress = mean[0] * _TRACES + _DEVIATORS @ deviator[0]
        return stress / _ENTRIES, tangent / _ENTRIES[:, None], at

    def solved(
        self, e: np.ndarray, target: np.ndarray, held: np.ndarray
    ) -> np.ndarray | None:
        """The strain with the given strains and stresses; None if there is none."""
        e = np.where(held, target, e)
        free = ~held
        scale = self.law.beta[0] + np.abs(target[free]).max(initial=0.0)

        def missing(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """The stress residual for these free strains, and its derivative."""
            e[free] = part
            stress, tangent, _ = self.stress(e)
            return (stress - target)[free] / scale, tangent[np.ix_(free, free)] / scale

        if not free.any():
            return e
        start = e[free]
        part = by_newton(missing, start)
        if part is None:
            part = scipy.optimize.root(missing, start, jac=True, tol=PRECISE).x
        return e if np.abs(missing(part)[0]).max() <= ACCEPTED else None

    def accept(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Stress, plastic strain and PEEQ at the end of an increment, where the next one starts."""
        law = self.law
        stress, _, at = self.stress(e)
        own = law.own_memory(at)
        self.memory = self.memory.after(
            self.material, at.plastic_strain, own, at.gained
        )
        arrays = self.memory.arrays
        peeq = float(arrays["accumulated"][0])
        alpha_1 = float(arrays["hardening_variable"][0])
        law.carry(arrays, self.at(self.material.yield_bound(alpha_1, peeq)))
        return stress, _DEVIATORS @ law.initial[0] / _ENTRIES, peeq


def by_newton(
    missing: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], x: np.ndarray
) -> np.ndarray | None:
    """The zero of a residual by Newton's method; None where a step does not make it smaller.

    ``missing`` gives the residual and its derivative.
    """
    residual, tangent = missing(x)
    size = np.abs(residual).max()
    for _ in range(NEWTON_STEPS):
        if size <= ROUNDED:
            break
        try:
            following = x - np.linalg.solve(tangent, residual)
        except np.linalg.LinAlgError:
            return None
        residual, tangent = missing(following)
        before = size
        size = np.abs(residual).max()
        if not size < before:
            return x if before <= ACCEPTED else None
        x = following
    return x if size <= ACCEPTED else None


def _corners(name: str, given: Path | None) -> dict[str, tuple[float, ...]]:
    given = {} if given is None else given
    require_instance(name, given, Mapping, "a mapping of component -> values")
    if not given.keys() <= set(COMPONENTS):
        legal = ", ".join(COMPONENTS)
        raise ValueError(
            f"{name}={in_words(given)}: components are needed, each one of {legal}"
        )
    lists = {
        key: values if np.ndim(values) else [values] for key, values in given.items()
    }
    return {
        key: numbers_in(f"{name}[{key!r}]", values) for key, values in lists.items()
    }
