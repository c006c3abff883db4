"""CONVERGED by other eyes: sparse LU of D from scipy, refined in extended precision.

Nothing of the solver but the dual variable v and its spaces is used.  D is assembled uncondensed
in two ways that differ in rounding only: where lambda/h is large even that is seen in the residual.
"""

import dataclasses
import math
import re
from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp
from bodies import flat_problem
from campaigns.robustness import Case
from campaigns.robustness import extreme_problem as build
from ngsolve import CF, BilinearForm, GridFunction, dx, y
from scipy.sparse.linalg import splu
from witness import elastic_product

from ngepc import (
    Coupled,
    FullProduct,
    Material,
    NewtonOptions,
    Status,
    lshape_problem,
    semismooth_newton,
)
from ngepc.dual.functional import DualIterate, total
from ngepc.dual.saddle import elastic_terms
from ngepc.geometries import block, lshape

REGULARISATIONS = {
    "coupled": Coupled(1e3),
    "full product": Coupled(1e2, tichonov=FullProduct()),
}
CASES = {
    "Poisson 0.49": Case(poisson=0.49),
    "Poisson 0.4999": Case(poisson=0.4999),
    "h/mu 1e-4": Case(hardening=1e-4),
    "h/mu 1e-6": Case(hardening=1e-6),
    "Poisson 0.4999 and h/mu 2e-6": Case(poisson=0.4999, hardening=2e-6),
}
REACHES = {"Poisson 0.49", "Poisson 0.4999"}
"""Cases where rounding leaves less than 1e-10."""


def assembled(blocks, product):
    """D on the free degrees of freedom, its integrand as one product or multiplied out."""
    (u, p), (du, dp) = blocks.Y.TnT()
    form, h = BilinearForm(blocks.Y), blocks.problem.effective_hardening
    if product:
        form += elastic_product(blocks.problem, h, u, p, du, dp) * dx
    else:
        for term in elastic_terms(blocks.problem, u, p, du, dp):
            form += term * dx
    values, columns, starts = (np.array(a) for a in form.Assemble().mat.CSR())
    D = sp.csr_matrix((values, columns.astype(int), starts.astype(int)))
    free = np.flatnonzero(np.array(blocks.Y.FreeDofs(), dtype=bool))
    return D[free][:, free].tocsr(), free


def extended(D, x):
    """D x with products and sums in extended precision."""
    products = D.data.astype(np.longdouble) * x[D.indices]
    return np.add.reduceat(products, D.indptr[:-1])


def primal(result, product):
    """y from D y = Lambda* v - l, to the last digit of that D, as a vector on Y."""
    blocks = result.functional.blocks
    D, free = assembled(blocks, product)
    right = (blocks.Lambda.T * result.v + blocks.load).Evaluate().FV().NumPy()[free]
    lu, u = splu(D.tocsc()), np.zeros(len(free), dtype=np.longdouble)
    for _ in range(8):
        u += lu.solve(np.asarray(right - extended(D, u), dtype=float))
    exact = GridFunction(blocks.Y)
    exact.vec.FV().NumPy()[free] = u
    return exact.vec


def residual(result, product):
    """||Psi_gamma(v)|| there."""
    return DualIterate(
        result.functional, result.v, primal(result, product)
    ).residual_norm


@pytest.fixture(scope="module")
def problems():
    return {name: build(case) for name, case in CASES.items()}


@pytest.fixture(scope="module")
def solved(problems):
    """The result of a case, by names of the case and of the regularisation."""

    @cache
    def result(name, regularisation):
        chosen = REGULARISATIONS[regularisation]
        return semismooth_newton(problems[name], regularisation=chosen)

    return result


