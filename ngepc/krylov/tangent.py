"""The tangent elasticity that is spectrally close to (7.1) with p and q eliminated.

Take q at a point instead of in R_h.  With c = 2 mu_2 + h_F and e = dev eps(u), elimination of p
leaves the modulus 2 mu_2 h_F / c of the deviator, soft everywhere.  q gives stiffness back,

    e . (2 mu_2 / c)^2 (1/c + G + t)^(-1) e,    G = M'(q) of (6.1),

in full where G = 0; t stands for the Tichonov term at the frequency of the mesh.  That is the
consistent tangent of plasticity, and cheap to assemble.
"""

from __future__ import annotations

from ngsolve import (
    ET,
    BilinearForm,
    GridFunction,
    IfPos,
    InnerProduct,
    IntegrationRule,
    Norm,
    Trace,
    dx,
    grad,
    specialcf,
)
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.functional import DualFunctional
from ngepc.penalty import TINY
from ngepc.problem import as_scalar
from ngepc.tensors import strain, tensor

FREQUENCY = 20.0
"""|grad q|^2 h_mesh^2 / |q|^2 of rough P1 functions."""

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
        elastic = 1 / c + FREQUENCY / (functional.gamma_T * specialcf.mesh_size**2)
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

    def matrix(self, q: BaseVector | None) -> SparseMatrixd:
        """The matrix at q, both triangles; None leaves the nonsmooth term out."""
        self._q.vec[:] = 0.0
        if q is not None:
            self._q.vec.data = q
        return self._form.Assemble().mat
