"""Bounds of the energy error of random problems beside energies on finer meshes."""

from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from campaigns.random_problems import Draw, build, draws

from ngepc import semismooth_newton
from ngepc.bounds.bound import ErrorBound, error_bound
from ngepc.bounds.transfer import bisected, on_mesh


@dataclass(frozen=True)
class Crossing:
    """A random problem's energies on two meshes.

    Parameters
    ----------
    draw
        The problem.
    bound, fine
        Bounds on its mesh and on one bisected everywhere several times.
    """

    draw: Draw
    bound: ErrorBound
    fine: ErrorBound

    @property
    def margin(self):
        """Energy on the fine mesh less the lower bound, in units of the bound: >= 0."""
        return (self.fine.energy - self.bound.least_energy) / self.bound.total

    @property
    def effectivity(self):
        """The bound over the largest error that the fine mesh allows."""
        return self.bound.total / (self.bound.energy - self.fine.least_energy)


def random_crossings(seed, count, bisections=3, dimension=2, order=1):
    """Random problems in two or three dimensions, each with its bound and a fine reference."""
    drawn = (d for d in draws(seed) if (d.body == "cube") == (dimension == 3))
    for draw in islice(drawn, count):
        problem = replace(build(draw), order=order)
        bound = error_bound(semismooth_newton(problem))
        yield Crossing(draw, bound, error_bound(semismooth_newton(finer(problem, bisections))))


def finer(problem, bisections):
    """The problem on a mesh all of whose elements are bisected several times."""
    mesh = problem.mesh
    for _ in range(bisections):
        mesh = bisected(mesh, np.ones(mesh.ne, dtype=bool))
    return on_mesh(problem, mesh)
