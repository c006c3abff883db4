"""The file of a receipt: its arrays in the order in which ``check_receipt`` reads them.

Numbers of cells, nodes and sides are the last axis, and all of them are floating-point numbers.
The file also says by which side each cell passes on the forces that rounding leaves, how large they
are, and where the suprema of a goal have their tangents.
"""

from __future__ import annotations

import numpy as np
from ngsolve import ET, IntegrationRule

from ngepc.bounds.polynomials import quadratics
from ngepc.goals import check_receipt
from ngepc.goals.receipt_mesh import FileCells

LAYERED = "u", "stress", "body_force", "traction", "gap", "pressure"
"""Arrays with a layer for the energy, and one for the adjoint of a goal."""
NAMES = (
    "points", "cells", "other", "u", "stress", "law", "body_force", "passed", "arm",
    "tangent", "held", "traction", "gap", "pressure",
)  # fmt: skip
"""The arrays in their order."""
ROOM = 0.1
"""Part by which forces that rounding leaves are enlarged: it differs on other machines."""
GROWTH = 1e-6
"""Part by which bounds of forces grow on each cell, so that they are larger than their sums."""
DEGREE = 8
"""Degree of the rule that says how much bounds of energies lose."""
SMALLEST = 1e-30
"""Force that every cell passes on at least."""
FEW = 2
"""Degree of the rule that says how much bounds of suprema lose."""
SMALL = 1e-3
"""Cells that contribute no more than this part of what they may lose in the mean are left."""
TANGENTS = 0.0, 0.25, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0
"""Numbers r that are tried, as parts of that where the mean of the slope vanishes."""


def in_file_order(
    cells: FileCells, layers: list[dict[str, np.ndarray]], header: dict[str, object]
) -> np.ndarray:
    """The words of a receipt without hints; its sizes go into the header.

    ``layers`` have the arrays of the energy, and for a goal those of its adjoint, with the cells,
    nodes or sides first.
    """
    last = {name: cells_last(name, values) for name, values in layers[0].items()}
    for name in LAYERED:
        rows = [cells_last(name, layer[name]) for layer in layers]
        last[name] = np.stack(rows)
    L = len(layers)
    K = len(cells.cells)
    last |= {"points": cells.points.T, "cells": cells.cells.T, "other": cells.other}
    last["passed"] = np.zeros((cells.N, cells.N + 1, K))
    last["arm"] = np.zeros((cells.N, K))
    last["tangent"] = np.zeros((2 * L - 2, K))
    header["sizes"] = [len(cells.points), K, len(cells.out)]
    return packed(last)


def with_hints(words: np.ndarray, header: dict[str, object]) -> np.ndarray:
    """The words of a receipt with the forces that pass sides, and tangents of suprema."""
    arrays = check_receipt.arrays_in(words, header)
    r = check_receipt.Body(words, header)
    for component, held in enumerate(r.holds):
        passed, arm = ways_out(r, r.force[component], r.out[held])
        arrays["passed"][component] = passed
        arrays["arm"][component] = arm
    for row, sign in enumerate((-1, 1)[: len(arrays["tangent"])]):
        y, v, H = arguments_of_supremum(r, sign)
        arrays["tangent"][row], _ = least_supremum(y, v, H, r.beta)
    return words


def proved_intervals(words: np.ndarray, header: dict[str, object]) -> dict[str, float]:
    """What the words of a receipt prove, by the names of the claims in its header."""
    return check_receipt.Body(words, header).intervals(header.get("factor", 1.0))


def lossy(r: check_receipt.Body, allowed: float) -> np.ndarray:
    """Cells whose bounds of plastic energies lose most; the others lose less than ``allowed``."""
    trial = trial_stress(r)[0]
    missing = r.stress[0] - trial
    back = back_stress(r)
    s = trial[:, 1:] - back
    x = r.stress[0, :, 1:] - back
    exact = check_receipt.inner(missing, missing / r.moduli)
    exact -= mean_squared_excess(s, r.beta) / (2 * r.mu + r.hardening)
    exact += mean_squared_excess(x, r.beta) / r.hardening
    _, gap = r.densities(slice(None))[:2]
    return most_of_sum(r.volume * np.abs(gap - exact / 2), allowed)


