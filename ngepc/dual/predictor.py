"""A plastic predictor: the q that belongs to a displacement, by return mapping in R_h.

From v = 0 the first Newton step meets no active max term, and its full length leads to the elastic
solution, whose q lies far beyond the yield bound.  For a fixed displacement u the saddle function
S(y, v) of functional.py leaves the local, strictly convex problem

    min over q:  int |Pi q + e|^2 / (2 c) + s(q, q) / 2 + M^2(q) + b(q, q) / (2 gamma_T),

with c = 2 mu_2 + h_F, e = 2 mu_2 dev(eps(u) - p_0) - alpha_0 and Pi the projection onto Q_h: the
return mapping of plasticity.  Lumped to the vertices it has a closed form, and few Newton steps
with a mass matrix do the rest.  docs/balanced.md shows what it is worth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ngsolve import BilinearForm, GridFunction, InnerProduct, LinearForm, dx
from ngsolve.la import BaseVector

from ngepc.checks.arguments import require_number
from ngepc.discretisation.return_mapping import at_plastic_points
from ngepc.dual.functional import DualFunctional
from ngepc.dual.iterates import Iterate, Line
from ngepc.linalg.assembly import Placed, SparseSum
from ngepc.linalg.direct import LinearSolver, linear_solver
from ngepc.model.problem import as_scalar
from ngepc.model.tensors import coordinates, coordinates_count, strain
from ngepc.parallel import accumulated, entries

MOST_STEPS = 12


@dataclass(frozen=True)
class ReturnMapping:
    """Look at the return mapping of the full step wherever no max term was active before it.

    Parameters
    ----------
    accuracy
        Reduction of the residual of the local problem, in (0, 1).

    Raises
    ------
    TypeError, ValueError
        If the accuracy is out of range.
    """

    accuracy: float = 0.1

    def __post_init__(self) -> None:
        if require_number("accuracy", self.accuracy, 0, strict=True) >= 1:
            raise ValueError(f"accuracy={self.accuracy!r}: a number in (0, 1) is needed")

    def improved(
        self,
        functional: DualFunctional,
        line: Line,
        following: Iterate,
        inverse: str | LinearSolver,
    ) -> Iterate:
        """The one of lower energy: ``following``, or the prediction from the full step.

        Parameters
        ----------
        functional
            J*_gamma.
        line
            The Newton direction that led to ``following``.
        following
            The iterate that the line search chose.
        inverse
            A ``LinearSolver`` or NGSolve's name of a direct one.
        """
        if not line.here.is_start:
            return following
        y = line.dy.CreateVector()
        y.data = line.here.y + line.dy
        predicted = Iterate.at(functional, self._mapped(functional, line.dual(1.0), y, inverse))
        if not predicted.energy < following.energy:
            return following
        predicted.step = following.step
        return predicted

    def start(
        self, functional: DualFunctional, v: BaseVector, u: np.ndarray, inverse: str | LinearSolver
    ) -> BaseVector:
        """The one of lower energy: v, or v with the q that belongs to the displacement u.

        Parameters
        ----------
        functional
            J*_gamma.
        v
            Dual variable carried over from another mesh.
        u
            Nodal displacements carried over, shape (N, vertices).
        inverse
            A ``LinearSolver`` or NGSolve's name of a direct one.
        """
        functional.make_feasible(v)
        y = functional.blocks.Y_vector()
        y.FV().NumPy()[: u.size] = u.ravel()
        mapped = self._mapped(functional, v, y, inverse)
        energies = [Iterate.at(functional, w).energy for w in (v, mapped)]
        return mapped if energies[1] < energies[0] else v

    def _mapped(
        self, functional: DualFunctional, v: BaseVector, y: BaseVector, inverse: str | LinearSolver
    ) -> BaseVector:
        mapped, blocks = v.CreateVector(), functional.blocks
        mapped.data = v
        q = LocalProblem(functional, inverse, self.accuracy).solve(y)
        blocks.part_of(mapped, len(blocks.parts) - 1).data = q.local_vec
        return mapped


class LocalProblem:
    """Return mapping of a displacement into R_h.

    Parameters
    ----------
    functional
        J*_gamma.
    inverse
        A ``LinearSolver`` or NGSolve's name of a direct one.
    accuracy
        Reduction of the residual that ends the Newton steps.
    """

    def __init__(
        self, functional: DualFunctional, inverse: str | LinearSolver, accuracy: float
    ) -> None:
        self._functional, self._solver = functional, linear_solver(inverse)
        self._accuracy, blocks = accuracy, functional.blocks
        self._penalty, self._B = functional.penalties[-1], blocks.B[-1]
        R = self._R = blocks.spaces[-1]
        self._free = np.array(R.FreeDofs(), dtype=bool)
        self._assemble(R)

    def _assemble(self, R) -> None:
        blocks, problem = self._functional.blocks, self._functional.blocks.problem
        on_points = at_plastic_points(problem, dx)
        two_mu = 2 * as_scalar(problem.material.lame_mu)
        c = two_mu + as_scalar(blocks.h_F)
        q, w = R.TnT()
        self._mass = BilinearForm(R, symmetric=True, symmetric_storage=True)
        self._mass += InnerProduct(q, w) / c * on_points
        self._mass.Assemble()
        if blocks.completion is not None:
            self._mass.mat.local_mat.AsVector().data += blocks.completion.AsVector()
        self._y = GridFunction(blocks.Y)
        e = two_mu * coordinates(strain(self._y.components[0]) - problem.p_0, problem.N)
        e -= coordinates(problem.alpha_0[1], problem.N)
        self._load = LinearForm(R)
        self._load += -1 / c * e * w * on_points
        total = sum(w[i] for i in range(coordinates_count(problem.N)))
        gamma = as_scalar(self._functional.regularisation.gamma_plastic(problem))
        self._lumped = [
            entries(LinearForm(density * total * dx).Assemble().vec)
            for density in (1 / c, gamma, gamma * as_scalar(problem.beta))
        ]

    def _lumped_mapping(self, load: np.ndarray) -> np.ndarray:
        """The closed form at each vertex: q in the direction of the trial value t."""
        d = coordinates_count(self._functional.blocks.problem.N)
        a, g, gb = (x.reshape(d, -1) for x in self._lumped)
        t = load.reshape(d, -1) / a
        size = np.sqrt((t * t).sum(axis=0))
        returned = np.where(g * size > gb, (a * size + gb) / (a + g), size)
        factor = np.where(size > 0, returned / np.where(size > 0, size, 1.0), 0.0)
        return np.where(self._free, (factor * t).ravel(), 0.0)

    def _energy(self, q: BaseVector) -> float:
        linear = self._load.vec.CreateVector()
        linear.data = 0.5 * (self._mass.mat * q) - self._load.vec
        linear.local_vec.data += 0.5 / self._functional.gamma_T * (self._B * q.local_vec)
        return InnerProduct(linear, q) + self._penalty.energy(q.local_vec)

    def _gradient(self, q: BaseVector) -> BaseVector:
        g = self._load.vec.CreateVector()
        g.data = self._mass.mat * q - self._load.vec
        g.local_vec.data += self._penalty.gradient(q.local_vec)
        g.local_vec.data += 1 / self._functional.gamma_T * (self._B * q.local_vec)
        g.FV().NumPy()[~self._free] = 0.0
        return g

    def solve(self, y: BaseVector) -> BaseVector:
        """The coefficients of q in R_h for the displacement in ``y``."""
        self._y.vec.data = y
        self._load.Assemble()
        q = GridFunction(self._R).vec
        q.FV().NumPy()[:] = self._lumped_mapping(entries(self._load.vec))
        self._sum = SparseSum(
            self._penalty.pattern(), [Placed(self._mass.mat.local_mat), Placed(self._B)]
        )
        inverse, first = None, None
        for _ in range(MOST_STEPS):
            g = self._gradient(q)
            size = accumulated(g).Norm()
            first = size if first is None else first
            if size <= self._accuracy * first:
                break
            self._assemble_hessian(q)
            if inverse is None:
                inverse = self._solver.product_inverse(self._sum.matrix, self._R)
            else:
                inverse.Update()
            dq = q.CreateVector()
            dq.local_vec.data = -1 * (inverse * g.local_vec)
            q = self._descended(q, dq, InnerProduct(g, dq))
        return q

    def _assemble_hessian(self, q: BaseVector) -> None:
        self._sum.entries[:] = 0.0
        self._sum.add(Placed(self._mass.mat.local_mat))
        self._sum.add(Placed(self._B), 1 / self._functional.gamma_T)
        self._sum.add(Placed(self._penalty.hessian(q)))

    def _descended(self, q: BaseVector, dq: BaseVector, slope: float) -> BaseVector:
        here, alpha, trial = self._energy(q), 1.0, q.CreateVector()
        while alpha > 1e-3:
            trial.data = q + alpha * dq
            if self._energy(trial) <= here + 1e-4 * alpha * slope:
                return trial
            alpha /= 2
        return q
