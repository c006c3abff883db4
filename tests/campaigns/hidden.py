"""Loads and obstacles that quadrature misses: energies compared with the lower bounds.

Strips, spots, steps, wedges and spikes down to a fiftieth of a cell in the plane and a tenth in
space, given as functions of position.  For reference the same problem is solved on a mesh that is
aligned with them, where they are polynomials on elements: bounds there are proved.  An energy
there below the lower bound of the coarse mesh, or a lower bound there above the energy of the
coarse mesh, would be a counterexample.
"""

import math
from dataclasses import dataclass

import numpy as np
from campaigns.narrow import DEGREE, SHAPES, SIDES, Feature, aligned_mesh, on_elements
from ngsolve import CF, CoefficientFunction

from ngepc import Material, Problem, error_bound, semismooth_newton
from ngepc.geometries import block
from ngepc.studies.work import Work

PLACES = ("body_force", "traction", "gap")
NARROWEST = {2: 1 / 50, 3: 1 / 10}
"""The narrowest features, in edges of a cell."""
CELL = {2: (0.25, 0.6), 3: (0.5, 0.9)}
"""Mesh widths that are drawn."""
WORST = 1e-9
ROUNDING = 1e-14
"""Tolerance of the comparison, relative to the energies and to the terms they are differences
of."""
HEAD = ("group", "problems", "refused", "failures", "least margin",
        "median bound / error")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Drawn:
    """A random problem with something narrow in one of its data.

    Parameters
    ----------
    number
        Which one it is of its sequence.
    feature, place
        What is narrow, and in which of ``PLACES``.
    maxh
        The mesh width of the coarse mesh.
    order
        Of the displacements there.
    hardening, direction, level
        The material's; the load where the feature is 1; the gap where it is 0.
    more
        Further arguments of ``Problem``, numbers.
    """

    number: int
    feature: Feature
    place: str
    maxh: float
    order: int
    hardening: float
    direction: tuple[float, ...]
    level: float
    more: dict

    @property
    def kind(self) -> str:
        """The group that it is counted in."""
        return f"{self.place}, {'space' if self.feature.N == 3 else 'plane'}"

    def problem(self) -> Problem:
        """The problem with the feature given as a function, on a mesh that is not aligned with
        it."""
        mesh = block.mesh(self.maxh, SIDES[: self.feature.N])
        return self._on(mesh, self.feature.value, self.order)

    def aligned(self) -> Problem:
        """The same problem on an aligned mesh, with polynomials on elements."""
        on_top = self.place != "body_force"
        mesh = aligned_mesh(self.feature, on_top)
        degree = 1 if self.place == "gap" else DEGREE
        narrow = on_elements(mesh, self.feature.value, on_top, degree)
        return self._on(mesh, narrow, 2 if self.feature.N == 2 else 1)

    def _on(self, mesh: object, narrow: CoefficientFunction, order: int) -> Problem:
        if self.place == "gap":
            gap = self.level - self.direction[0] * narrow
            data = {"contact": "contact", "gap": gap}
        else:
            load = tuple(CF(part) * narrow for part in self.direction)
            value = {"contact": load} if self.place == "traction" else load
            data = {self.place: value}
        material = Material.kinematic(
            lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=self.hardening
        )
        return Problem(mesh, material, order=order, **data, **self.more)