def lossy_in_goal(r: check_receipt.Body, allowed: float) -> np.ndarray:
    """Cells whose bounds of suprema lose most; the others lose less than ``allowed``.

    What a bound loses is what its mean exceeds that of bounds at single points by.
    """
    loss = np.zeros(r.K)
    for sign in (-1, 1):
        y, v, H = arguments_of_supremum(r, sign)
        _, bound = least_supremum(y, v, H, r.beta)
        energy = r.volume * bound / (2 * r.mu)
        cells = np.flatnonzero(np.abs(energy) > SMALL * allowed / r.K)
        if not len(cells):
            continue
        y_at, weights = at_rule_points(y[..., cells], FEW)
        v_at, _ = at_rule_points(v[..., cells], FEW)
        law = np.repeat([H[cells], r.beta[cells]], len(weights), axis=0)
        H_at, beta_at = law.reshape(2, -1)
        _, sharp = least_supremum(in_a_row(y_at), in_a_row(v_at), H_at, beta_at)
        mean = weights @ sharp.reshape(len(weights), -1)
        loss[cells] += energy[cells] - (r.volume / (2 * r.mu))[cells] * mean
    return most_of_sum(loss, allowed)


def most_of_sum(loss: np.ndarray, allowed: float) -> np.ndarray:
    """Which numbers are the largest ones, so that all others add up to less than ``allowed``."""
    order = loss.argsort()
    found = np.zeros(len(loss), dtype=bool)
    found[order] = np.cumsum(loss[order]) > allowed
    return found


def in_a_row(at: np.ndarray) -> np.ndarray:
    """Values (q, c, K) at points as those of q K cells on which they are constant, (1, c, q K)."""
    return at.swapaxes(0, 1).reshape(1, at.shape[1], -1)


def back_stress(r: check_receipt.Body) -> np.ndarray:
    """The back stress, in coordinates of deviators, (c - 1, K)."""
    return r.law[5 + len(r.moduli) :]


def trial_stress(r: check_receipt.Body) -> np.ndarray:
    """The trial stresses (L, k, c, K) with the coefficients of stresses."""
    if r.degree == 1:
        return r.trial
    return r.trial[:, check_receipt.PAIRS[r.N + 1]].mean(axis=1)


