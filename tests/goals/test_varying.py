"""Integrals of the supremum where strains are affine: above fine quadrature, and near it."""

from dataclasses import replace

import numpy as np
import pytest

from ngepc.bounds.polynomials import NODES, TO_NODES, coefficients
from ngepc.goals.pieces import SPLIT, WEIGHTS, at_rule, child_coefficients
from ngepc.goals.varying import NAMES, VaryingData, sides_of

TWO_MU = 2e3
BETA = 5.0
PARTS = 30
FACTOR = 0.5


def data_of(k, d):
    """Random parts, some of which yield in part, with stresses near those of the tangent."""
    rng = np.random.default_rng(k)
    corners = {4: 4, 6: 3}[k]

    def affine(count, scale, spread):
        """Coefficients of affine functions with a mean of this size."""
        mean = scale * rng.normal(size=(PARTS, 1, count))
        at_corners = mean + spread * scale * rng.normal(size=(PARTS, corners, count))
        first = TO_NODES[corners][: NODES[{4: 16, 6: 18}[k]]]
        return coefficients(np.matmul(first, at_corners))

    trial = affine(d, BETA / np.sqrt(d), 0.3)
    strain = affine(d, 1e-3, 0.3)
    volume = affine(1, 1e-3, 0.3)
    trace = affine(1, 1e-3, 0.3)
    off = 0.2 * rng.normal(size=(2, PARTS, k, 1 + d))
    one = np.ones(PARTS)
    law = {"bulk": 3e3 * one, "two_mu": TWO_MU * one}
    law |= {"hardening": 100 * one, "beta": BETA * one}
    size = np.minimum(1, BETA / np.linalg.norm(trial, axis=2, keepdims=True))
    return VaryingData(
        tau=np.concatenate([3e3 * trace, TWO_MU * strain], axis=2) + off[0],
        sigma=np.concatenate([3e3 * volume, size * trial], axis=2) + off[1],
        volume=volume,
        trial=trial,
        back=affine(d, 0.1, 0.0),
        trace=trace,
        strain=strain,
        law=law,
        size=rng.uniform(0.5, 2.0, PARTS),
    )


def searched(law, pulled, w):
    """Phi at points (n, k, d) from below: the largest value for many rho."""
    k = law.k[:, None]
    beta = law.beta[:, None]
    kept = (law.H / (1 + law.H))[:, None]
    v = pulled + kept[..., None] * w
    y = np.linalg.norm(pulled + w, axis=2)
    size = np.linalg.norm(v, axis=2)
    best = np.where(y <= 2 * k * beta, y**2 / (4 * k), beta * (y - k * beta))
    for part in np.linspace(0, 1, 600):
        x = part * size / (2 * k * kept)
        rho = beta + x
        r = beta + kept * x
        moved = rho[..., None] * pulled + r[..., None] * w
        best = np.maximum(best, np.linalg.norm(moved, axis=2) - k * rho * r)
    return best


def cut(data):
    """The data on the children of all cells."""
    count = len(SPLIT[data.k])
    values = {name: child_coefficients(getattr(data, name)) for name in NAMES}
    law = {name: np.tile(value, count) for name, value in data.law.items()}
    return replace(data, **values, law=law, size=np.tile(data.size, count) / count)


def nearly_exact_integrals(fine):
    """Integrals over small parts by a rule, with the Phi that is searched for."""
    k = fine.k
    sides = sides_of(fine)
    pulled = at_rule(sides.pulled(1.0, FACTOR))
    w = at_rule(sides.w(1.0, FACTOR))
    found = searched(sides.law(FACTOR), pulled, w)
    return fine.size * (found @ WEIGHTS[k]) + sides.rest(1.0, FACTOR)


@pytest.mark.parametrize(("k", "d"), [(4, 5), (6, 3), (6, 2)])
def test_bounds_lie_above_fine_quadrature_and_near_it(k, d):
    data = data_of(k, d)
    for sign, each in ((1.0, data), (-1.0, data.turned())):
        bound = sides_of(data).integrals(sign, FACTOR)
        turned = sides_of(each).integrals(1.0, FACTOR)
        np.testing.assert_allclose(bound, turned, rtol=1e-9)
        fine = each
        for _ in range(2):
            fine = cut(fine)
        work = fine.size * fine.kept_work()
        own = each.size * each.kept_work()
        exact = (nearly_exact_integrals(fine) - work).reshape(-1, PARTS).sum(axis=0)
        exact += own
        assert (bound >= exact - 1e-9 * exact.sum()).all()
        assert bound.sum() < 1.1 * exact.sum()


def test_quadratics_are_integrated_exactly():
    """Nothing yields far inside the ball."""
    data = data_of(4, 5)
    data.law["beta"][:] = 1e6
    sides = sides_of(data)
    bound = sides.integrals(1.0, FACTOR)
    np.testing.assert_allclose(bound, sides.estimate(1.0, FACTOR), rtol=1e-10)
