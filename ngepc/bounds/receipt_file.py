"""The file of a receipt: its arrays in the order in which ``check_receipt`` reads them.

Numbers of cells, nodes and sides are the last axis.  Each side of the parts has a number, first
those of the boundary.  The file also says by which side each part passes on the forces that
rounding leaves, and bounds of these forces.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from types import SimpleNamespace

import numpy as np

from ngepc.bounds import check_goal, check_receipt

DEEPEST = {2: 3, 3: 2}
"""How often cells of N dimensions are cut at most."""
SPARE = 1e-6
"""Part by which bounds of forces are enlarged on each part, for rounding on other machines."""


def in_file_order(
    arrays: dict[str, np.ndarray], header: dict[str, object], fine: tuple
) -> dict[str, np.ndarray]:
    """The members ``numbers``, ``indices``, ``goal`` and ``cut`` of the file.

    ``header`` gets the sizes of the arrays.  ``arrays`` have the cells first, tensors as matrices,
    and nodes at the edges in ``cells``.  Cells are cut where a goal's interval gains more than
    their share of ``fine``.
    """
    N = arrays["points"].shape[1]
    cells = arrays["cells"][:, : N + 1]
    places = numbered_sides(cells)
    count = len(arrays["points"])
    header["sizes"] = {
        "P": count,
        "K": len(cells),
        "S": places.shape[1],
        "B": len(arrays["boundary"]),
    }
    way, levels = ways(cells, places, arrays["held"].all(axis=1))
    order = np.arange(count)
    if header["order"] == 2:
        cell = places[0] % len(cells)
        edge = arrays["cells"][cell, N + 1 + places[0] // len(cells)]
        order = np.concatenate([order, edge])
    last = {
        name: without_tiny(cells_last(name, values, N))
        for name, values in arrays.items()
    }
    last |= {"cells": cells.T, "sides": places, "way": way}
    for name in ("u", "z"):
        if name in last:
            last[name] = last[name][:, order]
    last["carried"] = np.zeros(len(cells))
    members = {
        "indices": in_one(last, check_receipt.INDICES, np.int64),
        "numbers": in_one(last, check_receipt.NUMBERS, float),
        "cut": np.zeros(0, dtype=bool),
    }
    r = check_receipt.opened(members, header)
    loads = r.stress, r.body_force, r.traction, r.pressure
    force = check_receipt.balance(r, *loads).force
    last["carried"] = carried(force, way, places, levels)
    members["numbers"] = in_one(last, check_receipt.NUMBERS, float)
    if "goal" in header:
        names = "tau", "goal_force", "goal_traction", "goal_pressure"
        force = check_receipt.balance(r, *(last[name] for name in names)).force
        last["tau_carried"] = carried(force, way, places, levels)
        members["goal"] = in_one(last, check_goal.NUMBERS, float)
    return members | {"cut": cuts_of(members, header, fine)}


def cuts_of(
    members: dict[str, np.ndarray], header: dict[str, object], fine: tuple[float, float]
) -> np.ndarray:
    """Which cells are cut, and which of their parts: for energies, and both ends of a goal.

    ``fine`` are the resolutions of these.
    """
    found = []

    def above(
        r: SimpleNamespace, density: Callable, x: np.ndarray, law: np.ndarray
    ) -> np.ndarray:
        """Integrals of a density from above."""
        resolution = fine[1 if density is check_goal.supremum else 0]
        value = law[-1] * density(r.N, x, law)
        kept = []
        for _ in range(DEEPEST[r.N] if len(x) > 1 else 0):
            x, law = check_receipt.parted(r.N, x, law)
            parts = law[-1] * density(r.N, x, law)
            on = parts.reshape(-1, len(value)).sum(axis=0)
            on = (value - on) * len(value) > resolution
            kept.append(value[~on])
            found.append(on)
            on = np.tile(on, len(parts) // len(on))
            x = x[..., on]
            law = law[:, on]
            value = parts[on]
            if not len(value):
                return np.concatenate(kept)
        found.append(np.zeros(len(value), dtype=bool))
        return np.concatenate([*kept, value])

    r = check_goal.opened_goal(members, header)
    check_goal.proved_intervals(r, header, above)
    return np.concatenate(found)


def without_tiny(values: np.ndarray) -> np.ndarray:
    """Values with zeros for those that the checker refuses because of underflow."""
    return np.where(np.abs(values) <= check_receipt.SMALLEST, 0, values)


def in_one(arrays: dict[str, np.ndarray], table: str, kind: type) -> np.ndarray:
    """The arrays of a table, one after the other."""
    names = [row.split()[0] for row in table.split(", ")]
    return np.concatenate([np.ravel(arrays[name]) for name in names], dtype=kind)


def cells_last(name: str, values: np.ndarray, N: int) -> np.ndarray:
    """An array with the cells last; tensors as their entries, those of the diagonal first."""
    if name in {"stress", "tau", "initial", "back"}:
        n = values.shape[-1]
        pairs = [(i, i) for i in range(n)] + list(combinations(range(N), 2))
        values = np.stack([values[..., i, j] for i, j in pairs], axis=-1)
        if values.shape[1] == 1:
            values = values[:, 0]
    return np.moveaxis(values, 0, -1)


def numbered_sides(cells: np.ndarray) -> np.ndarray:
    """The two places (side of a part, part) of each side, equal on the boundary, (2, sides)."""
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
    """The side by which each part passes on forces to a support, and the parts by their distance.

    Where no side is held in all components all forces go to the first part, whose way is -1.
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


def carried(
    force: np.ndarray, way: np.ndarray, places: np.ndarray, levels: list[np.ndarray]
) -> np.ndarray:
    """No less than what each part passes on: its own forces and those that it gets."""
    count = len(force)
    other = np.empty(places.max() + 1, dtype=int)
    other[places[0]] = places[1]
    other[places[1]] = places[0]
    total = np.maximum(force, 2 * check_receipt.SMALLEST)
    for level in levels[::-1]:
        total[level] *= 1 + SPARE
        going = level[way[level] >= 0]
        place = way[going] * count + going
        beyond = other[place]
        inside = beyond != place
        np.add.at(total, beyond[inside] % count, total[going[inside]])
    return total