def mean_squared_excess(field: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Means of ([|s| - beta]_+)^2 by a rule."""
    at, weights = at_rule_points(field, DEGREE)
    size = np.sqrt(np.einsum("qcK,qcK->qK", at, at))
    return weights @ np.maximum(size - beta, 0.0) ** 2


def at_rule_points(field: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Values (q, c, K) of a field at the points of a rule, and the weights of these (q,)."""
    k = len(field)
    if k == 1:
        return field, np.ones(1)
    solid = k in (4, 10)
    rule = IntegrationRule(ET.TET if solid else ET.TRIG, degree)
    weights = np.array(rule.weights) / sum(rule.weights)
    inside = np.array(rule.points)[:, : 3 if solid else 2]
    table = np.column_stack([inside, 1 - inside.sum(axis=1)])
    if k > table.shape[1]:
        table = quadratics(table)
    return np.einsum("qk,kcK->qcK", table, field), weights


def packed(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """The arrays of a receipt in one row of words of 64 bits."""
    return np.concatenate([arrays[name].ravel() for name in NAMES], dtype=float)


def cells_last(name: str, values: np.ndarray) -> np.ndarray:
    """An array with the cells last; of stresses (parts, k, c) the coefficients come first."""
    if name == "stress":
        return values.transpose(1, 2, 0)
    if name == "traction":
        return values.transpose(2, 1, 0)
    return np.moveaxis(values, 0, -1)


def basis(kinematics: str) -> np.ndarray:
    """The matrices (c, n, n) of the coordinates of tensors in the checker."""
    n = 2 if kinematics == "two-dimensional" else 3
    return check_receipt.BASIS[check_receipt.LAWS[kinematics], :n, :n]


def basis_coordinates(tensors: np.ndarray, kinematics: str) -> np.ndarray:
    """Coordinates (..., c) of symmetric tensors (..., n, n) in the basis of the checker."""
    return np.einsum("cij,...ij->...c", basis(kinematics), tensors)


def ways_out(
    r: check_receipt.Body, force: np.ndarray, place: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What cells pass on by their sides (N + 1, cells), and the arms of it (cells,).

    Each cell passes its own ``force`` and what it gets, in equal parts, to its neighbours that are
    nearer to the supports; forces end at the places ``place`` of the boundary.
    """
    other = r.other.reshape(-1, r.K)
    beyond = other % r.K
    steps = steps_to(other, place)
    out = steps[beyond] < steps
    out.ravel()[place] = True
    share = out / out.sum(axis=0)
    own = np.maximum((1 + ROOM) * force, SMALLEST)
    total = own.copy()
    moment = np.zeros(r.K)
    order = steps.argsort(kind="stable")
    first = np.searchsorted(steps[order], np.arange(steps.max() + 2))
    for level in range(len(first) - 2, -1, -1):
        cells = order[first[level] : first[level + 1]]
        total[cells] *= 1 + GROWTH
        moment[cells] += r.length[cells] * (own[cells] + total[cells])
        moment[cells] *= 1 + GROWTH
        side, chosen = np.nonzero(out[:, cells] & (steps[beyond[:, cells]] < level))
        chosen = cells[chosen]
        after = beyond[side, chosen]
        np.add.at(total, after, share[side, chosen] * total[chosen])
        np.add.at(moment, after, share[side, chosen] * moment[chosen])
    return share * total, moment / total


def steps_to(other: np.ndarray, place: np.ndarray) -> np.ndarray:
    """How many sides lie between each cell and those with the places ``place``, (cells,).

    ValueError if there is no way from a cell to them.
    """
    K = other.shape[1]
    steps = np.full(K, -1)
    level = np.unique(place % K)
    count = 0
    while len(level):
        steps[level] = count
        beyond = np.unique(other[:, level] % K)
        level = beyond[steps[beyond] < 0]
        count += 1
    if (steps < 0).any():
        raise ValueError(
            "problem: a receipt needs a body in one piece, and supports that hold each component "
            "of the displacement on a side that is not parallel to it, or all of them"
        )
    return steps


def arguments_of_supremum(
    r: check_receipt.Body, sign: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """y and v (k, c, K) and H (K,) of the suprema at one end of a goal."""
    H = r.hardening / (2 * r.mu)
    back = back_stress(r)
    x = r.stress[0, :, 1:] - back
    p = x + sign * r.stress[1, :, 1:]
    trial = trial_stress(r)[:, :, 1:]
    y = p + trial[0] - back - sign * trial[1]
    return y, p + H * y, H


def least_supremum(
    y: np.ndarray, v: np.ndarray, H: np.ndarray, beta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The numbers r of ``TANGENTS`` with the least bounds of suprema, and these, (2, K)."""
    length = np.sqrt(np.einsum("kcK,kcK->kK", v, v))
    more = length.mean(axis=0) - beta * (1 + 2 * H)
    guess = np.maximum(more, 0.0) / (2 * H * (1 + H))
    best = np.full(len(beta), np.inf)
    found = np.zeros(len(beta))
    for part in TANGENTS:
        tangent = part * guess
        value = check_receipt.supremum(y, v, tangent, H, beta)
        found = np.where(value < best, tangent, found)
        best = np.minimum(value, best)
    return found, best
