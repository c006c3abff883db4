"""Polynomials on cells, on the parts of cells and on pieces of these: tables, and short sums.

The keys of tables are numbers of coefficients: those of ``bounds.polynomials`` on a part, and on a
cell those of its parts, one after the other.
"""

from __future__ import annotations

from functools import reduce

import numpy as np

from ngepc.bounds.polynomials import NODES, coefficients
from ngepc.bounds.polynomials import RULE as ON_PARTS
from ngepc.bounds.polynomials import SPLIT as OF_PARTS
from ngepc.bounds.polynomials import WEIGHTS as OF_RULE

RULE = dict(ON_PARTS)
"""Values at the points of a rule that is exact for products, from coefficients."""
WEIGHTS = dict(OF_RULE)
SPLIT = dict(OF_PARTS)
"""Coefficients on children of equal size: parts of a cell, four or eight children of a part."""
for _all, _k in NODES.items():
    _parts = _all // _k
    RULE[_all] = np.kron(np.eye(_parts), ON_PARTS[_k])
    WEIGHTS[_all] = np.tile(OF_RULE[_k], _parts) / _parts
    SPLIT[_all] = np.eye(_all).reshape(_parts, _k, _all)
RULE[1] = np.ones((1, 1))
WEIGHTS[1] = np.ones(1)
MEANS = {k: table.T @ (WEIGHTS[k][:, None] * table) for k, table in RULE.items()}
"""Means of the products of two functions whose coefficients are one and otherwise zero."""


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of vectors, (..., d) and (..., d) to (...)."""
    return np.einsum("...d,...d->...", a, b)


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The same with the pieces last, (..., d, n) and (..., d, n) to (..., n)."""
    return np.einsum("...dn,...dn->...n", a, b)


def pieces_last(values: np.ndarray) -> np.ndarray:
    """Coefficients (n, k, d) in the order (k, d, n), also in memory."""
    return np.ascontiguousarray(values.transpose(1, 2, 0))


def mean_of(a: np.ndarray) -> np.ndarray:
    """Means over the few rows of an array (k, ...), faster than those of numpy."""
    return reduce(np.add, a) / len(a)


def largest_of(a: np.ndarray) -> np.ndarray:
    """The largest of the few rows of an array (k, ...)."""
    return reduce(np.maximum, a)


def smallest_of(a: np.ndarray) -> np.ndarray:
    """The smallest of the few rows of an array (k, ...)."""
    return reduce(np.minimum, a)


def mean_squares(a: np.ndarray) -> np.ndarray:
    """Means of |a|^2 over pieces for coefficients (k, n) or (k, d, n), (n,)."""
    flat = a.reshape(len(a), -1)
    each = np.einsum("km,km->m", MEANS[len(a)] @ flat, flat)
    return each.reshape(-1, a.shape[-1]).sum(axis=0)


def mean_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Means over pieces of products of vectors with coefficients (n, k or 1, d), (n,)."""
    if min(a.shape[1], b.shape[1]) == 1:
        return np.einsum("nd,nd->n", a.mean(axis=1), b.mean(axis=1))
    a = pieces_last(a)
    b = pieces_last(b)
    flat = MEANS[len(a)] @ a.reshape(len(a), -1)
    return np.einsum("kdn,kdn->n", flat.reshape(a.shape), b)


def applied(table: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums (n, m, d) of the rows of values (n, k, d) with the factors of a table (m, k)."""
    last = pieces_last(values)
    found = table @ last.reshape(len(last), -1)
    return found.reshape(-1, *last.shape[1:]).transpose(2, 0, 1)


def at_rule(values: np.ndarray) -> np.ndarray:
    """Values (n, points, d) at the points of the rule from coefficients (n, k, d)."""
    return applied(RULE[values.shape[1]], values)


def child_coefficients(values: np.ndarray) -> np.ndarray:
    """Coefficients on the first children of pieces (n, k, d), then on the second ones, ..."""
    k, d = values.shape[1:]
    table = SPLIT[k]
    found = applied(table.reshape(-1, k), values).transpose(1, 2, 0)
    each = found.reshape(*table.shape[:2], d, -1).transpose(1, 2, 0, 3)
    return each.reshape(table.shape[1], d, -1).transpose(2, 0, 1)


def cell_coefficients(nodal: np.ndarray) -> np.ndarray:
    """Coefficients on cells from values at the nodes of their parts, (cells, k, c)."""
    k = nodal.shape[1]
    part = coefficients(np.eye(NODES[k]))
    return nodal if NODES[k] < 6 else applied(np.kron(np.eye(k // 6), part), nodal)
