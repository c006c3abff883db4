"""Published problems of solids: material points and limit loads."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from netgen.occ import OCCGeometry, WorkPlane
from ngsolve import Mesh
from ngsolve import x as X
from ngsolve import y as Y_COORDINATE
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.dual.newton import semismooth_newton
from ngepc.evolution.load_path import Schedule
from ngepc.evolution.result import Evolution
from ngepc.evolution.solver import evolve
from ngepc.geometries import block
from ngepc.model.material import Material, lame_parameters
from ngepc.model.places import Point
from ngepc.model.problem import Problem

MIDDLE = (0.5, 0.5, 0.5)

NEARLY_PERFECT = 1e-5
"""Hardening over shear modulus where the problem asks for none."""


class Quantity(NamedTuple):
    """One number of a problem: its name, the reference, where that is from, and ours.

    ``kind`` is P for published, C for a closed form, O for an own computation; the tolerance is
    relative.
    """

    name: str
    reference: float
    kind: str
    tolerance: float
    ours: float

    @property
    def difference(self) -> float:
        """Ours minus the reference, relative to it; itself where the reference is 0."""
        return self.ours / self.reference - 1 if self.reference else self.ours

    @property
    def holds(self) -> bool:
        """Whether the difference is within the tolerance."""
        return abs(self.difference) <= self.tolerance


Solved = tuple[object, list[Quantity]]
"""A result, or a history, and the numbers compared."""


def metal(
    young: float, poisson: float, stress: float, *, isotropic: float = 0.0, kinematic: float = 0.0
) -> Material:
    """Von Mises plasticity from uniaxial data: yield stress and plastic moduli (stress)."""
    lame_lambda, lame_mu = lame_parameters(young, poisson)
    bound = math.sqrt(2 / 3) * stress
    least = 0.0 if isotropic or kinematic else NEARLY_PERFECT * lame_mu
    return Material.combined(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=bound,
        hardening=max(2 / 3 * kinematic, least),
        hardening_modulus=1 / bound,
        hardening_stiffness=2 / 3 * isotropic,
    )


def history(
    problem: Problem, corners: Sequence, changes: Callable[[Sequence], dict], steps: Sequence[int]
) -> Evolution:
    """Equal steps, so many for each leg, through the corners of a path, the first at time 0."""
    times = np.concatenate([leg + np.arange(1, n + 1) / n for leg, n in enumerate(steps)])
    knots = np.arange(len(corners))

    def at(time: float) -> dict:
        return changes([float(np.interp(time, knots, c)) for c in np.transpose(corners)])

    return evolve(problem, Schedule(times.tolist(), at)).raise_for_status()


NL1_CORNERS = ((0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 0))
NL1_STRESS = {
    62.5e3: (5.000, 5.862, 5.482, 6.362, 6.640, 7.322, 4.230, 5.673),
    0.0: (5, 5, 5, 5, 5, 5, 3.917, 5),
}
"""Plastic modulus -> von Mises stress at the ends of the legs."""


def nl1() -> Solved:
    """NAFEMS NL1: a cube whose faces are all moved, strains in multiples of 0.25e-4."""
    mesh, found = block.structured_mesh(1, 1, 1), []
    faces = "|".join(sorted(set(mesh.GetBoundaries())))

    def moved(strains: Sequence[float]) -> dict:
        ex, ey = (0.25e-4 * e for e in strains)
        return {"prescribed": {faces: (ex * X, ey * Y_COORDINATE, 0)}}

    def stresses(run: Evolution) -> np.ndarray:
        ends = run.steps[len(run.steps) // 8 - 1 :: len(run.steps) // 8]
        return np.array([float(step.fields.von_mises(mesh(*MIDDLE))) for step in ends])

    for modulus, published in NL1_STRESS.items():
        problem = Problem(mesh, metal(250e3, 0.25, 5.0, isotropic=modulus), None, **moved((0, 0)))
        coarse, fine = (history(problem, NL1_CORNERS, moved, [n] * 8) for n in (10, 20))
        limit = 2 * stresses(fine) - stresses(coarse)  # implicit Euler is of first order
        found += [
            Quantity(f"H = {modulus:g}, leg {leg}", p, "P", 0.01, float(ours))
            for leg, (p, ours) in enumerate(zip(published, limit, strict=True), 1)
        ]
    return fine, found


def pulled_cube(material: Material, corners: Sequence, steps: Sequence[int]) -> Evolution:
    """A cube under (sigma_xx, tau_xy), held at three of its corners."""
    mesh = block.structured_mesh(1, 1, 1)

    def pulled(stress: Sequence[float]) -> dict:
        s, t = stress
        loads = {"right": (s, t, 0), "left": (-s, -t, 0), "back": (t, 0, 0), "front": (-t, 0, 0)}
        return {"traction": loads}

    held = {
        Point((0, 0, 0)): (0, 0, 0),
        Point((1, 0, 0)): (None, 0, 0),
        Point((0, 1, 0)): (None, None, 0),
    }
    problem = Problem(mesh, material, None, prescribed=held)
    return history(problem, corners, pulled, steps)


def at_middle(fields: object) -> tuple[float, float, float]:
    """Eps_xx, eps_xy and the cumulated plastic strain in the middle of the cube."""
    here = fields.problem.mesh(*MIDDLE)
    strain = np.reshape(fields.strain(here), (3, 3))
    return strain[0, 0], strain[0, 1], float(fields.accumulated_plastic_strain(here))


NAMES = ("eps_xx", "eps_xy", "p")
TANGENT = 195000 * 1930 / (195000 - 1930)
A, B = (151.2, 93.1), (257.2, 33.1)
AT_A, AT_B = (0.0148297, 0.0136014, 0.0205473), (0.035265, 0.020471, 0.042329)


def ssnp15() -> Solved:
    """Code_Aster SSNP15: tension and shear to A and on to B, isotropic hardening."""
    path = pulled_cube(metal(195000, 0.3, 181, isotropic=TANGENT), [(0, 0), A, B], (1, 50))
    told = path.values(at_middle)
    at_a = zip(NAMES, AT_A, told[0], strict=True)
    at_b = zip(NAMES, AT_B, told[-1], strict=True)
    found = [Quantity(f"{name} at A", p, "P", 0.001, ours) for name, p, ours in at_a]
    return path, found + [Quantity(f"{name} at B", p, "P", 0.01, ours) for name, p, ours in at_b]


def ssnp14() -> Solved:
    """Code_Aster SSNP14: the same with kinematic hardening, to A."""
    path = pulled_cube(metal(195000, 0.3, 181, kinematic=TANGENT), [(0, 0), A], (1,))
    told = zip(NAMES, AT_A, path.values(at_middle)[-1], strict=True)
    return path, [Quantity(f"{name} at A", p, "P", 0.001, ours) for name, p, ours in told]


def tube() -> Mesh:
    """A slice of a thick cylinder, 100 <= r <= 200, as 80 rectangles."""
    return MakeStructured2DMesh(nx=80, ny=1, mapping=lambda s, t: (100 + 100 * s, 2 * t))


def hill() -> Solved:
    """Hill's thick cylinder in plane strain: the limit pressure, and one before it."""
    mesh, material, k = tube(), metal(210.0, 0.3, 0.24), 0.24 / math.sqrt(3)
    flat = {"bottom|top": (None, 0)}
    body = {"kinematics": "axisymmetric", "order": 2}
    blown = Problem(mesh, material, None, prescribed=flat | {"left": (2.0, None)}, **body)
    limit = semismooth_newton(blown).raise_for_status()
    area = 2 * math.pi * 100 * 2
    found = [
        Quantity(
            "limit pressure",
            2 * k * math.log(2),
            "C",
            0.005,
            float(limit.equilibrium.reactions["left"][0] / area),
        )
    ]
    for pressure in (0.15, 0.17, 0.185):
        loaded = Problem(mesh, material, None, pressure={"left": pressure}, prescribed=flat, **body)
        state = semismooth_newton(loaded).raise_for_status().state
        c = float(state.discrete.points.at(X)[state.at.yields].max())
        closed = k * (2 * math.log(c / 100) + 1 - (c / 200) ** 2)
        found.append(Quantity(f"p at plastic radius {c:.1f}", closed, "C", 0.005, pressure))
    return limit, found


