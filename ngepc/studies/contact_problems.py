"""Published problems of contact: Hertz, Mindlin, shrink fit, spheres that yield, step-42."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from netgen.occ import Circle, Compound, Glue, MoveTo, OCCGeometry, Rectangle
from ngsolve import Mesh, x

from ngepc.dual.newton import semismooth_newton
from ngepc.evolution.load_path import Schedule
from ngepc.evolution.solver import evolve
from ngepc.geometries import quarter_cube
from ngepc.model.contact import Contact, Coulomb
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.results.exact import DiscreteSolution
from ngepc.studies.solid_problems import Quantity, Solved, half_plane, metal, polygon, zero_of
from ngepc.studies.step42 import step42_problem

ELASTIC = 1e9
"""A yield stress that nothing reaches."""


def fitted(result: DiscreteSolution, least: float = 0.15) -> tuple[float, float]:
    """Peak pressure and half width of p^2 = p_0^2 (1 - x^2/a^2), fitted where p is not small."""
    rows = result.rows
    p = result.nodal_contact_forces / rows.weights
    place = np.asarray(result.problem.mesh.ngmesh.Coordinates())[rows.vertices, 0]
    inner = (p > least * p.max()) & (place > 0.05 * place[p > 0].max())
    slope, top = np.polyfit(place[inner] ** 2, p[inner] ** 2, 1)
    return math.sqrt(top), math.sqrt(-top / slope)


def roller(fine: float, order: int) -> Problem:
    """Half of a roller of radius 50 on a block, NAFEMS R94: 35 kN/mm, E = 210 and 70 GPa."""
    disc = Circle((0, 50), 50).Face() * Rectangle(50, 50).Face()
    box, under = Rectangle(9, 6).Face(), MoveTo(0, -6).Rectangle(9, 6).Face()
    block = MoveTo(0, -200).Rectangle(100, 200).Face()
    parts = [(disc * box, fine, "roller"), (disc - box, 6, "roller")]
    parts += [(block * under, 1.4 * fine, "block"), (block - under, 12, "block")]
    for shape, maxh, name in parts:
        shape.faces.name, shape.faces.maxh = name, maxh
        for edge in shape.edges:
            c = edge.center
            sides = {"symmetry": c.x, "bottom": c.y + 200, "load": c.y - 50}
            edge.name = zero_of(sides, "free")
    for edge in parts[0][0].edges:
        if 0.1 < edge.center.x < 9 and edge.center.y < 1.5:
            edge.name = "arc"
    for edge in parts[2][0].edges:
        if abs(edge.center.y) < 1e-9:
            edge.name = "flat"
    shapes = [shape for shape, *_ in parts]
    geometry = OCCGeometry(Compound([Glue(shapes[:2]), Glue(shapes[2:])]), dim=2)
    mesh = Mesh(geometry.GenerateMesh(maxh=12, grading=0.3))
    young = mesh.MaterialCF({"roller": 210e3, "block": 70e3})
    material = Material.kinematic(
        lame_lambda=young * 0.3 / (1.3 * 0.4), lame_mu=young / 2.6, yield_stress=1e9, hardening=1e3
    )
    return Problem(
        mesh,
        material,
        None,
        {"load": (0, -17500 / 50)},
        prescribed={"symmetry": (0, None), "bottom": (0, 0)},
        contact=Contact("flat", "arc"),
        order=order,
    )


def r94() -> Solved:
    """NAFEMS R94: an elastic cylinder on an elastic block."""
    result = semismooth_newton(roller(0.4, 2)).raise_for_status()
    peak, width = fitted(result)
    return result, [
        Quantity("peak pressure", 3585.37, "P", 0.02, peak),
        Quantity("half width", 6.21, "P", 0.02, width),
    ]


def hertz(kinematics: str) -> Solved:
    """A rigid parabola of radius 10 pressed 0.01 into a block; what is found is put into Hertz."""
    E, nu, R = 1e3, 0.3, 10.0
    plane, stiffness = kinematics == "plane strain", E / (1 - nu**2)
    mesh = half_plane(20, 20, 1.2, 0.02, 2.0)
    problem = Problem(
        mesh,
        metal(E, nu, ELASTIC),
        "bottom",
        contact="top",
        gap=x * x / (2 * R) - (0.06 if plane else 0.05),
        prescribed={"symmetry": (0, None)},
        kinematics=kinematics,
        order=2,
    )
    result = semismooth_newton(problem).raise_for_status()
    peak, width = fitted(result)
    P = result.contact_force * (2 if plane else 1)
    if plane:
        closed = (
            math.sqrt(P * stiffness / (math.pi * R)),
            math.sqrt(4 * P * R / (math.pi * stiffness)),
        )
    else:
        closed = (
            (6 * P * stiffness**2 / (math.pi**3 * R**2)) ** (1 / 3),
            (3 * P * R / (4 * stiffness)) ** (1 / 3),
        )
    return result, [
        Quantity("peak pressure at the force found", closed[0], "C", 0.01, peak),
        Quantity("half width at the force found", closed[1], "C", 0.01, width),
    ]


MU = 0.3


def rounded_blocks(fine: float) -> Mesh:
    """Two equal blocks that meet with parabolas of radius 80, the upper one meshed finer."""
    faces, W, H, tip, radius = [], 10.0, 10.0, 1.6, 80.0
    for side, h, name in ((-1, 1.3 * fine, "lower"), (1, fine, "upper")):
        corners = [(-W, 0), (-tip, 0), (tip, 0), (W, 0), (W, side * H), (-W, side * H)]
        corners = corners if side == 1 else corners[::-1]
        face = polygon(corners)
        face.faces.name = face.edges.name = name
        for edge in face.edges:
            if abs(edge.center.y) < 1e-9 and abs(edge.center.x) < tip:
                edge.name, edge.maxh = f"{name} arc", h
            if abs(edge.center.y - side * H) < 1e-9:
                edge.name = f"{name} end"
        faces.append(face)
    mesh = Mesh(OCCGeometry(Compound(faces), dim=2).GenerateMesh(maxh=1.5, grading=0.15))
    above = {v.nr for el in mesh.Materials("upper").Elements() for v in el.vertices}
    for number, point in enumerate(mesh.ngmesh.Points()):
        side = 1 if number in above else -1
        point[1] += side * point[0] ** 2 / (2 * radius) * (1 - abs(point[1]) / H)
    return mesh


MU = 0.3


def mindlin(fine: float = 0.05) -> Solved:
    """Cattaneo and Mindlin: equal cylinders pressed, then sheared with friction; P, Q as found."""
    mesh, E, nu, R = rounded_blocks(fine), 1e3, 0.3, 40.0
    problem = Problem(
        mesh,
        metal(E, nu, ELASTIC),
        "lower end",
        prescribed={"upper end": (0, -0.04)},
        contact=Contact("upper arc", "lower arc"),
        order=2,
    )
    pressed = semismooth_newton(problem).raise_for_status()
    sheared = replace(
        problem,
        prescribed={"upper end": (0.01, -0.04)},
        friction=Coulomb(MU),
        initial_displacement=pressed.displacement,
    )
    result = semismooth_newton(sheared, start=pressed).raise_for_status()
    return result, stick_and_slip(result, E / (2 * (1 - nu**2)), R)


def stick_and_slip(result: DiscreteSolution, stiffness: float, R: float) -> list[Quantity]:
    """The stick half width and the tractions beside those of Cattaneo and Mindlin."""
    rows, P = result.rows, result.contact_force
    place = np.asarray(result.problem.mesh.ngmesh.Coordinates())[rows.vertices, 0]
    Q = abs(result.friction_force[0])
    a = math.sqrt(4 * P * R / (math.pi * stiffness))
    c, peak = a * math.sqrt(1 - Q / (MU * P)), 2 * P / (math.pi * a)
    disc = [np.sqrt(np.maximum(1 - (place / r) ** 2, 0)) for r in (a, c)]
    closed = MU * peak * (disc[0] - c / a * disc[1])
    ours = np.abs(result.nodal_friction_forces[:, 0]) / rows.weights
    touching = result.nodal_contact_forces > 0
    bound = MU * result.nodal_contact_forces
    sticks = touching & (np.abs(result.nodal_friction_forces[:, 0]) < (1 - 1e-9) * bound)
    cell = float(np.diff(np.unique(place)).min())
    apart = float(np.sqrt(np.mean((ours - closed)[touching] ** 2)) / closed.max())
    width = (place[sticks].max() - place[sticks].min() + cell) / 2
    return [
        Quantity("stick half width", c, "C", cell / c, float(width)),
        Quantity("rms error of the tractions / peak", 0.0, "C", 0.03, apart),
    ]


def rings(fine: float, inner: float, middle: float, outer: float, interference: float) -> Mesh:
    """Quarters of two rings; the outer one is too narrow for the inner one."""
    faces, box = [], Rectangle(2 * outer, 2 * outer).Face()
    half = interference / 2
    radii = {"inner": (inner, middle + half), "outer": (middle - half, outer)}
    for number, (name, (a, b)) in enumerate(radii.items()):
        face = (Circle((0, 0), b).Face() - Circle((0, 0), a).Face()) * box
        face.faces.maxh = fine * (1 + 0.3 * number)
        for edge in face.edges:
            c = edge.center
            inside = math.hypot(c.x, c.y) < (a + b) / 2
            side = f"{name} {'inside' if inside else 'outside'}"
            edge.name = zero_of({"left": c.x, "bottom": c.y}, side)
        faces.append(face)
    return Mesh(OCCGeometry(Compound(faces), dim=2).GenerateMesh(maxh=outer))


def shrink_fit() -> Solved:
    """A ring shrunk on another one of the same metal, plane strain: the pressure between them."""
    a, b, c, delta, E, nu = 1.0, 2.0, 3.0, 0.01, 1e3, 0.3
    problem = Problem(
        rings(0.05, a, b, c, delta),
        metal(E, nu, ELASTIC),
        None,
        prescribed={"left": (0, None), "bottom": (None, 0)},
        contact=Contact("inner outside", "outer inside"),
        order=2,
    )
    result = semismooth_newton(problem).raise_for_status()
    stiff, poisson = E / (1 - nu**2), nu / (1 - nu)
    soft = (c**2 + b**2) / (c**2 - b**2) + poisson + (b**2 + a**2) / (b**2 - a**2) - poisson
    found = result.contact_force / float(result.rows.weights.sum())
    return result, [Quantity("mean pressure", delta * stiff / (b * soft), "C", 0.01, found)]


def pressed_sphere(
    radius: float, depths: list[float], contact: float, width: float, material: Material
) -> list[DiscreteSolution]:
    """A rigid sphere pressed into a block, axisymmetric, its depth raised through ``depths``."""
    mesh = half_plane(width, width, contact, contact / 24, width / 8)
    body = {"kinematics": "axisymmetric", "order": 2, "prescribed": {"symmetry": (0, None)}}
    first = x * x / (2 * radius)
    problem = Problem(mesh, material, "bottom", contact="top", gap=first, **body)
    results = []

    def solver(step: Problem, start: object) -> DiscreteSolution:
        results.append(semismooth_newton(step, start=start))
        return results[-1]

    steps = Schedule(depths, lambda depth: {"gap": first - depth})
    evolve(problem, steps, solver).raise_for_status()
    return [r for r in results if r.status.label == "converged"]


def flattened_sphere() -> Solved:
    """A sphere and a rigid flat up to 20 times the depth of first yield: Jackson and Green's fit.

    Load (27), hardness (28), critical load (29), depth (5), C (6) and radius (23) as printed by
    Ghaednia, Brake, Berryhill and Jackson (J. Tribology, 2019) for perfect plasticity.
    """
    E, nu, strength, R = 200e3, 0.3, 400.0, 1.0
    stiffness, C = E / (1 - nu**2), 1.295 * math.exp(0.736 * nu)
    critical = (math.pi * C * strength / (2 * stiffness)) ** 2 * R
    first_load = 4 / 3 * (R / stiffness) ** 2 * (C * math.pi * strength / 2) ** 3
    ratios = (5.0, 10.0, 20.0)
    depths = [critical * d for d in (*np.arange(0.5, 10, 0.5), *np.arange(10, 20.5, 1))]
    B, widest = 0.14 * math.exp(23 * strength / stiffness), 0.04
    results = pressed_sphere(R, depths, widest, 1.0, metal(E, nu, strength))
    found = []
    for d in ratios:
        a = math.sqrt(critical * R * d * max(1.0, d / 1.9) ** B)
        hardness = 2.84 - 0.92 * (1 - math.cos(math.pi * a / R))
        load = math.exp(-0.25 * d ** (5 / 12)) * d**1.5
        load += 4 * hardness / C * (1 - math.exp(-(d ** (5 / 9)) / 25)) * d
        ours = results[depths.index(critical * d)].contact_force / first_load
        found.append(Quantity(f"F / F_c at {d:g} critical depths", load, "P", 0.05, ours))
    return results[-1], found


def ssnv506() -> Solved:
    """Code_Aster SSNV506: a rigid sphere of radius 500 in a steel block, force per radian."""
    depths = [2.5 * number for number in range(1, 25)]
    results = pressed_sphere(500.0, depths, 330.0, 2000.0, metal(210e3, 0.3, 50.0))
    published = {20.0: 2.03804e6, 40.0: 4.07608e6, 60.0: 6.11412e6}
    return results[-1], [
        Quantity(
            f"force at {depth:g} mm",
            force,
            "P",
            0.05,
            results[depths.index(depth)].contact_force / (2 * math.pi),
        )
        for depth, force in published.items()
    ]


def step42() -> Solved:
    """Step-42 of deal.II on its own mesh of equal hexahedra, a quarter of it."""
    problem = step42_problem(quarter_cube.mesh(4, 8, grading=0.0, simplices=False))
    result = semismooth_newton(problem).raise_for_status()
    return result, [Quantity("contact force", 37.3058, "P", 1e-5, 4 * result.contact_force)]
