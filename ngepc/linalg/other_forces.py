"""The search for other forces that meet a law of friction, since there may be several."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ngepc.linalg.friction import FrictionCone, stuck_change
from ngepc.linalg.secants import Compliance

DIFFERENT = 1e-6  # fraction of the largest force by which two solutions differ

FACTORS = (0.5, 0.8, 1.25, 2.0)
"""Coefficients and loads of neighbouring problems, relative, where searches start."""

SHIFTS = (1.0, 0.1, -0.1, -1.0)
"""Gaps and slips of neighbouring problems, relative to the largest one."""

SOFT_ENOUGH = 10.0
SOFTER = 1e5
"""Factors by which springs of floating parts are softer than in Newton's steps: in a search, where
small problems of a pressed block are not solved with softer ones; and where states are tried."""

RELEASES = 3
"""How often springs of a floating part are released, each time to about 1e-4 of their force."""

STARTS = 5 + 2 * len(FACTORS) + 2 * len(SHIFTS)
"""How many there are."""


def other_forces(
    law: FrictionCone,
    S: np.ndarray,
    gaps: np.ndarray,
    forces: np.ndarray,
    sizes: np.ndarray | None = None,
    rigid: np.ndarray | None = None,
    *,
    least: float = 0.0,
) -> np.ndarray | None:
    """Other forces that meet the law with the compliance S, None if none is found.

    All states are tried where the law is ``enumerable``, else ``starts``.  ``sizes`` are the
    compliances that differences are judged by, by default the diagonal of S.  ``rigid`` C
    (n, k) are motions of floating parts, which springs with the compliance C C' hold; here
    they are made softer.  Forces that move no row by more than ``least`` are the same.
    """
    sizes = S.diagonal() if sizes is None else sizes
    rigid = np.zeros((len(forces), 0)) if rigid is None else rigid
    rigid = rigid * (SOFTER if law.enumerable else SOFT_ENOUGH) ** 0.5
    held = S + rigid @ rigid.T
    if law.enumerable:
        found = law.equilibria(held, gaps, forces, sizes)
    else:
        found = from_starts(law, held, gaps, forces, rigid)
    for other in found:
        apart = other - forces
        moved = S @ apart  # springs alone answer forces that depend on each other
        different = apart @ moved > DIFFERENT**2 * (sizes @ forces**2)
        if different and np.abs(moved).max() > least:
            return other  # forces on held tangents do no work: they are no other equilibrium
    return None


def from_starts(
    law: FrictionCone,
    S: np.ndarray,
    gaps: np.ndarray,
    forces: np.ndarray,
    rigid: np.ndarray,
) -> Iterator[np.ndarray]:
    """Solutions from each of the starts that has one.

    Springs that hold a floating part are no part of the body: their force is removed again, in
    several passes.
    """
    W = Compliance.of(S)
    passes = RELEASES if rigid.size else 1
    for start in starts(law, W, gaps, forces):
        x = start
        there = gaps + S @ (start - forces)
        carried = rigid.T @ (start - forces)
        for _ in range(passes):
            change, exact = law(W, there, x)
            if not exact:
                break
            x = x + change
            carried = carried + rigid.T @ change
            there = there + S @ change + rigid @ carried
        if exact:
            yield x


def starts(
    law: FrictionCone, W: Compliance, gaps: np.ndarray, forces: np.ndarray
) -> Iterator[np.ndarray]:
    """Where other solutions are searched from, ``STARTS`` of them.

    No contact, all rows sticking, all slips reversed, all friction at its bound; solutions with
    other coefficients; solutions with other loads: more or less of it, rows that are pressed
    or lifted, dragged one way or the other.
    """
    n, t = law.split(forces)
    stuck = forces + stuck_change(W, gaps)
    bounds = np.tile(law.bound(stuck[: len(n)])[:, None], law.d)
    pressing = np.maximum(n, stuck[: len(n)])
    yield np.zeros_like(forces)
    yield law.projected(stuck)
    for tangents in (-t, bounds, -bounds):
        yield law.projected(np.append(pressing, tangents))
    for factor in FACTORS:
        other = replace(law, coefficient=factor * law.coefficient)
        yield law.projected(forces + other(W, gaps, forces)[0])
    unloaded = gaps - W @ forces
    size = np.abs(unloaded).max(initial=0.0)
    normal = np.arange(len(gaps)) < len(n)
    moved = [(factor - 1) * unloaded for factor in FACTORS]
    moved += [shift * size * normal for shift in SHIFTS]
    moved += [shift * size * ~normal for shift in SHIFTS]
    for change in moved:
        yield law.projected(forces + law(W, gaps + change, forces)[0])