def half_plane(width: float, depth: float, tip: float, fine: float, coarse: float) -> Mesh:
    """The right half of a block below y = 0, fine where 0 < x < tip, the boundary ``top``."""
    corners = [(0, 0), (0, -depth), (width, -depth), (width, 0), (tip, 0)]
    path = WorkPlane().MoveTo(*corners[0])
    for corner in corners[1:]:
        path = path.LineTo(*corner)
    face = path.Close().Face()
    for edge in face.edges:
        c = edge.center
        places = {"symmetry": c.x, "bottom": c.y + depth, "right": c.x - width}
        top = "top" if c.x < tip else "free"
        edge.name = next((n for n, d in places.items() if abs(d) < 1e-9), top)
        if edge.name == "top":
            edge.maxh = fine
    return Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=coarse, grading=0.12))


def prandtl() -> Solved:
    """Prandtl's rough flat punch of half width 1 on a half-plane, moved until all flows."""
    mesh, shear = half_plane(6, 4, 1.0, 0.03, 0.25), 1.0
    problem = Problem(
        mesh,
        metal(1e3 * shear, 0.3, math.sqrt(3) * shear),
        None,
        prescribed={"top": (0, -0.1), "symmetry": (0, None), "bottom|right": (0, 0)},
        order=2,
    )
    result = semismooth_newton(problem).raise_for_status()
    mean = -float(result.equilibrium.reactions["top"][1])
    return result, [Quantity("mean pressure / k", 2 + math.pi, "C", 0.02, mean / shear)]
