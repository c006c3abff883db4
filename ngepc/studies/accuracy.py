"""Time to a given accuracy of a number, by default options, compared with CalculiX.

Each problem has one number of interest: a limit load, a force, a deflection.  Each program solves
it on a sequence of meshes.  The table has the processor time (one thread) at which the error of the
number falls to 5 and to 1 percent, interpolated between meshes in logarithms.  ngepc runs with all
its defaults.  CalculiX has the elements that its manual recommends, increments of its own choice,
and isotropic hardening.  Times of ngepc do not include the generation of the mesh; those of
CalculiX are the whole run of ``ccx``.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from netgen.geom2d import Circle, CSG2d, EdgeInfo, Solid2d
from netgen.occ import OCCGeometry
from ngsolve import CoefficientFunction, Mesh, sqrt, x, y
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngepc.geometries.published import half_block, polygon
from ngepc.local.pyamg import PyAMG
from ngepc.methods.newton import semismooth_newton
from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.results.result import Result
from ngepc.studies import calculix
from ngepc.studies.calculix import Deck, QuadraticMesh
from ngepc.studies.solid_problems import metal
from ngepc.studies.work import OverMeshes

SMALL = 1e-5
"""Hardening over shear modulus, used instead of zero."""

Number = Callable[[Result], float]


@dataclass(frozen=True)
class Metal:
    """Uniaxial data of a metal with isotropic hardening, for both programs."""

    young: float
    poisson: float
    yield_stress: float
    modulus: float

    @property
    def material(self) -> object:
        """The material of ngepc."""
        data = self.young, self.poisson, self.yield_stress
        return metal(*data, isotropic=self.modulus)


SOFT = Metal(1e3, 0.3, math.sqrt(3), 1.5 * SMALL * 1e3 / 2.6)
ALUMINIUM = Metal(70.0, 1 / 3, 0.243, 0.135)
HINGE = Metal(1e3, 0.3, 2.0, 1.5e-3 * 385)
SPHERE = Metal(2.5e3, 0.25, 0.5 * math.sqrt(1.5), 150.0)

STEEL = Metal(210e3, 0.3, 200.0, 12e3)


@dataclass(frozen=True)
class Rigid:
    """A rigid disc or sphere above a flat boundary, as a layer of stiff elements for CalculiX.

    ``axis`` and ``top`` are the coordinates of the point that it would touch first, ``depth`` is
    how deep it is pressed in; the layer has so many ``cells`` over the ``span`` of each horizontal
    coordinate, and facets below ``reach`` may touch it.
    """

    radius: float
    depth: float
    axis: float
    top: float
    span: tuple[float, float]
    reach: float
    cells: int

    @property
    def gap(self) -> CoefficientFunction:
        """The vertical gap, for ngepc."""
        away = x - self.axis
        square = away * away if self.axis else x * x + y * y
        return self.radius - sqrt(self.radius**2 - square) - self.depth

    def height(self, square: np.ndarray) -> np.ndarray:
        """Height of the undeformed surface at squared distances from the axis."""
        return self.top + self.radius - np.sqrt(self.radius**2 - square)


SPHERICAL = Rigid(10.0, 3e-3, 0.0, 1.0, (-0.015, 0.36), 0.36, 24)
PUNCH = Rigid(25.0, 0.2, 30.0, 40.0, (19.5, 40.5), 41.0, 160)
"""The metals of the block and of the first lecture."""


@dataclass(frozen=True)
class Case:
    """A problem with one number of interest, on a family of meshes.

    ``mesh(level, simplices)`` generates a mesh; ``loads`` are fields of ``Problem``; ``printed`` is
    the number that CalculiX prints: ("force", boundary, component, factor) or ("displacement",
    point, component, factor); ``levels`` are the numbers of meshes of simplices, and of
    quadrilaterals or hexahedra.
    """

    mesh: Callable[[int, bool], Mesh]
    metal: Metal
    loads: dict
    number: Number
    printed: tuple[str, object, int, float]
    levels: tuple[int, int]
    reference: float | None = None
    rigid: Rigid | None = None

    def problem(self, level: int, simplices: bool = True) -> Problem:
        """The problem of ngepc, with all defaults."""
        mesh = self.mesh(level, simplices)
        return Problem(mesh, self.metal.material, **self.loads)


def half_block_mesh(level: int, simplices: bool) -> Mesh:
    """Half a block below a rough punch."""
    fine = 0.24 / 2**level
    return half_block(6, 4, 1.0, fine, min(8 * fine, 1.5))


def membrane(level: int, simplices: bool) -> Mesh:
    """Cook's membrane."""
    n = 4 * 2**level
    return MakeStructured2DMesh(
        nx=n,
        ny=n,
        quads=not simplices,
        mapping=lambda s, t: (48 * s, 44 * s + t * (44 - 28 * s)),
    )


