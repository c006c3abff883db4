"""Problems as decks for CalculiX (``ccx``), an independent program, and its results.

It covers only what the comparison needs: quadratic elements on straight meshes, isotropic
hardening, given displacements and tractions, and contact with a rigid surface that is a layer of
hexahedra.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from ngsolve import ET, VOL, Mesh

CORNER_EDGES = {
    ET.TRIG: ((0, 1), (1, 2), (2, 0)),
    ET.QUAD: ((0, 1), (1, 2), (2, 3), (3, 0)),
    ET.TET: ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    ET.HEX: (
        *((0, 1), (1, 2), (2, 3), (3, 0)),
        *((4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}
"""Corners of the edges, in CalculiX's order of midpoint nodes."""

FACES = {
    ET.TRIG: CORNER_EDGES[ET.TRIG],
    ET.QUAD: CORNER_EDGES[ET.QUAD],
    ET.TET: ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    ET.HEX: (
        *((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1)),
        *((1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    ),
}
"""Corners of the faces S1, S2, ... of elements."""

KINDS = {ET.TRIG: "CPE6", ET.QUAD: "CPE8R", ET.TET: "C3D10", ET.HEX: "C3D20R"}
"""The quadratic elements that CalculiX's manual recommends for plasticity."""

ROW = 12  # numbers on a line; CalculiX allows 16


def available() -> bool:
    """Whether the program ``ccx`` is installed."""
    return shutil.which("ccx") is not None


class QuadraticMesh:
    """Quadratic elements of one shape, with nodes at the midpoints of straight edges.

    ``points`` (nodes, N) has the vertices of the mesh first; ``elements`` are numbers of nodes.
    """

    def __init__(self, mesh: Mesh) -> None:
        vertices = np.array([v.point for v in mesh.vertices])
        elements = list(mesh.Elements(VOL))
        self.shape = elements[0].type
        corners = np.array([[v.nr for v in el.vertices] for el in elements])
        self.corners = oriented(vertices, corners, self.shape)
        edges = [self.corners[:, pair] for pair in np.array(CORNER_EDGES[self.shape])]
        pairs = np.sort(np.concatenate(edges), axis=1)
        self._pairs, number = np.unique(pairs, axis=0, return_inverse=True)
        middles = number.reshape(len(edges), -1).T + len(vertices)
        self.points = np.vstack([vertices, vertices[self._pairs].mean(axis=1)])
        self.elements = np.hstack([self.corners, middles])
        self._mesh = mesh
        self._vertices = len(vertices)

    def nodes_on(self, boundary: str) -> np.ndarray:
        """The nodes of a boundary, those in the middle of its edges included."""
        facets = self._mesh.Boundaries(boundary).Elements()
        found = set()
        for facet in facets:
            corners = sorted(v.nr for v in facet.vertices)
            found.update(corners)
            for a in corners:
                found.update(self.middle(a, b) for b in corners if a < b)
        return np.array(sorted(found - {-1}))

    def middle(self, a: int, b: int) -> int:
        """The midpoint node of the edge from a to b, a < b; -1 if there is no such edge."""
        key = self._pairs[:, 0] * self._vertices + self._pairs[:, 1]
        wanted = a * self._vertices + b
        at = int(np.searchsorted(key, wanted))
        there = at < len(key) and key[at] == wanted
        return self._vertices + at if there else -1

    def edges_on(self, boundary: str) -> list[tuple[int, int, int, float]]:
        """Vertices, node in the middle and length of the edges of a boundary in the plane."""
        found = []
        for facet in self._mesh.Boundaries(boundary).Elements():
            a, b = sorted(v.nr for v in facet.vertices)
            length = float(np.linalg.norm(self.points[a] - self.points[b]))
            found.append((a, b, self.middle(a, b), length))
        return found

    def faces_on(self, boundary: str) -> list[tuple[int, int]]:
        """Elements and local numbers of the faces of a boundary."""
        wanted = {
            tuple(sorted(v.nr for v in facet.vertices))
            for facet in self._mesh.Boundaries(boundary).Elements()
        }
        found = []
        for number, face in enumerate(FACES[self.shape]):
            keys = np.sort(self.corners[:, face], axis=1).tolist()
            found += [
                (el, number) for el, key in enumerate(keys) if tuple(key) in wanted
            ]
        return found


def oriented(points: np.ndarray, corners: np.ndarray, shape: ET) -> np.ndarray:
    """The corners of elements, ordered such that Jacobian determinants are positive."""
    beside = {ET.TRIG: [1, 2], ET.QUAD: [1, 3], ET.TET: [1, 2, 3], ET.HEX: [1, 3, 4]}
    turned = {
        ET.TRIG: [0, 2, 1],
        ET.QUAD: [0, 3, 2, 1],
        ET.TET: [0, 2, 1, 3],
        ET.HEX: [0, 3, 2, 1, 4, 7, 6, 5],
    }
    x = points[corners]
    wrong = np.linalg.det(x[:, beside[shape]] - x[:, :1]) < 0
    result = corners.copy()
    result[wrong] = corners[wrong][:, turned[shape]]
    return result


@dataclass
class Deck:
    """The lines of an input file; nodes and elements are counted from 1 there."""

    lines: list[str] = field(default_factory=list)
    nodes: int = 0
    elements: int = 0

    def add(self, *lines: str) -> None:
        """Add lines."""
        self.lines += lines

    def rows(self, entries: list[str]) -> None:
        """Add entries, some on each line."""
        for first in range(0, len(entries), ROW):
            more = "," if first + ROW < len(entries) else ""
            self.lines.append(",".join(entries[first : first + ROW]) + more)

    def mesh(
        self, points: np.ndarray, elements: np.ndarray, kind: str, name: str
    ) -> int:
        """Add nodes and elements; returns the number of nodes before."""
        before = self.nodes
        padded = np.zeros((len(points), 3))
        padded[:, : points.shape[1]] = points
        self.add("*NODE")
        for number, p in enumerate(padded, before + 1):
            self.add(f"{number},{p[0]:.12g},{p[1]:.12g},{p[2]:.12g}")
        self.add(f"*ELEMENT,TYPE={kind},ELSET={name}")
        for number, nodes in enumerate(elements, self.elements + 1):
            self.rows([str(number), *(str(before + k + 1) for k in nodes)])
        self.nodes += len(points)
        self.elements += len(elements)
        return before

    def node_set(self, name: str, nodes: np.ndarray) -> None:
        """Name some nodes."""
        self.add(f"*NSET,NSET={name}")
        entries = [str(int(node) + 1) for node in nodes]
        for first in range(0, len(entries), ROW):
            self.lines.append(",".join(entries[first : first + ROW]))

    def surface(self, name: str, faces: list[tuple[int, int]]) -> None:
        """Name faces of elements."""
        self.add(f"*SURFACE,NAME={name}")
        self.add(*[f"{element + 1},S{face + 1}" for element, face in faces])

    def material(self, name: str, young: float, poisson: float, *plastic: str) -> None:
        """An elastic material, with lines of ``*PLASTIC`` for a plastic one."""
        self.add(f"*MATERIAL,NAME={name}", "*ELASTIC", f"{young:.12g},{poisson:.12g}")
        self.add(*plastic)

    def section(self, name: str, material: str, plane: bool) -> None:
        """Give elements a material."""
        self.add(f"*SOLID SECTION,ELSET={name},MATERIAL={material}")
        if plane:
            self.add("1.")


def plastic_lines(yield_stress: float, modulus: float) -> tuple[str, ...]:
    """Linear isotropic hardening: lines (stress, plastic strain) up to a plastic strain of 2."""
    far = 2.0
    last = yield_stress + far * modulus
    return ("*PLASTIC", f"{yield_stress:.12g},0.", f"{last:.12g},{far}")


@dataclass(frozen=True)
class Answer:
    """The result of ``ccx``: total forces (steps, 3), the last displacement, and the cost."""

    finished: bool
    forces: np.ndarray
    displacement: np.ndarray | None
    cpu: float
    megabytes: float
    iterations: int

    @property
    def force(self) -> np.ndarray | None:
        """The last total force."""
        return self.forces[-1] if len(self.forces) else None


def run(deck: Deck, folder: Path, limit: int = 600) -> Answer:
    """Run ``ccx`` on one thread for at most ``limit`` seconds of processor time.

    Its files remain in ``folder``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "deck.inp").write_text("\n".join(deck.lines) + "\n")
    one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = os.environ | one | {"NUMBER_OF_CPUS": "1"}

    def limited() -> None:
        """Limit the processor time of the child."""
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))

    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            ["ccx", "deck"],
            cwd=folder,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            preexec_fn=limited,
        )
        _, _, usage = os.wait4(process.pid, 0)
    printed = (folder / "log").read_text(errors="replace")
    data = folder / "deck.dat"
    answers = data.read_text() if data.exists() else ""
    totals = re.findall(r"total force.*?\n\s*\n\s*([-\dE.+ ]+)\n", answers)
    moved = re.findall(r"displacements.*?\n\s*\n\s*\d+([-\dE.+ ]+)\n", answers)
    return Answer(
        finished="Job finished" in printed and "*ERROR" not in printed,
        forces=np.array([total.split() for total in totals], dtype=float),
        displacement=np.array(moved[-1].split(), dtype=float) if moved else None,
        cpu=usage.ru_utime + usage.ru_stime,
        megabytes=usage.ru_maxrss / 1024,
        iterations=len(re.findall(r"^ iteration\s+\d+", printed, re.MULTILINE)),
    )
