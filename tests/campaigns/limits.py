"""Limit loads of random bodies: a lower bound above an upper one would be a counterexample.

An elastic-plastic run that hardens a little stands beside each bracket: displacements are small
below the lower bound and grow without bound above the upper one.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from campaigns.random_limits import problem, solid_problem
from ngsolve import CF, Mesh

from ngepc import semismooth_newton
from ngepc.limit.bisection import split_corners
from ngepc.limit.bracket import bracket_on
from ngepc.limit.reading import growing_names, limit_data
from ngepc.limit.yielding import SHAPES
from ngepc.studies.work import Work

HARDENING = 1e-2
"""Hardening modulus of the elastic-plastic runs; yield stresses are about one."""

BELOW = 0.9
BEYOND = 2.0
"""Loads of the runs over the lower and over the upper bound; meshes are coarse, and too stiff."""

COLLAPSES = 100.0
"""Smallest growth of the displacement from the one load to the other that counts as collapse."""

MAKERS = {2: problem, 3: solid_problem}


def displaced(body, names, factor):
    """The largest displacement of a body that hardens a little under a multiple of its loads."""
    loads = {
        name: CF(g) * (factor if name in names else 1.0)
        for name, g in body.traction.items()
    }
    weight = factor if "body_force" in names else 1.0
    loaded = body.changed(
        traction=loads,
        body_force=CF(body.body_force) * weight,
        material=replace(body.material, hardening=HARDENING),
        order=2,
    )
    result = semismooth_newton(loaded)
    return float(np.abs(np.array(result.displacement.vec)).max())


def displacements(body, names, lower, upper):
    """The largest displacements below and beyond the bounds.

    A body that does not collapse on its own mesh, where single elements may lock, gets a finer one.
    """
    below = displaced(body, names, BELOW * lower)
    beyond = displaced(body, names, BEYOND * upper)
    if beyond < COLLAPSES * below:
        body.mesh.ngmesh.Refine()
        finer = body.changed(mesh=Mesh(body.mesh.ngmesh))
        beyond = displaced(finer, names, BEYOND * upper)
    return {"below": below, "beyond": beyond}


@dataclass(eq=False)
class Limits(Work):
    """Brackets of random bodies on one mesh, with corners cut; in the plane of degree three."""

    count: int = 200
    solids: int = 40
    seed: int = 0

    name = "limits"
    title = "Limit loads of random bodies"
    columns = """dimensions = {N} | seed = {number} | elements = {elements}
        | lower = {lower:.5g} | upper = {upper:.5g}
        | displacement at 0.9 lower = {below:.2g} | at 2 upper = {beyond:.2g}
        | solver = {words}"""

    def cells(self):
        plane = [{"N": 2, "number": self.seed + k} for k in range(self.count)]
        return plane + [{"N": 3, "number": self.seed + k} for k in range(self.solids)]

    def solve(self, N, number):
        body, growing = MAKERS[N](number)
        names = growing_names(body, growing)
        elements = body.mesh.ne
        data, unit = limit_data(body, names).without_units()
        data = data.on(*split_corners(data))
        shape = SHAPES[body.kinematics.name]
        found, _ = bracket_on(data, shape, None, within=math.inf)
        lower = found.lower * unit
        upper = found.upper * unit
        numbers = {"lower": lower, "upper": upper}
        if lower > 0 and math.isfinite(upper):
            numbers |= displacements(body, names, lower, upper)
        return {**numbers, "elements": elements, "words": "/".join(found.words)}

    def succeeded(self, records):
        return not crossed(records) and not carried(records)

    def notes(self, records):
        widths = [
            (record["upper"] - record["lower"]) / record["lower"]
            for record in records
            if record["lower"] > 0
        ]
        runs = [record for record in records if "below" in record]
        return [
            f"{len(records)} bodies; lower above upper: {len(crossed(records))}.",
            f"(upper - lower) / lower on one coarse mesh: median {np.median(widths):.1%},"
            f" smallest {min(widths):.2%}.",
            f"Elastic-plastic runs that contradict the bounds: {len(carried(records))} of"
            f" {len(runs)}.",
        ]


def crossed(records):
    """Bodies with a lower bound above an upper one."""
    return [record for record in records if record["lower"] > record["upper"]]


def carried(records):
    """Bodies that do not collapse between both loads of their elastic-plastic runs."""
    return [
        record
        for record in records
        if "below" in record and record["beyond"] < COLLAPSES * record["below"]
    ]