def notched(level: int, simplices: bool) -> Mesh:
    """A quarter of a strip with two notches."""
    fine = 0.12 / 2**level
    face = polygon([(0, 0), (0.5, 0), (1, 0), (1, 2), (0, 2)])
    for edge in face.edges:
        c = edge.center
        edge.name = "free"
        if abs(c.y) < 1e-9 and c.x < 0.5:
            edge.name = "ligament"
            edge.maxh = fine
        elif abs(c.y - 2) < 1e-9:
            edge.name = "top"
        elif abs(c.x) < 1e-9:
            edge.name = "axis"
    geometry = OCCGeometry(face, dim=2)
    return Mesh(geometry.GenerateMesh(maxh=min(4 * fine, 0.5), grading=0.2))


def beam(level: int, simplices: bool) -> Mesh:
    """A beam 6 x 1 x 1."""
    n = 2**level
    return MakeStructured3DMesh(
        hexes=not simplices, nx=4 * n, ny=n, nz=n, mapping=lambda s, t, u: (6 * s, t, u)
    )


def quarter_block(level: int, simplices: bool) -> Mesh:
    """A quarter of a block, fine below the point where the sphere touches."""
    n = 2 * (level + 1)

    def graded(s: float) -> float:
        """A coordinate that grades the mesh towards zero."""
        return s * (0.35 + 0.65 * s)

    return MakeStructured3DMesh(
        hexes=not simplices,
        nx=n,
        ny=n,
        nz=int(1.5 * n),
        mapping=lambda s, t, u: (0.5 * graded(s), 0.5 * graded(t), 1 - graded(1 - u)),
    )


def first_block(level: int, simplices: bool) -> Mesh:
    """The block with a hole of the page on first steps (mm)."""
    coarse = 8.0 / 2**level
    corners = ((0, 0), (60, 0), (60, 40), (40, 40), (20, 40), (0, 40))
    sides = [EdgeInfo(bc="free") for _ in corners]
    sides[0] = EdgeInfo(bc="clamped")
    sides[3] = EdgeInfo(bc="contact", maxh=coarse / 4)
    outline = zip(corners, sides, strict=True)
    block = Solid2d([item for corner in outline for item in corner], mat="body")
    body = CSG2d()
    body.Add(block - Circle((30, 18), radius=8, bc="hole"))
    return Mesh(body.GenerateMesh(maxh=coarse))


def force_on(boundary: str, component: int, factor: float) -> Number:
    """The reaction of a boundary, times a factor."""
    return lambda result: (
        factor * float(result.equilibrium.reactions[boundary][component])
    )


def corner_deflection(result: Result) -> float:
    """The displacement of the upper right corner of the membrane."""
    return float(result.displacement(result.problem.mesh(48 - 1e-9, 60 - 1e-6))[1])


CASES = {
    "Prandtl's punch": Case(
        half_block_mesh,
        SOFT,
        {
            "clamped": None,
            "prescribed": {
                "contact": (0, -0.1),
                "symmetry": (0, None),
                "bottom|right": (0, 0),
            },
        },
        force_on("contact", 1, -1.0),
        ("force", "contact", 1, -1.0),
        (5, 0),
        2 + math.pi,
    ),
    "Cook's membrane": Case(
        membrane,
        ALUMINIUM,
        {"clamped": "left", "traction": {"right": (0, 1.8 / 16)}},
        corner_deflection,
        ("displacement", (48, 60), 1, 1.0),
        (5, 5),
    ),
    "notched tension": Case(
        notched,
        SOFT,
        {
            "clamped": None,
            "prescribed": {
                "ligament": (None, 0),
                "axis": (0, None),
                "top": (None, 0.03),
            },
        },
        force_on("top", 1, 1.0),
        ("force", "top", 1, 1.0),
        (5, 0),
    ),
    "plastic hinge, 3D": Case(
        beam,
        HINGE,
        {"clamped": "back", "prescribed": {"front": (None, None, -0.3)}},
        force_on("front", 2, -1.0),
        ("force", "front", 2, -1.0),
        (3, 3),
    ),
    "sphere on a block, 3D": Case(
        quarter_block,
        SPHERE,
        {
            "clamped": "bottom",
            "prescribed": {"back": (0, None, None), "left": (None, 0, None)},
            "contact": "top",
            "gap": SPHERICAL.gap,
        },
        lambda result: 4 * result.contact_force,
        ("force", "bottom", 2, 4.0),
        (4, 4),
        rigid=SPHERICAL,
    ),
    "first steps, punch": Case(
        first_block,
        STEEL,
        {"clamped": "clamped", "contact": "contact", "gap": PUNCH.gap},
        lambda result: result.contact_force,
        ("force", "clamped", 1, 1.0),
        (4, 0),
        rigid=PUNCH,
    ),
}
"""Name -> case."""

