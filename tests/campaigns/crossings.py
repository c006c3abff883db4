"""Bounds of the energy error of random problems beside energies on finer meshes.

A lower bound from the coarse mesh above an energy on the fine one, or the other way round, would be
a counterexample.
"""

import math
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from bodies import in_quadrilaterals, moved_by, tapered
from campaigns.random_problems import BODIES, Draw, build, draws
from campaigns.two_bodies import held_block, two_blocks
from ngsolve import CF, Mesh, cos, sin, x, y

from ngepc import Material, Overlay, Roller, semismooth_newton
from ngepc.bounds.bound import error_bound
from ngepc.bounds.copies import bisected
from ngepc.bounds.counterpart import problem_on_simplices
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.transfer import on_mesh
from ngepc.studies.work import Work

KINDS = (
    "order 1",
    "order 2",
    "friction",
    "friction, order 2",
    "varying loads",
    "solid",
)
"""Kinds of problems: those of ``build`` with one feature added; solids are cubes."""

WIDER = (
    "springs",
    "springs, order 2",
    "springs, solid",
    "plane stress",
    "plane stress, order 2",
    "quadrilaterals",
    "quadrilaterals, order 2",
    "hexahedra",
    "hexahedra, order 2",
    "two bodies",
    "two bodies, order 2",
    "held",
    "held, order 2",
    "friction, order 2, solid",
    "sub-elements",
    "sub-elements, order 2",
    "revolution",
    "revolution, order 2",
    "rollers",
    "rollers, order 2",
    "rollers, solid",
    "rollers, order 2, solid",
)
"""More kinds, with elastic foundations, in plane stress, with each triangle cut into three
quadrilaterals, of a few hexahedra, of two bodies, held by contact alone, with sub-elements,
bodies of revolution, or turned bodies on rollers: ``--rows "springs,plane stress"``."""

BISECTIONS = dict.fromkeys(
    [
        "solid",
        "springs, solid",
        "friction, order 2, solid",
        "rollers, solid",
        "rollers, order 2, solid",
        *[kind for kind in WIDER if kind.startswith(("quadrilaterals", "hexahedra"))],
    ],
    1,
)
"""Number of bisections of all elements for the reference; twice in the plane."""

HEAD = ("group", "problems", "failures", "least margin", "median bound / error",
        "three quarters below")  # fmt: skip


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
        """By how much each energy is above the other lower bound, in units of the bound: > 0."""
        above = (self.fine.energy - self.bound.least_energy) / self.bound.total
        return min(
            above, (self.bound.energy - self.fine.least_energy) / self.bound.total
        )

    @property
    def effectivity(self):
        """The bound over the largest error that the fine mesh allows."""
        return self.bound.total / (self.bound.energy - self.fine.least_energy)

    @property
    def failures(self):
        """A sentence for each thing that is wrong."""
        if not self.margin > 0:
            yield f"energies cross by {-self.margin:.3g} of the bound"
        if (least := self.bound.per_cell.min() / self.bound.total) < -1e-9:
            yield f"an indicator is {least:.3g} of the bound"


def problem_of(draw, kind):
    """The problem of a draw with the feature of its kind."""
    if kind.startswith("two bodies"):
        return two_blocks(draw, 2 if kind.endswith("order 2") else 1)
    if kind.startswith("held"):
        return held_block(draw, 2 if kind.endswith("order 2") else 1)
    rough = kind.startswith("friction")
    if rough:  # the pressure exceeds the load, so that most rows stick
        push = max(draw.gap_size, 2.0)
        draw = replace(
            draw, gap="pushed", gap_size=push, load=min(draw.load, 0.2 * push)
        )
    plane = "two-dimensional"
    if kind.startswith("plane stress"):
        plane = "plane stress"
    if kind.startswith("revolution"):
        plane = "plane strain"
    if kind.startswith("sub-elements"):
        plane = "plane strain"
        draw = replace(draw, history=0.0)
    problem = build(draw, plane)
    if kind.startswith("revolution"):
        problem = revolved(problem, draw)
    stress, size = (
        problem.material.yield_stress,
        BODIES[draw.body].length * 10**draw.length_unit,
    )
    if "order 2" in kind:
        problem = replace(problem, order=2)
    if kind.startswith("quadrilaterals"):
        return replace(problem, mesh=in_quadrilaterals(problem.mesh))
    if kind.startswith("hexahedra"):
        return replace(problem, mesh=few_hexahedra(draw))
    if kind.startswith("springs"):
        return with_springs(problem, draw)
    if kind.startswith("rollers"):
        return on_rollers(problem, draw)
    if kind.startswith("sub-elements"):
        return replace(problem, material=in_sub_elements(problem.material, draw))
    if rough:
        return replace(problem, friction=stress * (0.1 + 0.1 * draw.maxh * x / size))
    if kind == "varying loads":
        waves = sin(4 * x / size + draw.angle), cos(5 * x * y / size**2)
        force = draw.load * stress / size
        traction = {
            name: CF(g) * (1 + waves[0] / 2) for name, g in problem.traction.items()
        }
        return replace(
            problem, body_force=tuple(force * w for w in waves), traction=traction
        )
    return problem


