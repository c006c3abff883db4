"""Guaranteed bounds measured: effectivities, adaptive meshes, random problems."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice

import numpy as np
from ngsolve import Mesh

from ngepc.bounds.adaptive import MeshRecord, Refinement, solve_to
from ngepc.bounds.bound import ErrorBound, error_bound
from ngepc.bounds.transfer import bisected, on_mesh
from ngepc.dual.newton import semismooth_newton
from ngepc.model.problem import Problem
from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.verification.random_problems import Draw, build, draws
from ngepc.studies.work import Cell, Outcome, Work, first_of

LIMITS = {"lshape": -0.3752486, "wrench": -0.0023607}
"""Energies of Examples (a) and (b), seven digits.

``solve_to`` on 72,129 and 62,717 nodes leaves -0.3752490 to -0.3752313 and -0.00236074 to
-0.00235969; the lower bounds extrapolated.
"""


@dataclass(frozen=True)
class Effectivity:
    """A bound beside the error.

    Parameters
    ----------
    nodes
        Vertices of the mesh.
    error, bound, effectivity
        J - inf J, the bound, and their quotient.
    relative
        The bound over the strain energy.
    steps, seconds, bound_seconds
        Newton steps, and CPU seconds for them and for the bound.
    """

    nodes: int
    error: float
    bound: float
    effectivity: float
    relative: float
    steps: int
    seconds: float
    bound_seconds: float


def uniform_effectivities(name: str, family: list[int]) -> list[Effectivity]:
    """The table of bounds on uniform meshes of "lshape" or "wrench"."""
    return [_measured(example(name, nodes), LIMITS[name]) for nodes in family]


def _measured(problem: Problem, limit: float) -> Effectivity:
    start = time.process_time()
    result = semismooth_newton(problem)
    solved = time.process_time()
    bound = error_bound(result)
    end, error = time.process_time(), bound.energy - limit
    return Effectivity(
        problem.mesh.nv,
        error,
        bound.total,
        bound.total / error,
        bound.relative,
        result.iterations,
        solved - start,
        end - solved,
    )


def adaptive_effectivities(
    name: str, start: int, relative_error: float, max_nodes: int
) -> list[tuple[MeshRecord, float, float]]:
    """Records of ``solve_to`` on "lshape" or "wrench", each with the true error and CPU seconds."""
    rows, begun = [], time.process_time()

    def note(record: MeshRecord) -> None:
        rows.append((record, record.energy - LIMITS[name], time.process_time() - begun))

    solve_to(example(name, start), relative_error, Refinement(max_nodes=max_nodes), note)
    return rows


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
    def margin(self) -> float:
        """Energy on the fine mesh less the lower bound, in units of the bound: >= 0."""
        return (self.fine.energy - self.bound.least_energy) / self.bound.total

    @property
    def effectivity(self) -> float:
        """The bound over the largest error that the fine mesh allows."""
        return self.bound.total / (self.bound.energy - self.fine.least_energy)


def random_crossings(
    seed: int, count: int, bisections: int = 3, dimension: int = 2
) -> Iterator[Crossing]:
    """Random problems in two or three dimensions, each with its bound and a fine reference."""
    drawn = (d for d in draws(seed) if (d.body == "cube") == (dimension == 3))
    for draw in islice(drawn, count):
        problem = build(draw)
        bound = error_bound(semismooth_newton(problem))
        yield Crossing(draw, bound, error_bound(semismooth_newton(finer(problem, bisections))))


def finer(problem: Problem, bisections: int) -> Problem:
    """The problem on a mesh all of whose elements are bisected several times."""
    mesh: Mesh = problem.mesh
    for _ in range(bisections):
        mesh = bisected(mesh, np.ones(mesh.ne, dtype=bool))
    return on_mesh(problem, mesh)


@dataclass(eq=False)
class Bounds(Work):
    """The study: bounds on the paper's meshes beside the error.

    Parameters
    ----------
    levels
        Meshes of each family.
    """

    levels: int = 3

    name = "bounds"
    title = "Guaranteed bounds of the energy error"
    head = ("example", "nodes", "energy error", "bound", "bound / error", "of the strain energy",
            "Newton steps", "CPU s", "bound, CPU s")  # fmt: skip

    def cells(self) -> list[Cell]:
        """Both examples on their families of meshes."""
        return [Cell(name, n) for name in LIMITS for n in first_of(FAMILIES[name], self.levels)]

    def solve(self, cell: Cell) -> Outcome:
        """One mesh."""
        (found,) = uniform_effectivities(cell.row, [cell.nodes])
        return Outcome({"example": cell.row, **asdict(found)})

    def line(self, r: dict) -> str:
        """Effectivity and size."""
        return f"{r['example']} {r['nodes']} nodes: bound / error {r['effectivity']:.3f}"

    def row(self, r: dict) -> list[str]:
        """The entries."""
        return [
            *(r["example"], f"{r['nodes']}", f"{r['error']:.3g}", f"{r['bound']:.3g}"),
            *(f"{r['effectivity']:.3f}", f"{100 * r['relative']:.2g} percent", f"{r['steps']}"),
            *(f"{r['seconds']:.2f}", f"{r['bound_seconds']:.2f}"),
        ]

    def notes(self, records: Sequence[dict]) -> list[str]:
        """Where the errors come from."""
        return [
            f"Errors are J + {-limit:g} for {name}: see LIMITS." for name, limit in LIMITS.items()
        ]