@pytest.mark.parametrize(
    ("name", "regularisation"),
    [
        *((name, "coupled") for name in CASES),
        ("Poisson 0.4999", "full product"),
        ("h/mu 1e-6", "full product"),
    ],
)
def test_converged_is_what_others_see(solved, name, regularisation):
    """With 1e-10 asked for: converged and others see less, or stagnated with the reason."""
    result = solved(name, regularisation)
    if name in REACHES:
        assert result.status is Status.CONVERGED
    if result.status is Status.CONVERGED:
        assert max(residual(result, True), residual(result, False)) < 1e-10
    else:
        assert result.status is Status.STAGNATED
        assert "Rounding errors leave a residual of about" in result.message
        assert f"the residual is {result.residual_norm:.3g}" in result.message


@pytest.mark.parametrize(
    ("name", "regularisation"),
    [
        ("h/mu 1e-4", "coupled"),
        ("h/mu 1e-6", "full product"),
        ("Poisson 0.4999 and h/mu 2e-6", "coupled"),
    ],
)
def test_a_tolerance_above_the_rounding_is_met(solved, name, regularisation):
    """What the message advises works, and the estimate is neither wild nor an excuse."""
    stuck = solved(name, regularisation)
    rounding = stuck.residual_rounding
    seen = [residual(stuck, product) for product in (True, False)]
    assert abs(seen[0] - seen[1]) < 10 * rounding
    assert max(seen) < 100 * rounding
    advice = float(re.search(r"tolerance above (\S+) can be met", stuck.message)[1])
    assert advice < 20 * rounding
    options = NewtonOptions(tolerance=max(advice, 20 * rounding))
    R = REGULARISATIONS[regularisation]
    result = semismooth_newton(stuck.problem, regularisation=R, options=options)
    assert result.status is Status.CONVERGED
    assert max(residual(result, True), residual(result, False)) < 20 * rounding


def test_the_estimate_is_of_the_size_of_what_two_assemblies_differ_by(solved):
    for name in CASES:
        result = solved(name, "coupled")
        functional, blocks = result.functional, result.functional.blocks
        difference = (primal(result, True) - primal(result, False)).Evaluate()
        image = (blocks.Lambda * difference).Evaluate()
        ratio = total(functional.residual_norms(image)) / result.residual_rounding
        assert 0.05 < ratio < 5


def test_large_loads_are_counted_too():
    """y of size 1e4 leaves rounding of its own in a problem that is otherwise tame."""
    problem = dataclasses.replace(
        lshape_problem(lshape.paper_mesh(113)), traction={"load": (0.0, 3e4)}
    )
    result = semismooth_newton(problem, 1e2, options=NewtonOptions(tolerance=1e-12))
    assert result.status is Status.STAGNATED
    assert result.residual_rounding > 1e-12


def test_examples_of_the_paper_are_far_from_rounding():
    result = semismooth_newton(lshape_problem(lshape.paper_mesh(417)), 1e3)
    assert result.status is Status.CONVERGED
    assert result.residual_rounding < 1e-12
    assert max(residual(result, True), residual(result, False)) < 1e-10


def test_refined_displacements_satisfy_the_uncondensed_equations():
    """D y = Lambda* v - l to rounding of its terms, row by row, where condensation loses digits."""
    material = Material.kinematic(
        lame_lambda=5e6, lame_mu=1e3, yield_stress=1.25, hardening=1e-2
    )
    mesh = block.structured_mesh(6, 6, simplices=True)
    load = {"left": CF((0.0, 3.0 * y))}
    problem = flat_problem(mesh, material, traction=load, contact="contact", gap=1e-3)
    result = semismooth_newton(problem, regularisation=Coupled(1e2))
    blocks = result.functional.blocks
    D, free = assembled(blocks, False)
    right = (blocks.Lambda.T * result.v + blocks.load).Evaluate().FV().NumPy()[free]
    u = result.y.FV().NumPy()[free].astype(np.longdouble)
    terms = extended(abs(D), abs(u)) + abs(right)
    assert float((abs(right - extended(D, u)) / terms).max()) < 4 * np.finfo(float).eps
    assert math.isfinite(result.residual_norm)
