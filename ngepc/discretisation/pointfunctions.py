"""Values at the integration points as piecewise polynomials, and back, to round-off."""

from __future__ import annotations

import numpy as np
from ngsolve import L2, CoefficientFunction, GridFunction, VectorValued, x, y, z

from ngepc.discretisation.points import Points
from ngepc.model.elements import plastic_order
from ngepc.model.problem import Problem


class PointFunctions:
    """The discontinuous polynomials that values at the points of each element determine."""

    def __init__(self, points: Points) -> None:
        self.points = points
        self._scalar = L2(points.mesh, order=plastic_order(points.mesh, points.order))
        self._inverses, shape = [], GridFunction(self._scalar)
        for numbers in (block.points for block in points.blocks):
            values = np.empty((*numbers.shape, numbers.shape[1]))
            for k, those in enumerate(numbers.T):
                shape.vec[:] = 0.0
                shape.vec.FV().NumPy()[those] = 1.0  # they follow each other as the points do
                values[:, :, k] = points.at(shape)[numbers]
            self._inverses.append(np.linalg.inv(values))

    def function(self, values: np.ndarray, name: str = "gfu") -> GridFunction:
        """The function with these values at the points, shape (points,) or (points, d)."""
        columns = values.reshape(len(values), -1)
        space = self._scalar if values.ndim == 1 else VectorValued(self._scalar, columns.shape[1])
        result = GridFunction(space, name=name)
        result.vec.FV().NumPy()[:] = self._applied(self._inverses, columns).T.ravel()
        return result

    def transposed(self, slope: np.ndarray, components: int) -> np.ndarray:
        """Derivatives by the values at the points, (points, components), from those by ``vec``."""
        transposed = [inverse.swapaxes(1, 2) for inverse in self._inverses]
        return self._applied(transposed, slope.reshape(components, -1).T)

    def _applied(self, matrices: list[np.ndarray], columns: np.ndarray) -> np.ndarray:
        """Matrices of the elements of each shape times what belongs to their points."""
        result = np.empty_like(columns)
        for block, matrix in zip(self.points.blocks, matrices, strict=True):
            result[block.points] = matrix @ columns[block.points]
        return result


def on_children(
    values: np.ndarray, before: Points, after: Points, parents: np.ndarray
) -> np.ndarray:
    """The same constants or affine functions at the points of a mesh inside another, exactly.

    ``values`` are at the points of simplices, one or N + 1 of each; ``parents`` are the cells that
    those of the second mesh lie in.
    """
    known, wanted = (
        np.stack([points.at(v) for v in (1.0, x, y, z)], axis=1).reshape(points.mesh.ne, -1, 4)
        for points in (before, after)
    )
    q = known.shape[1]  # as many of 1, x, y, z
    shares = np.matmul(wanted[:, :, :q], np.linalg.inv(known[:, :, :q])[parents])
    carried = np.matmul(shares, values.reshape(len(known), q, -1)[parents])
    return carried.reshape(len(after), *values.shape[1:])


def interpolated(problem: Problem, value: CoefficientFunction) -> GridFunction:
    """The discontinuous polynomial with the values of a coefficient at the points of a problem."""
    points = Points(problem.mesh, problem.kinematics, problem.order)
    return PointFunctions(points).function(points.at(value))