PROGRAMS = (
    "default",
    "default, bricks",
    "order 1",
    "order 2, direct",
    "order 2, PyAMG",
    "ccx",
    "ccx, bricks",
)
"""ngepc by default and by own choices; CalculiX on the same meshes; both on those of bricks."""

BRICKS = ", bricks"


def deck_of(case: Case, mesh: Mesh) -> Deck:
    """A case as an input file of CalculiX with quadratic elements."""
    body = QuadraticMesh(mesh)
    plane = mesh.dim == 2
    deck = Deck()
    deck.mesh(body.points, body.elements, calculix.KINDS[body.shape], "BODY")
    m = case.metal
    plastic = calculix.plastic_lines(m.yield_stress, m.modulus)
    deck.material("METAL", m.young, m.poisson, *plastic)
    deck.section("BODY", "METAL", plane)
    held = held_lines(case, body, deck)
    moved = []
    if "contact" in case.loads:
        moved = rigid_layer(case, body, deck)
    deck.add("*BOUNDARY", *[line for line, value in held if value == 0])
    if moved:
        deck.add(*moved[:-1])
    deck.add("*STEP,INC=1000", "*STATIC", "1.,1.")
    prescribed = [line for line, value in held if value != 0] + moved[-1:]
    if prescribed:
        deck.add("*BOUNDARY", *prescribed)
    loads = traction_lines(case, body)
    if loads:
        deck.add("*CLOAD", *loads)
    printed(case, body, deck)
    deck.add("*END STEP")
    return deck


def held_lines(case: Case, body: QuadraticMesh, deck: Deck) -> list[tuple[str, float]]:
    """Lines of *BOUNDARY with prescribed values; adds the node sets to the deck."""
    held = dict(case.loads.get("prescribed") or {})
    clamped = case.loads["clamped"]
    if clamped:
        held[clamped] = (0,) * body.points.shape[1]
    lines = []
    for number, (names, components) in enumerate(held.items()):
        nodes = [body.nodes_on(name) for name in names.split("|")]
        deck.node_set(f"HELD{number}", np.unique(np.concatenate(nodes)))
        for axis, value in enumerate(components, 1):
            if value is not None:
                line = f"HELD{number},{axis},{axis},{value:.12g}"
                lines.append((line, value))
    return lines


def traction_lines(case: Case, body: QuadraticMesh) -> list[str]:
    """Nodal forces of constant tractions on straight quadratic edges: 1/6, 4/6, 1/6."""
    lines = []
    for name, traction in case.loads.get("traction", {}).items():
        loaded = [(axis, value) for axis, value in enumerate(traction, 1) if value]
        for a, b, middle, length in body.edges_on(name):
            for node, share in ((a, 1 / 6), (b, 1 / 6), (middle, 4 / 6)):
                for axis, value in loaded:
                    force = share * length * value
                    lines.append(f"{node + 1},{axis},{force:.12g}")
    return lines


