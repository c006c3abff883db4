"""Robustness: one datum at a time is moved to its extremes; iterations and status.

The body is the unit square, fixed below, sheared at its sides until it yields and pressed against
an obstacle above.  Every cell of the table is a run from a cold start that ends in a named status.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ngsolve import BND, CF, IfPos, x

from ngepc.dual.path import PathOptions, follow_path
from ngepc.geometries import block
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.primal.solver import primal_newton
from ngepc.results.options import NewtonOptions
from ngepc.studies.examples import solved_by
from ngepc.studies.work import Work, chosen, shown

LAME_MU, YIELD_STRESS = 1e3, 1.25
SHEAR = 2.5

POISSON = (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999)
HARDENING = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
GAMMA = (1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9)
ASPECT = (1.0, 10.0, 100.0, 1000.0)
CONTACT = ("none", "one node", "full", "grazing", "from an end")

METHODS = ("primal", "default", "coupled", "path")
NOTE = (
    "Newton steps, with the status in words where a run did not converge. The unit square on 169 "
    "nodes in plane strain, fixed below, sheared and pulled against an obstacle; one datum at a "
    "time is changed from its usual value (Poisson 0.3, h/mu 0.1, gamma 1e3 for the coupled "
    "method, aspect ratio 1, half of the upper side in contact). Cold starts, at most {limit} "
    "steps; the path increases gamma from 1 in factors of ten, and all its steps are counted."
)


@dataclass(frozen=True)
class Case:
    """One row of the table: a datum with an unusual value.

    ``hardening`` is h over lame_mu; ``gamma`` that of the coupled method and of the last step of
    the path; ``aspect`` the longest over the shortest side of the elements; ``contact`` one of
    CONTACT, or 'part': about half of the upper side.
    """

    poisson: float = 0.3
    hardening: float = 0.1
    gamma: float = 1e3
    aspect: float = 1.0
    contact: str = "part"


CASES = {
    "usual": Case(),
    **{f"Poisson {value:g}": Case(poisson=value) for value in POISSON},
    **{f"h/mu {value:g}": Case(hardening=value) for value in HARDENING},
    **{f"aspect ratio {value:g}": Case(aspect=value) for value in ASPECT},
    **{f"contact {value}": Case(contact=value) for value in CONTACT},
    **{f"gamma {value:g}": Case(gamma=value) for value in GAMMA},
}
"""Label -> case, in the order of the table."""


def extreme_problem(case, cells=12):
    """The problem of a case on ``cells`` x ``cells`` rectangles cut into triangles."""
    height = 1 / case.aspect
    mesh = block.structured_mesh(cells, cells, size=(1.0, height), simplices=True)
    material = Material.kinematic(
        lame_lambda=2 * LAME_MU * case.poisson / (1 - 2 * case.poisson),
        lame_mu=LAME_MU,
        yield_stress=YIELD_STRESS,
        hardening=case.hardening * LAME_MU,
    )
    up = CF((0.0, SHEAR * height))
    loads = {"left": up, "right": up, "contact": (SHEAR, SHEAR)}
    free = Problem(mesh, material, traction=loads, order=1)
    top = primal_newton(free).displacement[1]
    gap = _gap(case.contact, mesh, top, height)
    return replace(free, contact="contact", gap=gap)


def _gap(contact, mesh, top, height):
    """The gap that gives a contact state, from the displacement ``top`` without an obstacle."""
    vertices = sorted(
        {v.nr for el in mesh.Boundaries("contact").Elements() for v in el.vertices}
    )
    points = [mesh.ngmesh.Coordinates()[v][0] for v in vertices]
    values = {a: float(top(mesh(a, height, 0.0, BND))) for a in points}
    high, low = max(values.values()), min(values.values())
    place = min(points, key=lambda a: abs(a - 0.5))
    steep = 4 * (high - low + abs(high))
    return {
        "part": CF(0.5 * (high + low)),
        "none": CF(2 * abs(high) + height),
        "one node": 0.5 * values[place]
        + steep * IfPos(x - place, x - place, place - x),
        "full": CF(low - abs(high)),
        "grazing": CF(high),
        "from an end": 0.8 * values[max(points)] + steep * (max(points) - x),
    }[contact]


def solve(case, method, limit, cells=12):
    """The result of one of METHODS for a case, in ``limit`` Newton steps at most."""
    problem = extreme_problem(case, cells)
    options = NewtonOptions(max_iterations=limit, quadrature_points=100)
    if method == "path":
        path = PathOptions(
            gamma_start=1.0, growth=10.0, gamma_end=case.gamma, newton=options
        )
        return follow_path(problem, path)
    return solved_by(
        case.gamma if method == "coupled" else method, problem, options=options
    )


@dataclass(eq=False)
class Robustness(Work):
    """The study.

    Parameters
    ----------
    rows
        Labels of CASES; None for all.
    limit
        Most Newton steps of one run.
    """

    rows: Sequence[str] | None = None
    limit: int = 200

    name, title = "robustness", "Robustness"
    columns, across = " = {row}", ("{method}", "{steps}")

    def __post_init__(self):
        self.rows = chosen(CASES, self.rows)

    def cells(self):
        """All methods in each row."""
        pairs = [(row, method) for row in self.rows for method in METHODS]
        return [
            {"row": row, "method": method, "limit": self.limit} for row, method in pairs
        ]

    def solve(self, row, method, limit):
        """One run."""
        result = solve(CASES[row], method, limit).or_interrupted()
        last = getattr(result, "last", result)
        return {
            "iterations": result.total_inner_iterations
            if method == "path"
            else result.iterations,
            "status": result.status.label,
            "residual": last.residual_norm,
            "plastic": last.history.records[-1].plastic_active,
            "contact_force": last.contact_force,
            "primal_energy": last.primal_energy,
            "message": result.message,
        }

    def line(self, record):
        """The count."""
        return f"{record['row']}, {record['method']}: " + shown("{steps}", record)

    def notes(self, records):
        """What the problem is."""
        return [NOTE.format(limit=self.limit)]
