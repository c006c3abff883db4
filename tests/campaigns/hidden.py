"""Loads and obstacles that rules miss: energies beside the lower bounds that are claimed.

Strips, spots, steps, wedges and spikes down to a fiftieth of a cell in the plane and a tenth in
space.  For reference the mesh is bisected where the data vary; an energy there below the lower
bound of the coarse mesh would be a counterexample.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import BND, CF, VOL, IfPos, Mesh, sqrt, x, y, z

from ngepc import Material, Problem, error_bound, semismooth_newton
from ngepc.bounds.transfer import bisected
from ngepc.discretisation.sampling import Scan
from ngepc.geometries import block
from ngepc.model.elements import cells_of, element_facets, facet_keys
from ngepc.studies.work import Work

SHAPES = ("strip", "spot", "step", "wedge", "spike")
PLACES = ("body_force", "traction", "gap")
NARROWEST = {2: 1 / 50, 3: 1 / 10}
"""The narrowest features, in edges of a cell."""
CELL = {2: (0.25, 0.6), 3: (0.5, 0.9)}
"""Mesh widths that are drawn."""
BISECTIONS = {2: 6, 3: 2}
"""How often elements are bisected for the reference where data vary."""
MOST = {2: 150, 3: 150}
"""No more elements for the reference."""
HEAD = ("group", "problems", "refused", "complaints", "least margin",
        "median bound / error")  # fmt: skip


def size_of(value):
    """|value|, as a coefficient."""
    return sqrt(value * value)


def feature(shape, at, width, N, angle):
    """A coefficient between 0 and 1 that is not zero within a width only."""
    along = math.cos(angle) * (x - at[0]) + math.sin(angle) * (y - at[1])
    radius = sqrt(sum((c - a) ** 2 for c, a in zip((x, y, z)[:N], at, strict=True)))
    return {
        "strip": IfPos(width / 2 - size_of(along), 1.0, 0.0),
        "spot": IfPos(width / 2 - radius, 1.0, 0.0),
        "step": IfPos(along, 1.0, 0.0),
        "wedge": IfPos(width / 2 - size_of(along), 0.5 + along / width, 0.0),
        "spike": IfPos(width / 2 - radius, 1 - 2 * radius / width, 0.0),
    }[shape]


def hidden_problem(seed, number):
    """A random problem with something narrow in one of its data, and what that is."""
    rng = np.random.default_rng([seed, number])
    N = 3 if number % 4 == 0 else 2
    shape = SHAPES[rng.integers(len(SHAPES))]
    place = PLACES[number % len(PLACES)]
    maxh = rng.uniform(*CELL[N])
    mesh = block.mesh(maxh, (1.0, 0.7, 0.8)[:N])
    width = maxh * NARROWEST[N] * 10 ** rng.uniform(0, 1)
    at = rng.uniform(0.1, 0.6, N)
    if place != "body_force":
        at[-1] = (1.0, 0.7, 0.8)[N - 1]  # on the top, which is named contact
    angle = 0.0 if place != "body_force" else rng.uniform(0, math.pi)
    strong = 10 ** rng.uniform(-0.5, 1.5) * rng.choice([-1.0, 1.0])
    narrow = feature(shape, at, width, N, angle)
    material = Material.kinematic(
        lame_lambda=1e3,
        lame_mu=1e3,
        yield_stress=5.0,
        hardening=10 ** rng.uniform(1.5, 3),
    )
    order = 1 if N == 3 else int(rng.integers(1, 3))
    direction = rng.normal(size=N)
    if place == "gap":
        rise = 0.02 * 10 ** rng.uniform(-1, 0)
        data = {"contact": "contact", "gap": 0.01 * rng.uniform() - rise * narrow}
    else:
        load = tuple(CF(strong * float(d)) * narrow for d in direction)
        value = {"contact": load} if place == "traction" else load
        data = {place: value}
        if rng.uniform() < 0.5 and place == "body_force":
            data["traction"] = {"contact": tuple(rng.normal(size=N).tolist())}
    kind = f"{place}, {'space' if N == 3 else 'plane'}"
    return Problem(mesh, material, order=order, **data), kind, shape


def varying(problem):
    """The elements where data vary, and those beside facets where they do."""
    mesh = problem.mesh
    marks = np.zeros(mesh.ne, dtype=bool)
    if problem.f is not None:
        marks[Scan(mesh, problem.f, VOL).hidden] = True
    nodes, region = cells_of(mesh, mesh.dim - 1)
    keys, elements = element_facets(mesh)
    for name, value in [*problem.tractions.items(), *problem.gaps.items()]:
        on = np.array(mesh.Boundaries(name).Mask(), dtype=bool)[region]
        hidden = Scan(mesh, value, BND, on).hidden
        corners = nodes[hidden][:, : mesh.dim]
        there = np.searchsorted(keys, facet_keys(corners, mesh))
        marks[elements[there]] = True
    return marks


def reference(problem):
    """The same problem with order two where it can be, bisected where the data vary."""
    mesh = Mesh(problem.mesh.ngmesh.Copy())
    fine = replace(problem, mesh=mesh)
    for _ in range(BISECTIONS[problem.N]):
        marks = varying(fine)
        if not marks.any() or mesh.ne > MOST[problem.N]:
            break
        mesh = bisected(mesh, marks)[0]
        fine = replace(fine, mesh=mesh)
    order = 2 if problem.N == 2 else 1
    return replace(problem, mesh=mesh, order=order)


@dataclass(eq=False)
class Hidden(Work):
    """The campaign: ``count`` random problems, kept one by one.

    Parameters
    ----------
    count, seed
        How many problems, and the seed of their sequence.
    """

    count: int = 400
    seed: int = 1

    name, title = "hidden", "Loads and obstacles that rules miss"
    columns = " | ".join([" = {group}", *(f"{head} = {{{head}}}" for head in HEAD[1:])])

    def cells(self):
        """The problems by number."""
        return [{"seed": self.seed, "number": n} for n in range(1, self.count + 1)]

    def solve(self, seed, number):
        """The verdict on one problem."""
        problem, kind, shape = hidden_problem(seed, number)
        found = {"kind": kind, "shape": shape, "refused": "", "complaint": ""}
        found |= {"margin": math.nan, "effectivity": math.nan}
        result = semismooth_newton(problem)
        try:
            bound = error_bound(result)
        except ValueError as error:
            return found | {"refused": str(error)}
        if bound.guaranteed:
            return found | {"complaint": "claimed to be a proof"}
        fine = semismooth_newton(reference(problem))
        energy = fine.primal_energy
        if problem.contact_names:  # moved clear of the obstacle
            energy = error_bound(fine).energy
        scale = bound.total if bound.total > 0 else 1.0
        above = energy - bound.least_energy
        found["margin"] = above / scale
        error = bound.energy - energy
        found["effectivity"] = bound.total / error if error > 0 else math.nan
        if above < -1e-9 * abs(energy):
            found["complaint"] = f"energies cross by {-above / scale:.3g} of the bound"
        return found

    def line(self, record):
        """One line about a problem."""
        return (
            f"{record['number']} {record['kind']}, {record['shape']}: margin "
            f"{record['margin']:.3g}  {record['refused']}{record['complaint']}"
        )

    def told(self, records):
        """A row for each kind."""
        kinds = sorted({r["kind"] for r in records})
        rows = [_row(kind, [r for r in records if r["kind"] == kind]) for kind in kinds]
        return [dict(zip(HEAD, row, strict=True)) for row in rows]

    def notes(self, records):
        """What was drawn, and the complaints."""
        wrong = [
            f"- {r['number']}, {r['kind']}, {r['shape']}: {r['complaint']}{r['refused']}"
            for r in records
            if r["complaint"] or r["refused"]
        ]
        return [
            f"Strips, spots, steps, wedges and spikes of `tests/campaigns/hidden.py`, seed "
            f"{self.seed}, down to a fiftieth of a mesh width in the plane and a tenth in space. "
            "For reference meshes are bisected where data vary. Margin: how far the energy "
            "there is above the lower bound, in units of the bound. Error: what J falls by.",
            *wrong,
        ]


def _row(kind, group):
    judged = [r for r in group if not math.isnan(r["margin"])]
    ratios = [r["effectivity"] for r in judged if not math.isnan(r["effectivity"])]
    return [
        kind,
        len(group),
        sum(bool(r["refused"]) for r in group),
        sum(bool(r["complaint"]) for r in group),
        f"{min((r['margin'] for r in judged), default=math.nan):.2g}",
        f"{np.median(ratios or [math.nan]):.2f}",
    ]
