"""Morton's curve: an order of points in which neighbours mostly stand near each other."""

from __future__ import annotations

import numpy as np

BITS = 20
"""Binary digits of each coordinate: points closer than 2^-20 of the extent count as one place."""


def along_curve(points: np.ndarray) -> np.ndarray:
    """The numbers of points (n, N) in the order of Morton's curve.

    The place on the curve has the binary digits of the coordinates in turn.
    """
    low = points.min(axis=0)
    extent = np.ptp(points, axis=0).max() or 1.0
    steps = ((2**BITS - 1) / extent * (points - low)).astype(np.int32)
    places = np.zeros(len(points), dtype=np.int64)
    for digit in reversed(range(BITS)):
        for coordinate in steps.T:
            places = 2 * places + (coordinate >> digit & 1)
    return np.argsort(places, kind="stable")
