"""Upper bounds of integrals of the Phi of ``supremum`` over the cells, on parts that are cut.

Phi(q, w) is convex, q and w are polynomials on the parts.  Where nothing may yield Phi is a
quadratic, which is integrated exactly; where a part yields everywhere there is the bound of
``yielding``.  Elsewhere the mean of Phi is at most the mean of its values at the coefficients.
Parts are cut until the bounds exceed the integrals by a small part of them.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.polynomials import SPLIT, portions, worth_keeping
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.supremum_of_laws import NonlinearLaw
from ngepc.goals.yielding import by_components

SPLITS = {3: 3, 4: 2, 6: 3}
"""Most levels of cutting, by the number of coefficients on a part."""
WORTH = {3: 0.02, 4: 0.02, 6: 0.05}
"""What bounds may exceed the integrals by, as a part of them."""
INSIDE = {3: 1 / 4, 4: 1 / 5, 6: 2 / 5}
"""Variance of an affine function on a part over that of its coefficients."""


def potential_integrals(
    law: ScaledLaw | NonlinearLaw,
    pulled: np.ndarray,
    w: np.ndarray,
    parts: tuple[np.ndarray, np.ndarray],
    rest: np.ndarray,
) -> np.ndarray:
    """Integrals over the cells of Phi from above, and of a ``rest`` that is given.

    Parameters
    ----------
    law, pulled, w
        The law on parts; the coefficients (n, k, d) of q/(2 mu_2), and those of w or, where it is
        constant on parts, (n, 1, d).
    parts
        Volume and cell of each part, (n,).
    rest
        Integrals over all cells.
    """
    k = pulled.shape[1]
    volume, cell = parts
    result = rest.copy()
    for level in range(SPLITS[k] + 1):
        bound, estimate = potential_means(law, pulled, w)
        bound *= volume
        estimate *= volume
        total = float(result.sum() + estimate.sum())
        if not np.isfinite(total):
            return np.full(
                len(result), np.inf
            )  # where Phi is infinite, cuts do not help
        kept = worth_keeping(bound - estimate, WORTH[k] * total)
        if level == SPLITS[k]:
            kept[:] = True
        result += np.bincount(cell[kept], bound[kept], minlength=len(result))
        if kept.all():
            break
        cut = ~kept
        count = len(SPLIT[k])
        pulled = on_child_parts(pulled[cut])
        w = on_child_parts(w[cut]) if w.shape[1] > 1 else w[cut].repeat(count, axis=0)
        law = law.of_points(cut).repeated(count)
        volume = np.repeat(volume[cut] / count, count)
        cell = np.repeat(cell[cut], count)
    return result


def potential_means(
    law: ScaledLaw | NonlinearLaw, pulled: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means of Phi over parts: upper bounds and estimates, (n,)."""
    bound = np.empty(len(pulled))
    estimate = np.empty(len(pulled))
    for part in portions(len(pulled)):
        few = law.of_points(part)
        bound[part], estimate[part] = smooth_means(few, pulled[part], w[part])
    other = np.flatnonzero(np.isinf(bound))
    found = coefficient_means(law.of_points(other), pulled[other], w[other])
    bound[other], estimate[other] = found
    return bound, estimate


def smooth_means(
    law: ScaledLaw | NonlinearLaw, pulled: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same, infinite for parts that may be elastic in part."""
    p_first = by_components(pulled)
    w_first = by_components(w)
    elastic = law.elastic(p_first, w_first)
    bound = np.empty(len(pulled))
    bound[elastic] = law.of_points(elastic).quadratic(pulled[elastic], w[elastic], 1.0)
    estimate = bound.copy()
    if elastic.all():
        return bound, estimate
    other = ~elastic if elastic.any() else slice(None)
    some = law.of_points(other)
    found = some.yielding_means(p_first[..., other], w_first[..., other])
    bound[other], estimate[other] = found
    return bound, estimate


def coefficient_means(
    law: ScaledLaw | NonlinearLaw, pulled: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means of Phi by its values at the coefficients, and estimates by that at the mean."""
    k = pulled.shape[1]
    bound = law.potential(pulled, w).mean(axis=1)
    centres = (values.mean(axis=1, keepdims=True) for values in (pulled, w))
    least = law.potential(*centres)[:, 0]
    finite = np.isfinite(least)
    estimate = np.full(len(least), np.inf)
    estimate[finite] = least[finite] + INSIDE[k] * (bound[finite] - least[finite])
    return bound, estimate


def on_child_parts(values: np.ndarray) -> np.ndarray:
    """Coefficients on the children of parts (parts, k, c)."""
    k = values.shape[1]
    table = SPLIT[k].reshape(-1, k)
    return np.matmul(table, values).reshape(-1, k, values.shape[2])
