"""The tangent elasticity that is spectrally close to (7.1) with p and q eliminated.

Take q at a point instead of in R_h.  With c = 2 mu_2 + h_F and e = dev eps(u), elimination of p
leaves the modulus 2 mu_2 h_F / c of the deviator, soft everywhere.  q gives stiffness back,

    e . (2 mu_2 / c)^2 (1/c + G + t)^(-1) e,    G = M'(q) of (6.1),

in full where G = 0.  That is the consistent tangent of plasticity, and cheap to assemble.  t stands
for the Tichonov term, k^2 / gamma_T for a displacement of frequency k: on each mesh of a multigrid
cycle k is the frequency of that mesh, so that there is a matrix T for each of them.
"""

from __future__ import annotations

import math

from ngsolve import (
    ET,
    L2,
    BilinearForm,
    CoefficientFunction,
    GridFunction,
    IfPos,
    InnerProduct,
    IntegrationRule,
    Mesh,
    Norm,
    Parameter,
    Trace,
    dx,
    grad,
    specialcf,
)
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.dual.functional import DualFunctional
from ngepc.dual.penalty import TINY
from ngepc.model.problem import as_scalar
from ngepc.model.tensors import strain, tensor

FREQUENCY = 20.0
"""|grad q|^2 h_mesh^2 / |q|^2 of rough P1 functions."""

NEGLIGIBLE = 0.1
"""A c t below which the coarser meshes share the matrix."""

ORDERS = {ET.TRIG: 1, ET.TET: 1, ET.QUAD: 3, ET.HEX: 3, ET.PRISM: 3, ET.PYRAMID: 3}
"""Of the rules that are just fine enough for a regular matrix."""


class TangentElasticity:
    """The form for one functional.

    Parameters
    ----------
    functional
        J*_gamma.
    """

    def __init__(self, functional: DualFunctional) -> None:
        blocks, regularisation = functional.blocks, functional.regularisation
        problem, N = blocks.problem, blocks.problem.N
        V, R = blocks.Y.components[0], blocks.spaces[-1]
        gamma_q = as_scalar(regularisation.gamma_plastic(problem))
        threshold = regularisation.yield_bound(problem) - regularisation.plastic_shift / gamma_q
        two_mu, h_F = 2 * as_scalar(problem.material.lame_mu), as_scalar(blocks.h_F)
        c = two_mu + h_F
        q = self._q = GridFunction(R)
        size = Norm(q) + TINY
        s = size - threshold
        self._frequency = Parameter(FREQUENCY)
        tichonov = self._frequency / (functional.gamma_T * specialcf.mesh_size**2)
        elastic = 1 / c + tichonov
        self._tichonov = largest(c * tichonov, problem.mesh)
        coupling = (two_mu / c) * (two_mu / c)
        across = coupling / (elastic + IfPos(s, gamma_q * s / size, 0))
        along = coupling / (elastic + IfPos(s, gamma_q, 0))
        modulus = two_mu * h_F / c + across
        softer = IfPos(s, (along - across) / (size * size), 0)
        bulk = as_scalar(problem.material.lame_lambda) + (two_mu - modulus) / N
        (u, v), Q = V.TnT(), tensor(q, N)
        e, d = strain(u), strain(v)
        terms = (
            bulk * Trace(e) * Trace(d) + modulus * InnerProduct(e, d),
            softer * InnerProduct(grad(u), Q) * InnerProduct(grad(v), Q),
        )
        means = dx(intrules={s: IntegrationRule(s, order) for s, order in ORDERS.items()})
        self._form = BilinearForm(V)
        for term in terms:
            self._form += term.Compile() * means

    def matrices(self, q: BaseVector | None, levels: int) -> list[SparseMatrixd]:
        """The matrices at q on this mesh, both triangles.

        Parameters
        ----------
        q
            The coefficients; None leaves the nonsmooth term out.
        levels
            Number of meshes.

        Returns
        -------
        list of SparseMatrixd
            T with the frequency of this mesh, of the next coarser one and so on; the last one
            serves all coarser meshes.
        """
        self._q.vec[:] = 0.0
        if q is not None:
            self._q.vec.data = q
        differing = math.log(max(1.0, self._tichonov / NEGLIGIBLE), 4)
        return [self._matrix(level) for level in range(min(levels, 1 + math.ceil(differing)))]

    def _matrix(self, level: int) -> SparseMatrixd:
        self._frequency.Set(FREQUENCY / 4**level)
        assembled = self._form.Assemble().mat
        T = assembled.CreateMatrix()
        T.AsVector().data = assembled.AsVector()
        return T


def largest(coefficient: CoefficientFunction, mesh: Mesh) -> float:
    """The largest mean of a coefficient over an element."""
    means = GridFunction(L2(mesh, order=0))
    means.Set(coefficient)
    return float(means.vec.FV().NumPy().max())
