"""Lower bounds of the integrals of G over quadrilaterals and hexahedra, see ``upper_energy``.

e and J are given on parts of elements by Bernstein coefficients of the same degree.  Parts are cut
into halves along all coordinates until a quadrature rule exceeds the bounds by little.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from ngsolve import IntegrationRule

from ngepc.bounds.flow_potentials import flow_potential
from ngepc.bounds.mapped import SHAPES, MappedElements
from ngepc.bounds.mapping import bernstein_functions, bernstein_lattice
from ngepc.bounds.polynomials import portions, worth_keeping

LEVELS = {2: 4, 3: 3}
"""How often elements are cut at most."""
PORTION = 40_000
"""Strains that are held in memory at once."""


def least_flow(those: MappedElements, allowed: float) -> np.ndarray:
    """Lower bounds of the integrals of G over the elements.

    They are cut until a rule exceeds the sum of the bounds by less than ``allowed``.
    """
    N = those.N
    cell = np.arange(len(those.numbers))
    lattice, to_coefficients = bernstein_lattice(N, those.common)
    e, J = those.polynomials(lattice, cell)
    parts = np.matmul(to_coefficients, np.concatenate([e, J[..., None]], axis=2))
    least = np.zeros(len(cell))
    for level in range(LEVELS[N] + 1):
        low, near = flows(those, parts, cell)
        low *= 0.5 ** (N * level)
        missed = 0.5 ** (N * level) * near - low
        kept = worth_keeping(missed, allowed)
        if level == LEVELS[N]:
            kept[:] = True
        least += np.bincount(cell[kept], low[kept], minlength=len(least))
        if kept.all():
            break
        allowed -= missed[kept].sum()
        parts = halves(parts[~kept], N, those.common)
        cell = np.repeat(cell[~kept], 2**N)
    return least


def halves(parts: np.ndarray, N: int, degree: int) -> np.ndarray:
    """Coefficients on the 2^N halves of parts (n, k, c), (2^N n, k, c)."""
    table = halving(N, degree)
    k = len(table[0])
    found = np.matmul(table.reshape(-1, k), parts)
    return found.reshape(-1, k, parts.shape[2])


@cache
def halving(N: int, degree: int) -> np.ndarray:
    """Coefficients on the halves of a part from those on the part, (2^N, k, k)."""
    lattice, to_coefficients = bernstein_lattice(N, degree)
    origins = np.indices(N * (2,)).reshape(N, -1).T
    return np.stack(
        [
            to_coefficients @ bernstein_functions((origin + lattice) / 2, degree)
            for origin in origins
        ]
    )


def flows(
    those: MappedElements, parts: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lower bounds of the integrals of G over parts as large as elements, and those by a rule."""
    degree = 2 * those.degree + 3 * those.bend
    rule = IntegrationRule(SHAPES[those.N], degree)
    places = np.array(rule.points)[:, : those.N]
    values = bernstein_functions(places, those.common)
    weights = np.array(rule.weights)
    low = np.empty(len(parts))
    near = np.empty(len(parts))
    each = PORTION // (len(weights) + parts.shape[1])
    for some in portions(len(parts), max(each, 1)):
        low[some], near[some] = few_flows(
            those, parts[some], cell[some], (values, weights)
        )
    return low, near


def few_flows(
    those: MappedElements,
    parts: np.ndarray,
    cell: np.ndarray,
    rule: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """The same by a rule: values from coefficients, and weights.

    The law is evaluated at the points, at the quotients of the coefficients and at the mean strain.
    """
    values, weights = rule
    count = len(weights)
    there = np.matmul(values, parts)
    J = there[..., -1]
    share = weights * J
    area = share.sum(axis=1)
    mean = np.einsum("q,nqs->ns", weights, there[..., :-1]) / area[:, None]
    positive = parts[..., -1:] > 0
    quotients = parts[..., :-1] / np.where(positive, parts[..., -1:], 1.0)
    strains = [there[..., :-1] / J[..., None], quotients, mean[:, None]]
    law, at = those.returned(np.concatenate(strains, axis=1), cell)
    G = flow_potential(law.resistance, law.modulus, at.size, at.gained)
    G = G.reshape(len(parts), -1)
    near = (share * G[:, :count]).sum(axis=1)
    low = area * G[:, -1]
    if law.resistance.is_constant:
        s = at.trial.reshape(*G.shape, -1)
        yields = those.law(cell, 1)
        found = linear_flow(s, J, weights, positive[..., 0], yields.beta)
        low = np.maximum(low, found / (2 * yields.modulus))
    return low, near


def linear_flow(
    s: np.ndarray,
    J: np.ndarray,
    weights: np.ndarray,
    positive: np.ndarray,
    beta: np.ndarray,
) -> np.ndarray:
    """Lower bounds of int [|s| - beta]_+^2 over parts, zero where s may be below beta, (n,).

    ``s`` (n, ., d) are at the points of the rule, at the quotients of the coefficients, and at the
    mean strain; J (n, q) at the points; ``positive`` says where the coefficients of J are.
    """
    count = len(weights)
    middle = s[:, -1]
    length = np.linalg.norm(middle, axis=1, keepdims=True)
    d = middle / np.where(length > 0, length, 1.0)
    a = np.einsum("nqd,nd->nq", s, d)
    least = np.where(positive, a[:, count:-1], -np.inf).min(axis=1)
    yields = least > beta
    share = 1 - beta / np.where(yields, least, np.inf)

    s = s[:, :count]
    a = a[:, :count]
    across = np.maximum(np.einsum("nqd,nqd->nq", s, s) - a**2, 0.0)
    squares = (a - beta[:, None]) ** 2 + share[:, None] * across
    c = (J.max(axis=1) + J.min(axis=1))[:, None] / 2
    t = J / c - 1
    inverse = (1 - t) * (1 + t**2) / c
    found = (weights * J**2 * inverse * squares).sum(axis=1)
    return np.where(yields, found, 0.0)
