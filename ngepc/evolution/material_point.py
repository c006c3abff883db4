"""A material point: the law alone under given strains or stresses, without a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from scipy.optimize import root

from ngepc.checks.arguments import require_integer
from ngepc.checks.kinds import require_instance
from ngepc.discretisation.law import Law, Return
from ngepc.evolution.load_path import numbers_in
from ngepc.evolution.memory import Memory
from ngepc.geometries import block
from ngepc.model.given import Given
from ngepc.model.kinematics import SOLID
from ngepc.model.material import Material
from ngepc.results.outcome import Status

COMPONENTS = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
"""Names of the components of a symmetric tensor."""

Path = Mapping[str, float | Sequence[float]]

EXACT, ACCEPTED = 1e-15, 1e-11
"""Relative change of a strain that ends a search, and the stress that may then be missing."""


@dataclass(frozen=True, eq=False)
class PointHistory:
    """What a material point went through, at the end of each increment.

    Parameters
    ----------
    strain, stress, plastic_strain
        Tensors, shape (increments, 3, 3); of strains the tensor components.
    accumulated_plastic_strain
        PEEQ, shape (increments,).
    corners
        Numbers of the increments that end at a corner of the path.
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
        deviator = self.stress - np.trace(self.stress, axis1=1, axis2=2)[
            :, None, None
        ] / 3 * np.eye(3)
        return np.sqrt(1.5) * np.linalg.norm(deviator, axis=(1, 2))


def material_point(
    material: Material, strain: Path | None = None, stress: Path | None = None, steps: int = 1
) -> PointHistory:
    """Drive a point in three dimensions along straight lines from zero through given corners.

    ``material_point(steel, strain={"xx": [0.02, -0.02]}, steps=50)`` is a bar pulled and pushed.

    Parameters
    ----------
    material
        The law; of coefficients the value at the middle of the unit cube counts.
    strain, stress
        'xx', 'yy', 'zz', 'xy', 'xz' or 'yz' -> values at the corners, or one for all.  Strains are
        tensor components.  What is in neither has no stress.
    steps
        Increments from one corner to the next, implicit Euler steps of first order.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or a component is given twice.
    """
    require_instance("material", material, Material, "a Material")
    steps = require_integer("steps", steps, 1)
    strains, stresses = (_corners(n, p) for n, p in (("strain", strain), ("stress", stress)))
    twice = sorted(set(strains) & set(stresses))
    if twice:
        raise ValueError(f"stress={stress!r}: {twice[0]!r} is in strain too, one is needed")
    lengths = {len(v) for v in (*strains.values(), *stresses.values()) if len(v) > 1} or {1}
    if len(lengths) > 1:
        raise ValueError(f"strain={strain!r}, stress={stress!r}: as many corners each are needed")
    count, held = max(lengths), np.array([name in strains for name in COMPONENTS])
    path = np.zeros((count + 1, 6))
    for i, name in enumerate(COMPONENTS):
        path[1:, i] = (strains | stresses).get(name, (0.0,))
    path *= np.where([i != j for i, j in COMPONENTS.values()], np.sqrt(2.0), 1.0)
    times = np.arange(1, count * steps + 1) / steps
    targets = np.array([np.interp(times, range(count + 1), column) for column in path.T]).T
    point, e, rows = _Point(material), np.zeros(6), []
    for target in targets:
        e = point.solved(e, target, held)
        if e is None:
            break
        rows.append((e, *point.accept(e)))
    tensors = [np.array([np.tensordot(r[k], _BASIS, 1) for r in rows]) for k in range(3)]
    return PointHistory(
        *(tensor.reshape(-1, 3, 3) for tensor in tensors),
        accumulated_plastic_strain=np.array([r[3] for r in rows]),
        corners=np.arange(steps - 1, len(rows), steps),
        status=Status.LIMIT_LOAD if e is None else Status.CONVERGED,
    )


class _Point:
    """``Law`` at one point, in orthonormal coordinates of the symmetric tensors."""

    kinematics = SOLID

    def __init__(self, material: Material) -> None:
        mesh = block.structured_mesh(1, 1, 1)
        self._middle = mesh(0.5, 0.5, 0.5)
        tensor, number = np.zeros((1, SOLID.d)), np.zeros(1)
        self.material = material
        self.memory = Memory(SimpleNamespace(points=self), tensor, tensor, number, number)
        self.law = Law(Given(mesh, material, kinematics=SOLID), self)
        self._deviators = np.array([[(E * B).sum() for B in _BASIS] for E in SOLID.basis])

    def __len__(self) -> int:
        return 1

    def at(self, value: object) -> np.ndarray:
        """A number or a coefficient at the point, shape (1,)."""
        return np.array([float(value(self._middle) if callable(value) else value)])

    def _state(self, e: np.ndarray) -> tuple[Return, np.ndarray]:
        """The law and the stress at a strain."""
        at = self.law.returned((self._deviators @ e)[None])
        stress = self.law.bulk * e[:3].sum() * _TRACE
        return at, stress + self._deviators.T @ self.law.stress(at)[0]

    def solved(self, e: np.ndarray, target: np.ndarray, held: np.ndarray) -> np.ndarray | None:
        """The strain with the given strains and stresses; None if there is none."""
        e, free = np.where(held, target, e), ~held
        scale = self.law.beta[0] + np.abs(target[free]).max(initial=0.0)

        def missing(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """What the stresses miss with these free strains, and its derivative."""
            e[free] = part
            at, stress = self._state(e)
            return (stress - target)[free] / scale, self._tangent(at)[np.ix_(free, free)] / scale

        if free.any():
            found = root(missing, e[free], jac=True, tol=EXACT)
            if not np.abs(missing(found.x)[0]).max() <= ACCEPTED:
                return None
        return e

    def _tangent(self, at: Return) -> np.ndarray:
        moduli = self.law.moduli(at, self.law.yielding_part(at))
        D = np.array([moduli(row[None])[0] for row in np.eye(5)])
        return self.law.bulk * np.outer(_TRACE, _TRACE) + self._deviators.T @ D @ self._deviators

    def accept(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Stress, plastic strain and PEEQ at the end of an increment, where the next one starts."""
        law, (at, stress) = self.law, self._state(e)
        now = self.memory = self.memory.after(self.material, at.plastic_strain)
        law.initial, law.back, law.accumulated = (
            now.plastic_strain,
            now.back_stress,
            now.accumulated,
        )
        alpha_1, peeq = float(now.hardening_variable[0]), float(now.accumulated[0])
        law.beta = self.at(self.material.yield_bound(alpha_1, peeq))
        return stress, self._deviators.T @ now.plastic_strain[0], peeq


def _corners(name: str, given: Path | None) -> dict[str, tuple[float, ...]]:
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"{name}={given!r}: a mapping of component -> values is needed")
    found = {}
    for component, values in (given or {}).items():
        if component not in COMPONENTS:
            legal = ", ".join(COMPONENTS)
            raise ValueError(f"{name}={given!r}: components are needed, each one of {legal}")
        argument = f"{name}[{component!r}]"
        found[component] = numbers_in(argument, values if np.ndim(values) else [values])
    return found


_TRACE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
_BASIS = np.zeros((6, 3, 3))
for _k, (_i, _j) in enumerate(COMPONENTS.values()):
    _BASIS[_k, _i, _j] = _BASIS[_k, _j, _i] = 1.0 if _i == _j else 1 / np.sqrt(2.0)
