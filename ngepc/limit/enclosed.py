"""Arrays of numbers that are known up to a radius: rounding errors, enclosed.

Each operation adds to the radius what rounding to nearest can do.  The radii are rounded as well,
and therefore made larger by a factor that a chain of these operations does not use up.
"""

from __future__ import annotations

import numpy as np

UNIT = 2.0**-53
"""Relative error of one rounded operation."""

LARGER = 1 + 1e-12
"""Factor of radii, for the rounding errors of the radii themselves."""


class Enclosed:
    """Numbers that lie within ``radius`` of ``middle``.

    Parameters
    ----------
    middle
        The rounded numbers.
    radius
        Bound of their errors, of the same shape; zero for numbers that are exact.
    """

    def __init__(self, middle: np.ndarray, radius: np.ndarray | float = 0.0) -> None:
        self.middle = np.asarray(middle, dtype=float)
        self.radius = np.broadcast_to(radius, self.middle.shape)

    @property
    def size(self) -> np.ndarray:
        """No less than the absolute values."""
        return (np.abs(self.middle) + self.radius) * LARGER

    @property
    def least(self) -> np.ndarray:
        """No more than the absolute values."""
        return np.maximum(np.abs(self.middle) - self.radius * LARGER, 0.0) / LARGER

    def length(self) -> np.ndarray:
        """No less than the lengths of the vectors along the last axis."""
        return np.linalg.norm(self.size, axis=-1) * LARGER

    def __getitem__(self, places: object) -> Enclosed:
        return Enclosed(self.middle[places], self.radius[places])

    def __neg__(self) -> Enclosed:
        return Enclosed(-self.middle, self.radius)

    def __add__(self, other: Enclosed | np.ndarray | float) -> Enclosed:
        other = enclosed(other)
        middle = self.middle + other.middle
        radius = self.radius + other.radius + UNIT * np.abs(middle)
        return Enclosed(middle, radius * LARGER)

    def __sub__(self, other: Enclosed | np.ndarray | float) -> Enclosed:
        return self + (-enclosed(other))

    def __mul__(self, other: Enclosed | np.ndarray | float) -> Enclosed:
        other = enclosed(other)
        middle = self.middle * other.middle
        of_other = np.abs(self.middle) * other.radius
        of_self = self.radius * (np.abs(other.middle) + other.radius)
        radius = of_other + of_self + UNIT * np.abs(middle)
        return Enclosed(middle, radius * LARGER)

    def __truediv__(self, other: Enclosed | np.ndarray | float) -> Enclosed:
        other = enclosed(other)
        middle = self.middle / other.middle
        error = self.radius + np.abs(middle) * other.radius
        radius = error / other.least + UNIT * np.abs(middle)
        return Enclosed(middle, radius * LARGER)

    def root(self) -> Enclosed:
        """Square roots of numbers that are positive."""
        middle = np.sqrt(self.middle)
        radius = self.radius / np.sqrt(self.least) + UNIT * middle
        return Enclosed(middle, radius * LARGER)

    def sum(self, axis: int) -> Enclosed:
        """Sums along an axis."""
        count = self.middle.shape[axis]
        terms = np.abs(self.middle).sum(axis=axis)
        radius = self.radius.sum(axis=axis) + count * UNIT * terms
        return Enclosed(self.middle.sum(axis=axis), radius * LARGER)

    def reshape(self, *shape: int) -> Enclosed:
        """The same numbers in another shape."""
        return Enclosed(self.middle.reshape(*shape), self.radius.reshape(*shape))

    def where(self, chosen: np.ndarray, other: Enclosed) -> Enclosed:
        """These numbers where ``chosen``, and others elsewhere."""
        middle = np.where(chosen, self.middle, other.middle)
        return Enclosed(middle, np.where(chosen, self.radius, other.radius))


def enclosed(value: Enclosed | np.ndarray | float) -> Enclosed:
    """The value, as exact numbers if it has no radius."""
    return value if isinstance(value, Enclosed) else Enclosed(value)


def joined_enclosures(parts: list[Enclosed]) -> Enclosed:
    """Arrays of the same shape as one, along a second axis."""
    middle = np.stack([part.middle for part in parts], axis=1)
    radius = np.stack([part.radius for part in parts], axis=1)
    return Enclosed(middle, radius)


def cross(a: Enclosed, b: Enclosed) -> Enclosed:
    """Vector products along the last axis, (..., 1) in the plane and (..., 3) in space."""
    if a.middle.shape[-1] == 2:
        return (a[..., :1] * b[..., 1:]) - (a[..., 1:] * b[..., :1])
    forward = [1, 2, 0]
    backward = [2, 0, 1]
    first = a[..., forward] * b[..., backward]
    second = a[..., backward] * b[..., forward]
    return first - second
