"""The file of a receipt: its arrays in the order in which ``check_receipt`` reads them.

Numbers of cells, nodes and sides are the last axis.  Each side of the cells has a number.  The file
also says by which side each cell passes on the forces that rounding leaves, and bounds of these
forces.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from types import SimpleNamespace

import numpy as np

from ngepc.bounds import check_goal, check_receipt

DEEPEST = {2: 3, 3: 2}
"""How often parts of cells of N dimensions are cut at most."""
ROOM = 0.1
"""Part by which forces that rounding leaves are enlarged: it differs on other machines."""
GROWTH = 1e-6
"""Part by which bounds of forces grow on each cell, so that they are larger than their sums."""


def in_file_order(
    arrays: dict[str, np.ndarray], header: dict[str, object], fine: float
) -> dict[str, np.ndarray]:
    """The members ``receipt``, and ``goal`` and ``cut`` for a goal.

    ``arrays`` have the cells first, and tensors as matrices.  Parts are cut where a goal's
    interval gains more than their share of ``fine``.
    """
    N = arrays["points"].shape[1]
    cells = arrays["cells"]
    places = arrays["sides"]
    way, levels = ways(cells, places, arrays["held"].all(axis=1))
    last = {
        name: without_tiny(cells_last(name, values, N))
        for name, values in arrays.items()
    }
    last |= {"sides": places, "way": way}
    last["passed"] = np.zeros(places.shape[1])
    receipt = packed_record(last, check_receipt.TABLE)
    r = check_receipt.opened({"receipt": receipt}, header)
    loads = r.stress, r.body_force, r.traction, r.pressure
    force = check_receipt.balance(r, *loads).force
    receipt["passed"] = passed(force, way, places, levels)
    members = {"receipt": receipt}
    if "goal" in header:
        last["tau_passed"] = np.zeros(places.shape[1])
        goal = packed_record(last, check_goal.TABLE)
        names = "tau", "goal_force", "goal_traction", "goal_pressure"
        force = check_receipt.balance(r, *(goal[name] for name in names)).force
        goal["tau_passed"] = passed(force, way, places, levels)
        members["goal"] = goal
        members["cut"] = np.zeros(0, dtype=bool)
        members["cut"] = cuts_of(members, header, fine)
    return members


def cuts_of(
    members: dict[str, np.ndarray], header: dict[str, object], fine: float
) -> np.ndarray:
    """Which parts of cells are cut, and which of their parts, for both ends of a goal."""
    found = []

    def above(
        r: SimpleNamespace, density: Callable, x: np.ndarray, law: np.ndarray
    ) -> np.ndarray:
        """Integrals of a density from above."""
        value = law[-1] * density(r.N, x, law)
        kept = []
        for _ in range(DEEPEST[r.N]):
            x = check_receipt.subdivided(r.N, x)
            law = check_goal.parted(r.N, law)
            parts = law[-1] * density(r.N, x, law)
            on = parts.reshape(-1, len(value)).sum(axis=0)
            on = (value - on) * len(value) > fine
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


def packed_record(arrays: dict[str, np.ndarray], table: str) -> np.ndarray:
    """The arrays of a table in one record."""
    rows = [row.split() for row in table.split(", ")]
    kinds = [(name, kind, np.shape(arrays[name])) for name, kind, _ in rows]
    record = np.zeros((), kinds)
    for name in record.dtype.names:
        record[name] = arrays[name]
    return record


def cells_last(name: str, values: np.ndarray, N: int) -> np.ndarray:
    """An array with the cells last; tensors as their entries, those of the diagonal first."""
    if name == "sides":
        return values
    if name in {"stress", "tau", "initial", "back"}:
        n = values.shape[-1]
        pairs = [(i, i) for i in range(n)] + list(combinations(range(N), 2))
        values = np.stack([values[..., i, j] for i, j in pairs], axis=-1)
    if name in {"stress", "tau"}:
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
    """No less than what passes each side: of each cell its own forces and those that it gets."""
    count = len(force)
    side = np.empty(places.max() + 1, dtype=int)
    side[places[0]] = np.arange(places.shape[1])
    side[places[1]] = np.arange(places.shape[1])
    beyond = places.sum(axis=0)
    found = np.zeros(places.shape[1])
    total = np.maximum((1 + ROOM) * force, 2 * check_receipt.SMALLEST)
    for level in levels[::-1]:
        going = level[way[level] >= 0]
        place = way[going] * count + going
        exits = side[place]
        found[exits] = (1 + GROWTH) * total[going]
        other = beyond[exits] - place
        inside = other != place
        np.add.at(total, other[inside] % count, found[exits[inside]])
    return found