def revolved(problem, draw):
    """The body of revolution with the cross-section of a problem, on the axis or beside it.

    It touches the axis only where it is free or clamped.
    """
    mesh = problem.mesh
    points = np.array([point.p for point in mesh.ngmesh.Points()])
    size = np.ptp(points[:, 0])
    inner = points[:, 0].min()
    beside = (0.0, 0.02, 0.3, 5.0)[int(1e6 * draw.maxh) % 4] * size
    body = BODIES[draw.body]
    acting = mesh.Boundaries("|".join([body.load, body.contact])).Elements()
    numbers = [vertex.nr for element in acting for vertex in element.vertices]
    if points[numbers, 0].min() <= inner + 1e-9 * size:
        beside = max(beside, 0.02 * size)
    for point in mesh.ngmesh.Points():
        point[0] = max(point.p[0] - inner, 0.0) + beside
    return replace(problem, mesh=Mesh(mesh.ngmesh), kinematics="axisymmetric")


def few_hexahedra(draw):
    """A cube of 8 to 64 hexahedra, or one that is distorted and narrower at the top."""
    number = int(1e6 * draw.maxh)
    n = 2 + number % 3
    size = 0.25 * (number % 2)
    return tapered(
        n, size=size, taper=1.2 * size, seed=number, length=10**draw.length_unit
    )


def in_sub_elements(material, draw):
    """Two sub-elements, of which the second yields at twice the stress, and one that never does."""
    h = 10**draw.hardening
    share = 2 / (2 + h)
    bound = material.yield_stress
    return Material(
        lame_lambda=material.lame_lambda,
        lame_mu=material.lame_mu,
        yield_stress=bound,
        overlay=Overlay([0.6 * share, 0.4 * share], [bound, 2 * bound]),
    )


def with_springs(problem, draw):
    """The problem with springs between a hundredth and a hundred times the stiffness of the body.

    They resist the normal displacement of the loaded boundary, or the components on that of
    contact or load, or they take the place of the clamp.
    """
    body = BODIES[draw.body]
    size = body.length * 10**draw.length_unit
    power = 4 * (1e4 * draw.maxh % 1) - 2
    k = problem.material.lame_mu / size * 10**power
    each = tuple(k * (1 + axis) for axis in range(problem.N))
    if draw.kind == "isotropic":
        return replace(problem, clamped=None, springs={body.clamped: each})
    if draw.kind == "kinematic":
        return replace(problem, springs={body.load: k})
    place = body.load if problem.contact_names else body.contact
    return replace(problem, springs={place: each})


def on_rollers(problem, draw):
    """The body, turned, on a roller in the place of the clamp; springs hold what is left free.

    The roller is a normal one, or one along a given direction; half of them move.
    """
    body = BODIES[draw.body]
    N = problem.N
    turn = turned_by(3 * draw.angle, N)  # the load has the angle itself
    number = int(1e6 * draw.maxh)
    size = body.length * 10**draw.length_unit
    strain = draw.gap_size * problem.material.yield_stress / problem.material.lame_mu
    value = (0.0, 0.1 * strain * size)[number % 2]
    direction = (None, None, tuple(turn @ np.linspace(0.4, 1.0, N)))[number % 3]
    k = problem.material.lame_mu / size * 10 ** (2 * (1e4 * draw.maxh % 1))
    place = body.load if problem.contact_names else body.contact
    return replace(
        problem,
        mesh=moved_by(turn, problem.mesh),
        clamped=None,
        prescribed={body.clamped: Roller(direction, value)},
        springs={place: (k,) * N},
    )


def turned_by(angle, N):
    """A rotation in the plane, in space followed by one about the first axis."""
    c = math.cos(angle)
    s = math.sin(angle)
    turn = np.eye(N)
    turn[:2, :2] = [[c, -s], [s, c]]
    if N == 2:
        return turn
    return np.array([[1, 0, 0], [0, s, -c], [0, c, s]]) @ turn