def rigid_layer(case: Case, body: QuadraticMesh, deck: Deck) -> list[str]:
    """Add a layer of stiff elements with the shape of the rigid surface, and contact with it.

    Returns lines of *BOUNDARY; the last one is that of the step.  The contact stiffness is 50 times
    Young's modulus: larger ones change the force by less than a percent.
    """
    rigid = case.rigid
    plane = body.points.shape[1] == 2
    below, corners = curve_of(rigid) if plane else surface_of(rigid)
    above = below.copy()
    above[:, -1] = below[:, -1].max() + 0.1 * (rigid.span[1] - rigid.span[0])
    layers = [corners, corners + len(below)]
    if plane:
        layers[1] = layers[1][:, ::-1]  # around the element

    first = deck.elements
    points = np.vstack([below, above])
    before = deck.mesh(points, np.hstack(layers), "CPE4" if plane else "C3D8", "RIGID")
    deck.node_set("RIGIDNODES", np.arange(before, before + len(points)))
    deck.surface("MASTER", [(first + k, 0) for k in range(len(corners))])
    near = [
        (element, face)
        for element, face in body.faces_on(case.loads["contact"])
        if within_reach(rigid, body, element, face)
    ]
    deck.surface("SLAVE", near)
    young = case.metal.young
    deck.material("STIFF", 10 * young, case.metal.poisson)
    deck.section("RIGID", "STIFF", plane)
    deck.add("*SURFACE INTERACTION,NAME=TOUCH")
    deck.add("*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR", f"{50 * young:.12g}")
    deck.add("*CONTACT PAIR,INTERACTION=TOUCH,TYPE=SURFACE TO SURFACE", "SLAVE,MASTER")
    up = 2 if plane else 3
    return [f"RIGIDNODES,1,{up - 1},0.", f"RIGIDNODES,{up},{up},{-rigid.depth:.12g}"]


def curve_of(rigid: Rigid) -> tuple[np.ndarray, np.ndarray]:
    """Points of a disc, and the two ends of each segment of its outline."""
    s = np.linspace(*rigid.span, rigid.cells + 1)
    points = np.column_stack([s, rigid.height((s - rigid.axis) ** 2)])
    number = np.arange(rigid.cells)
    return points, np.column_stack([number, number + 1])


def surface_of(rigid: Rigid) -> tuple[np.ndarray, np.ndarray]:
    """Points of a sphere, and the four corners of each face of its surface."""
    s = np.linspace(*rigid.span, rigid.cells + 1)
    X, Y = np.meshgrid(s, s, indexing="ij")
    points = np.stack([X, Y, rigid.height(X**2 + Y**2)], axis=-1).reshape(-1, 3)
    corner = np.arange((rigid.cells + 1) ** 2).reshape(rigid.cells + 1, -1)
    quads = [corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]]
    return points, np.stack(quads, axis=-1).reshape(-1, 4)


def within_reach(rigid: Rigid, body: QuadraticMesh, element: int, face: int) -> bool:
    """Whether a face lies below the rigid surface."""
    corners = body.corners[element, list(calculix.FACES[body.shape][face])]
    return bool(body.points[corners, :-1].max() < rigid.reach)


def printed(case: Case, body: QuadraticMesh, deck: Deck) -> None:
    """Lines of an input file that print the number of a case."""
    kind, where, _, _ = case.printed
    if kind == "force":
        deck.node_set("ASKED", body.nodes_on(where))
        deck.add("*NODE PRINT,NSET=ASKED,TOTALS=ONLY", "RF")
        return
    away = np.linalg.norm(body.points - np.array(where), axis=1)
    deck.node_set("ASKED", np.array([away.argmin()]))
    deck.add("*NODE PRINT,NSET=ASKED", "U")


def choice(program: str, problem: Problem) -> tuple[Problem, NewtonOptions]:
    """The problem and the options of a row of ngepc."""
    if program == "order 1":
        return replace(problem, order=1), NewtonOptions(inverse="sparsecholesky")
    if program == "order 2, direct":
        return replace(problem, order=2), NewtonOptions(inverse="sparsecholesky")
    if program == "order 2, PyAMG":
        return replace(problem, order=2), NewtonOptions(inverse=PyAMG())
    return problem, NewtonOptions()


def by_ngepc(case: Case, program: str, level: int) -> dict:
    """The number of a case by ngepc, and the cost without mesh generation."""
    mesh = case.mesh(level, not program.endswith(BRICKS))
    begin = time.process_time()
    problem = Problem(mesh, case.metal.material, **case.loads)
    problem, options = choice(program, problem)
    result = semismooth_newton(problem, options=options)
    value = case.number(result)
    spent = time.process_time() - begin
    return {
        "status": result.status.label,
        "value": value,
        "cpu": spent,
        "iterations": result.iterations,
    }


