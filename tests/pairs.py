"""Parameters in turn: every value of every axis, without the product of all axes."""

from collections.abc import Iterable


def in_turn(*axes: Iterable) -> list[tuple]:
    """As many tuples as the longest axis has values, every value of every axis at least once.

    Shorter axes start again at their ends, each later axis with a shift, so that two axes of one
    length do not go in step.
    """
    values = [list(axis) for axis in axes]
    most = max(map(len, values))
    return [
        tuple(
            axis[(k + j * (k // len(axis))) % len(axis)]
            for j, axis in enumerate(values)
        )
        for k in range(most)
    ]


def every_pair(first: Iterable, second: Iterable, third: Iterable) -> list[tuple]:
    """The product of two axes, and a third one no longer than they are: all pairs of values."""
    a, b, c = list(first), list(second), list(third)
    return [
        (a[i], b[j], c[(i + j) % len(c)]) for i in range(len(a)) for j in range(len(b))
    ]
