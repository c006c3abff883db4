"""Limit loads of random bodies: a lower bound above an upper one would be a counterexample."""

import math
from dataclasses import dataclass

from campaigns.random_limits import problem

from ngepc.limit.bisection import split_corners
from ngepc.limit.bracket import bracket_on
from ngepc.limit.reading import growing_names, limit_data
from ngepc.limit.yielding import SHAPES
from ngepc.studies.work import Work


@dataclass(eq=False)
class Limits(Work):
    """Brackets of random bodies on one mesh, with corners cut and velocities of degree three."""

    count: int = 200
    seed: int = 0

    name = "limits"
    title = "Limit loads of random bodies"
    columns = """seed = {number} | elements = {elements} | lower = {lower:.5g}
        | upper = {upper:.5g} | solver = {words}"""

    def cells(self):
        return [{"number": self.seed + k} for k in range(self.count)]

    def solve(self, number):
        body, growing = problem(number)
        data, _ = limit_data(body, growing_names(body, growing)).without_units()
        data = data.on(*split_corners(data))
        found, _ = bracket_on(data, SHAPES["plane strain"], None, within=math.inf)
        numbers = {"lower": found.lower, "upper": found.upper}
        return {**numbers, "elements": body.mesh.ne, "words": "/".join(found.words)}

    def succeeded(self, records):
        return all(record["lower"] <= record["upper"] for record in records)

    def notes(self, records):
        crossed = sum(record["lower"] > record["upper"] for record in records)
        return [f"{len(records)} bodies; lower above upper: {crossed}."]