def by_calculix(case: Case, bricks: bool, level: int) -> dict:
    """The same by CalculiX."""
    deck = deck_of(case, case.mesh(level, not bricks))
    with tempfile.TemporaryDirectory() as folder:
        answer = calculix.run(deck, Path(folder))
    kind, _, component, factor = case.printed
    numbers = answer.force if kind == "force" else answer.displacement
    known = answer.finished and numbers is not None
    return {
        "status": "converged" if known else "failed",
        "value": factor * float(numbers[component]) if known else None,
        "cpu": answer.cpu,
        "iterations": answer.iterations,
    }


def time_to(errors: Sequence[float], times: Sequence[float], wanted: float) -> float:
    """The time from which on the error is at most ``wanted``; inf if there is none."""
    good = [error <= wanted for error in errors]
    first = len(good)
    while first > 0 and good[first - 1]:
        first -= 1
    if first == len(good):
        return math.inf
    if first == 0:
        return times[0]
    pair = slice(first - 1, first + 1)
    logs = np.log(np.maximum(errors[pair], 1e-12))[::-1]
    return float(np.exp(np.interp(math.log(wanted), logs, np.log(times[pair])[::-1])))


@dataclass(eq=False)
class Accuracy(OverMeshes):
    """All cases by all programs on at most ``levels`` meshes; each run measures again."""

    name = "accuracy"
    title = "Time to 5 and to 1 percent of the number that a user wants"
    keeps = False
    columns = """problem = {case} | program = {program} | CPU s to 5 % = {five}
        | to 1 % = {one} | finest error (%) = {finest:.2g} | steps there = {steps_there}"""
    note = (
        "CPU seconds of one thread; '-' where no mesh of the family reaches it. References: closed "
        "forms, else order 2 on one more mesh. 'default' is ngepc with all defaults."
    )

    def cells(self) -> list[dict]:
        """One cell for each case and program that can solve it."""
        found = []
        for case, data in CASES.items():
            for program in PROGRAMS:
                of_bricks = program.endswith(BRICKS)
                if program.startswith("ccx") and not calculix.available():
                    continue
                if not (of_bricks and data.levels[1] == 0):
                    found.append({"case": case, "program": program})
        return found

    def solve(self, case: str, program: str) -> dict:
        """The number on all meshes, its errors, and the times to 5 and 1 percent."""
        data = CASES[case]
        bricks = program.endswith(BRICKS)
        exact = reference(case)
        runs = []
        for level in range(min(self.levels, data.levels[bricks])):
            if program.startswith("ccx"):
                runs.append(by_calculix(data, bricks, level))
            else:
                runs.append(by_ngepc(data, program, level))
        good = [run for run in runs if run["value"] is not None]
        errors = [abs(run["value"] / exact - 1) for run in good]
        times = [run["cpu"] for run in good]
        return {
            "status": "converged",
            "reference": exact,
            "values": [run["value"] for run in good],
            "errors": errors,
            "cpu": times,
            "failed": len(runs) - len(good),
            "five": shown_time(time_to(errors, times, 0.05)),
            "one": shown_time(time_to(errors, times, 0.01)),
            "finest": 100 * errors[-1] if errors else math.nan,
            "steps_there": good[-1]["iterations"] if good else "",
        }

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Errors over times, one panel for each case."""
        names = list(dict.fromkeys(record["case"] for record in records))
        figure, panels = plt.subplots(
            1, len(names), figsize=(4 * len(names), 3.6), squeeze=False
        )
        for panel, name in zip(panels[0], names, strict=True):
            for record in records:
                if record["case"] == name:
                    error = 100 * np.array(record["errors"])
                    panel.loglog(record["cpu"], error, "o-", label=record["program"])
            panel.set_title(name)
            panel.set_xlabel("CPU seconds")
            panel.axhline(1, color="0.7", linewidth=0.8)
            panel.axhline(5, color="0.7", linewidth=0.8)
        panels[0][0].set_ylabel("error in percent")
        panels[0][-1].legend(fontsize=7)
        figure.tight_layout()
        path = self.folder / "accuracy.png"
        figure.savefig(path, dpi=130)
        plt.close(figure)
        return [path]


@cache
def reference(case: str) -> float:
    """The closed form, or the number of order 2 on one finer mesh."""
    data = CASES[case]
    if data.reference is not None:
        return data.reference
    return by_ngepc(data, "order 2, direct", data.levels[0])["value"]


def shown_time(seconds: float) -> str:
    """Seconds with two digits, '-' for never."""
    return f"{seconds:.2g}" if math.isfinite(seconds) else "-"