def drawn(seed, number):
    """A random problem; every fourth one is in space."""
    rng = np.random.default_rng([seed, number])
    N = 3 if number % 4 == 0 else 2
    shape = SHAPES[rng.integers(len(SHAPES))]
    place = PLACES[number % len(PLACES)]
    maxh = rng.uniform(*CELL[N])
    width = maxh * NARROWEST[N] * 10 ** rng.uniform(0, 1)
    at = rng.uniform(0.1, 0.6, N)
    turned = N == 2 and place == "body_force"
    angle = rng.uniform(0, math.pi) if turned else 0.0
    if place != "body_force":
        at[-1] = SIDES[N - 1]  # on the top, which is named contact
    feature = Feature(shape, tuple(at.tolist()), float(width), float(angle))
    strong = 10 ** rng.uniform(-0.5, 1.5) * rng.choice([-1.0, 1.0])
    direction = strong * rng.normal(size=N)
    level = 0.0
    if place == "gap":
        level = 0.01 * rng.uniform()
        direction = [0.02 * 10 ** rng.uniform(-1, 0)]
    more = {}
    if place == "body_force" and rng.uniform() < 0.5:
        more = {"traction": {"contact": tuple(rng.normal(size=N).tolist())}}
    return Drawn(
        number=number,
        feature=feature,
        place=place,
        maxh=float(maxh),
        order=1 if N == 3 else int(rng.integers(1, 3)),
        hardening=float(10 ** rng.uniform(1.5, 3)),
        direction=tuple(float(part) for part in direction),
        level=float(level),
        more=more,
    )


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

    name, title = "hidden", "Loads and obstacles that quadrature misses"
    columns = " | ".join([" = {group}", *(f"{head} = {{{head}}}" for head in HEAD[1:])])

    def cells(self):
        """The problems by number."""
        return [{"seed": self.seed, "number": n} for n in range(1, self.count + 1)]

    def solve(self, seed, number):
        """The verdict on one problem."""
        case = drawn(seed, number)
        found = {"kind": case.kind, "shape": case.feature.shape, "refused": ""}
        found |= {"failure": "", "margin": math.nan, "effectivity": math.nan}
        result = semismooth_newton(case.problem())
        try:
            bound = error_bound(result)
        except ValueError as error:
            return found | {"refused": str(error)}
        if bound.guaranteed != (case.place == "gap"):
            return found | {"failure": "wrong about being a proof"}
        proof = error_bound(semismooth_newton(case.aligned()))
        if not proof.guaranteed:
            return found | {"failure": "the reference is no proof"}
        return found | judged(bound, proof)

    def line(self, record):
        """One line about a problem."""
        return (
            f"{record['number']} {record['kind']}, {record['shape']}: margin "
            f"{record['margin']:.3g}  {record['refused']}{record['failure']}"
        )

    def table_rows(self, records):
        """A row for each kind."""
        kinds = sorted({r["kind"] for r in records})
        rows = [_row(kind, [r for r in records if r["kind"] == kind]) for kind in kinds]
        return [dict(zip(HEAD, row, strict=True)) for row in rows]

    def notes(self, records):
        """What was drawn, and the failures."""
        wrong = [
            f"- {r['number']}, {r['kind']}, {r['shape']}: {r['failure']}{r['refused']}"
            for r in records
            if r["failure"] or r["refused"]
        ]
        return [
            f"Strips, spots, steps, wedges and spikes of `tests/campaigns/hidden.py`, seed "
            f"{self.seed}, down to a fiftieth of a mesh width in the plane and a tenth in space. "
            "For reference the problem is solved on a mesh that is aligned with them, where the "
            "bounds of its energy are proved. Margin: how far the energy there is above the lower "
            "bound, in units of the bound. Error: the decrease of J. A failure is a problem where "
            "an energy is below the lower bound of the other mesh, or where the bound of the "
            "coarse mesh claims to be proved with a load (gaps are enclosed by their formulas).",
            *wrong,
        ]


def judged(bound, proof):
    """The margins of a bound compared with that on an aligned mesh, and what is wrong."""
    scale = bound.total if bound.total > 0 else 1.0
    above = proof.energy - bound.least_energy
    below = bound.energy - proof.least_energy
    error = bound.energy - proof.energy
    failure = ""
    least = -WORST * abs(proof.energy)
    least -= ROUNDING * (abs(bound.energy) + bound.total)
    if above < least:
        failure = f"the lower bound is {-above / scale:.3g} of the bound too high"
    elif below < least:
        failure = f"the energy is {-below / scale:.3g} of the bound too low"
    return {
        "margin": above / scale,
        "effectivity": bound.total / error if error > 0 else math.nan,
        "reference": proof.total / scale,
        "failure": failure,
    }


def _row(kind, group):
    judged = [r for r in group if not math.isnan(r["margin"])]
    ratios = [r["effectivity"] for r in judged if not math.isnan(r["effectivity"])]
    return [
        kind,
        len(group),
        sum(bool(r["refused"]) for r in group),
        sum(bool(r["failure"]) for r in group),
        f"{min((r['margin'] for r in judged), default=math.nan):.2g}",
        f"{np.median(ratios or [math.nan]):.2f}",
    ]
