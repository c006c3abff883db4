"""The file of a receipt: its arrays in the order in which ``check_receipt`` reads them.

Numbers of cells, nodes and sides are the last axis, and all of them are floating-point numbers.
The file also says what forces that rounding leaves each cell passes on by each of its sides.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ngepc.goals import check_receipt

LAYERED = "u", "stress", "body_force", "prescribed", "traction", "gap", "pressure"
"""Arrays with a layer for the energy, and one for the adjoint of a goal."""
ROOM = 0.1
"""Part by which forces that rounding leaves are enlarged: it differs on other machines."""
GROWTH = 1e-6
"""Part by which bounds of forces grow on each cell, so that they are larger than their sums."""


def in_file_order(
    layers: list[dict[str, np.ndarray]], header: dict[str, object]
) -> np.ndarray:
    """The words of a receipt; its sizes go into the header.

    ``layers`` have the arrays of the energy, and for a goal those of its adjoint, with the cells
    first, and tensors as matrices.
    """
    first = layers[0]
    N = first["points"].shape[1]
    places = numbered_sides(first["cells"])
    last = {
        name: without_tiny(cells_last(name, values, N))
        for name, values in first.items()
    }
    for name in LAYERED:
        parts = [without_tiny(cells_last(name, layer[name], N)) for layer in layers]
        last[name] = np.stack(parts, axis=2 if name == "stress" else -2)
    K = len(first["cells"])
    last["passed"] = np.zeros((len(layers), N + 1, K))
    header |= {"P": len(first["points"]), "K": K}
    header |= {"S": places.shape[1], "B": len(first["held"])}
    words = packed(last, header)
    r = check_receipt.opened(words, header)
    check_receipt.balance(r)
    way, levels = ways(first["cells"], places, first["held"].all(axis=1))
    for flow, force in zip(r.passed, r.force, strict=True):
        flow[:] = passed(force, way, places, levels)
    return words


def without_tiny(values: np.ndarray) -> np.ndarray:
    """Values with zeros for those that the checker refuses because of underflow."""
    return np.where(np.abs(values) <= check_receipt.SMALLEST, 0, values)


def packed(arrays: dict[str, np.ndarray], header: dict[str, object]) -> np.ndarray:
    """The arrays of a receipt in one row of words of 64 bits."""
    shapes = check_receipt.shapes_of(header)[1]
    return np.concatenate([arrays[name].ravel() for name in shapes], dtype=float)


def cells_last(name: str, values: np.ndarray, N: int) -> np.ndarray:
    """An array with the cells last; tensors as their entries, those of the diagonal first."""
    if name in {"stress", "initial", "back"}:
        n = values.shape[-1]
        pairs = [(i, i) for i in range(n)] + list(combinations(range(N), 2))
        values = np.stack([values[..., i, j] for i, j in pairs], axis=-1)
    if name == "stress":
        return values.transpose(2, 3, 1, 0)
    return np.moveaxis(values, 0, -1)


def numbered_sides(cells: np.ndarray) -> np.ndarray:
    """The two places (side of a cell, cell) of each side, equal on the boundary, (2, sides)."""
    N = cells.shape[1] - 1
    count = int(cells.max()) + 1
    nodes = cells.T[np.array(check_receipt.SIDES[N])].reshape(N + 1, N, -1)
    keys = np.einsum("ijk,j->ik", nodes, count ** np.arange(N)[::-1]).ravel()
    order = keys.argsort(kind="stable")
    _, first, times = np.unique(keys[order], return_index=True, return_counts=True)
    return np.stack([order[first], order[first + times - 1]])


def ways(
    cells: np.ndarray, places: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """The side by which each cell passes on forces to a support, and the cells by their distance.

    Where no side is held in all components all forces go to the first cell, whose way is -1.
    """
    count = len(cells)
    other = np.empty(cells.size, dtype=int)
    other[places[0]] = places[1]
    other[places[1]] = places[0]
    other = other.reshape(-1, count)
    outer = places[0] == places[1]
    place = places[0, outer][held]
    way = np.full(count, -1)
    way[place % count] = place // count
    reached = np.zeros(count, dtype=bool)
    levels = [np.unique(place % count) if len(place) else np.zeros(1, dtype=int)]
    reached[levels[0]] = True
    while len(levels[-1]):
        beyond = other[:, levels[-1]].ravel()
        beyond = beyond[~reached[beyond % count]]
        level, first = np.unique(beyond % count, return_index=True)
        way[level] = beyond[first] // count
        reached[level] = True
        levels.append(level)
    if not reached.all():
        raise ValueError("mesh: a receipt needs a body in one piece")
    return way, levels


def passed(
    force: np.ndarray, way: np.ndarray, places: np.ndarray, levels: list[np.ndarray]
) -> np.ndarray:
    """What each cell passes on by its sides, (sides, cells): its own forces and those it gets."""
    count = len(force)
    beyond = np.empty(places.max() + 1, dtype=int)
    beyond[places[0]] = places[1]
    beyond[places[1]] = places[0]
    found = np.zeros(len(beyond))
    total = np.maximum((1 + ROOM) * force, 2 * check_receipt.SMALLEST)
    for level in levels[::-1]:
        going = level[way[level] >= 0]
        place = way[going] * count + going
        found[place] = (1 + GROWTH) * total[going]
        inside = beyond[place] != place
        np.add.at(total, beyond[place[inside]] % count, found[place[inside]])
    return found.reshape(-1, count)
