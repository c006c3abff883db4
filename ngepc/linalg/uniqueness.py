"""A condition under which contact with Coulomb's law has one solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

PROBES, DOUBT, EXHAUSTED = 40, 1e-6, 1e-8
"""Lanczos steps at most, the chance that they miss a second solution, and what counts as zero."""

Product = Callable[[np.ndarray], np.ndarray]


def is_unique(follows: np.ndarray, compliance: Product, stiffness: Product) -> bool:
    """Whether no change d of the forces has d.E'Sd >= d.Sd, with E'g = (mu e.g_t, 0).

    Two solutions differ by a d with d.Sd <= d.E'Sd, e at one of them: their normal parts have
    d_n.(Sd)_n <= 0, and friction as ``FrictionCone.follows`` says (Renard, SIAM J. Math. Anal. 38,
    2006, for the continuous problem).  The largest quotient is that of Lanczos' method in the
    product S, from a random start, with as many steps as leave a chance of ``DOUBT`` that it is 1
    or more (Kuczynski and Wozniakowski, SIAM J. Matrix Anal. Appl. 13, 1992, for a direction of
    uniform probability).  ``follows`` is mu e (m, d), ``compliance`` and ``stiffness`` are d -> S d
    and its inverse, both for (n, t).
    """

    def pulled(g: np.ndarray) -> np.ndarray:
        """E'g."""
        along = (follows * g[m:].reshape(follows.shape)).sum(axis=1)
        return np.concatenate([along, np.zeros(follows.size)])

    def pushed(d: np.ndarray) -> np.ndarray:
        """E d."""
        return np.concatenate([np.zeros(m), (follows * d[:m, None]).ravel()])

    m, known, T = len(follows), [], np.zeros((PROBES + 1, PROBES + 1))
    g = np.random.default_rng(0).standard_normal(m + follows.size)
    d = stiffness(g)
    for k in range(PROBES):
        size = float(np.sqrt(max(d @ g, 0.0)))
        if k:
            values = np.linalg.eigvalsh(T[:k, :k])
            spread = (1 - values[-1]) / (1 - values[0])
            if not (spread > 0 and np.isfinite(size)):
                return False
            chance = 1.648 * np.sqrt(len(g)) * np.exp(-(2 * k - 1) * np.sqrt(spread))
            if chance <= DOUBT or size <= EXHAUSTED:
                return True
            T[k, k - 1] = T[k - 1, k] = size
        v, Sv = d / size, g / size
        known.append((v, Sv))
        back, slanted = pulled(Sv), pushed(v)
        d, g = (slanted + stiffness(back)) / 2, (compliance(slanted) + back) / 2
        T[k, k] = d @ Sv
        for v, Sv in known * 2:
            share = d @ Sv
            d, g = d - share * v, g - share * Sv
    return False