def random_draws(seed, kind):
    """An endless sequence of draws for problems of a kind; the L-shape mostly opens its gap."""
    solid = kind.endswith("solid") or kind.startswith("hexahedra")
    drawn = (d for d in draws(seed) if (d.body == "cube") == solid)
    return (d for d in drawn if not kind.startswith("friction") or d.body != "lshape")


def crossing(draw, kind, bisections):
    """The bound of a problem and a fine reference."""
    problem = problem_of(draw, kind)
    bound = error_bound(semismooth_newton(problem))
    return Crossing(
        draw, bound, error_bound(semismooth_newton(finer(problem, bisections)))
    )


def random_crossings(seed, count, bisections, kind="order 1"):
    """Some random problems of a kind."""
    return [
        crossing(d, kind, bisections) for d in islice(random_draws(seed, kind), count)
    ]


def finer(problem, bisections):
    """The problem on a mesh all of whose elements are bisected several times.

    Quadrilaterals and hexahedra are cut into simplices of order two first.
    """
    problem = problem_on_simplices(problem)
    for _ in range(bisections):
        everywhere = np.ones(problem.mesh.ne, dtype=bool)
        problem = on_mesh(problem, *bisected(problem.mesh, everywhere))
    return problem


@dataclass(eq=False)
class Crossings(Work):
    """The study: ``count`` random problems of each kind in ``rows``, kept one by one.

    Parameters
    ----------
    count, seed, rows
        How many problems of each kind, the seed of their sequence, and the kinds.
    """

    count: int = 200
    seed: int = 1
    rows: tuple[str, ...] = KINDS

    name, title = "crossings", "Bounds of random problems"
    columns = " | ".join([" = {group}", *(f"{head} = {{{head}}}" for head in HEAD[1:])])

    def cells(self):
        """The problems by kind and number."""
        pairs = [(kind, n) for kind in self.rows for n in range(1, self.count + 1)]
        return [
            {"kind": kind, "seed": self.seed, "number": number}
            for kind, number in pairs
        ]

    def solve(self, kind, seed, number):
        """The verdict on one problem; an exception is a failure."""
        draw = next(islice(random_draws(seed, kind), number - 1, None))
        found = {"nodes": 0}
        found |= {"margin": math.nan, "effectivity": math.nan, "failures": ()}
        try:
            pair = crossing(draw, kind, BISECTIONS.get(kind, 2))
        except Exception as error:  # any exception is a failure
            return found | {"failures": (f"{type(error).__name__}: {error}",)}
        found |= {"nodes": pair.bound.problem.mesh.nv, "failures": tuple(pair.failures)}
        return found | {"margin": pair.margin, "effectivity": pair.effectivity}

    def line(self, record):
        """One line about a problem."""
        said = "; ".join(record["failures"])
        return (
            f"{record['kind']} {record['number']}: {record['nodes']} nodes, "
            f"bound / error {record['effectivity']:.3g}  {said}"
        )

    def table_rows(self, records):
        """A row for each kind."""
        rows = [
            _row(kind, [r for r in records if r["kind"] == kind]) for kind in self.rows
        ]
        return [dict(zip(HEAD, row, strict=True)) for row in rows]

    def notes(self, records):
        """Lines about the random problems, and the failures."""
        wrong = [
            (f"{r['kind']} {r['number']}", r["failures"])
            for r in records
            if r["failures"]
        ]
        return [
            f"Random problems of `tests/campaigns/random_problems.py`, seed {self.seed}. For "
            "reference all elements are bisected twice, in space once, quadrilaterals and "
            "hexahedra are cut into simplices of order two and these bisected once; errors are "
            "the largest that the bounds there allow. Margin: how far each energy is above the "
            "lower bound of the other mesh, in units of the bound. A failure is a problem with "
            "an exception, an energy below the lower bound of the other mesh, or a negative "
            "indicator.",
            *[f"- {label}: {'; '.join(texts)}" for label, texts in wrong],
        ]


def _row(kind, group):
    judged = [r for r in group if not math.isnan(r["margin"])]
    ratios = [r["effectivity"] for r in judged] or [math.nan]
    return [
        kind,
        len(group),
        sum(bool(r["failures"]) for r in group),
        f"{min((r['margin'] for r in judged), default=math.nan):.2g}",
        f"{np.median(ratios):.2f}",
        f"{np.quantile(ratios, 0.75):.2f}",
    ]
