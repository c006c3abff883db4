"""Loads and supports of a problem on the displacement space.

Nodal arrays have shape (nodes, N): one row for each degree of freedom of a displacement component.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from ngsolve import (
    BND,
    CoefficientFunction,
    FESpace,
    GridFunction,
    InnerProduct,
    LinearForm,
    ds,
    dx,
)
from ngsolve.comp import ProxyFunction

from ngepc.discretisation.spaces import displacement_space, prescribed_displacement
from ngepc.model.problem import Problem

BONUS_ORDER = 3
"""Order by which the rules of loads exceed that of the displacements."""


def external_work(problem: Problem, v: CoefficientFunction | ProxyFunction) -> list:
    """The integrals of int_Gn g . v + int f . v, with points for loads that vary."""
    return work_of(problem, v, problem.tractions, problem.f)


def work_of(
    problem: Problem,
    v: CoefficientFunction | ProxyFunction,
    tractions: Mapping[str, CoefficientFunction],
    f: CoefficientFunction | None,
) -> list:
    """The integrals of other loads on the body of a problem."""
    weight = problem.kinematics.weight
    work = [
        weight * InnerProduct(g, v) * ds(name, bonus_intorder=BONUS_ORDER)
        for name, g in tractions.items()
    ]
    if f is not None:
        work.append(weight * InnerProduct(f, v) * dx(bonus_intorder=BONUS_ORDER))
    return work


def nodal(vector: np.ndarray, problem: Problem) -> np.ndarray:
    """Coefficients of the displacement space, component by component, as (nodes, N)."""
    return vector.reshape(problem.N, -1).T


def applied_forces(problem: Problem, V: FESpace) -> np.ndarray:
    """Nodal forces of tractions and body force, shape (nodes, N)."""
    return forces_of(problem, V, problem.tractions, problem.f)


def forces_of(
    problem: Problem,
    V: FESpace,
    tractions: Mapping[str, CoefficientFunction],
    f: CoefficientFunction | None,
) -> np.ndarray:
    """Nodal forces of other loads on the body of a problem, shape (nodes, N)."""
    load = LinearForm(V)
    for term in work_of(problem, V.TestFunction(), tractions, f):
        load += term
    return nodal(load.Assemble().vec.FV().NumPy(), problem).copy()


class Supports:
    """What holds the body.

    Parameters
    ----------
    problem
        Data of the time step.

    Attributes
    ----------
    space
        ``displacement_space(problem)``.
    free
        Boolean, shape (nodes, N): components that no support holds.
    values
        Prescribed displacements, zero elsewhere, shape (nodes, N).
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.space = problem, displacement_space(problem)
        self.free = nodal(np.array(list(self.space.FreeDofs()), dtype=bool), problem).copy()
        lift = prescribed_displacement(problem, self.space)
        self.values = nodal(lift.vec.FV().NumPy(), problem).copy()
        if problem.kinematics.hoop:
            self.free[_on_axis(problem, self.space), 0] = False

    def function(self, u: np.ndarray, name: str = "displacement") -> GridFunction:
        """The displacement with these nodal values."""
        result = GridFunction(self.space, name=name)
        result.vec.FV().NumPy()[:] = u.T.ravel()
        return result


def _on_axis(problem: Problem, V: FESpace) -> list[int]:
    """Nodes on the axis of revolution, where the radial displacement vanishes."""
    radii = np.asarray(problem.mesh.ngmesh.Coordinates())[: problem.mesh.nv, 0]
    there = np.abs(radii) <= 1e-12 * np.abs(radii).max()
    component = V.components[0]
    nodes = set(np.flatnonzero(there).tolist())
    for facet in problem.mesh.Elements(BND):
        if all(there[vertex.nr] for vertex in facet.vertices):
            nodes |= set(component.GetDofNrs(facet))
    return sorted(nodes)
