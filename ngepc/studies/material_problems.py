"""Closed forms of plane stress, of cycles, of thermal cycles and of rates."""

import math

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, Mesh, x, y, z
from ngsolve.meshes import MakeStructured2DMesh
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ngepc.evolution.load_path import Schedule, load_cycle
from ngepc.evolution.material_point import material_point
from ngepc.evolution.solver import evolve
from ngepc.geometries import block
from ngepc.methods.newton import semismooth_newton
from ngepc.model.hill import Hill
from ngepc.model.material import Material
from ngepc.model.places import Roller
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ, lame_parameters
from ngepc.model.viscosity import Norton
from ngepc.results.outcome import Status
from ngepc.studies.solid_problems import Quantity, Solved, metal

BARS = ((100e3, 3.0), (60e3, 6.0), (40e3, 8.0))
"""Young's modulus and yield stress of the sheets of SSNP303 (MPa)."""

SHEETS = {
    9.0: ((3.147155, 3.511707, 2.341138), (0.3199571, -0.1900098, -0.1279828)),
    16.93: ((3.209297, 6.149462, 7.571241), (0.4753345, 0.304849, -0.7863557)),
}
"""Force of SSNP303 (N) -> stresses along it and across it in the three sheets (MPa)."""


def three_sheets() -> Solved:
    """SSNP303 (NAFEMS): three sheets without hardening, glued on top of each other, pulled.

    They share the strains in their plane, each has its own strain across.  Hence a thin solid of
    three layers, which is pulled slowly; it is symmetric to its bottom, so that it does not bend.
    Stresses between steps are interpolated at the forces of V6.03.303.
    """
    thin = 1e-3
    mesh = block.structured_mesh(1, 1, 3, size=(1.0, 1.0, 3 * thin))

    def by_sheet(values: tuple[float, ...]) -> CoefficientFunction:
        """A function that has one value in each sheet."""
        upper = IfPos(z - 2 * thin, values[2], values[1])
        return IfPos(z - thin, upper, values[0])

    young, stress = zip(*BARS, strict=True)
    metal = Material.metal(
        young=by_sheet(young),
        poisson=0.25,
        yield_stress=by_sheet(stress),
        plastic_modulus=0.0,
    )
    held = {"left": (0, None, None), "front": (None, 0, None)}
    held |= {"clamped": (None, None, 0), "right": (2.6e-4, None, None)}
    problem = Problem(mesh, metal, None, prescribed=held)
    steps = 120
    pulled = load_cycle(problem, [k / steps for k in range(1, steps + 1)])
    run = evolve(problem, pulled).raise_for_status()

    along = np.zeros((steps, 3))
    across = np.zeros((steps, 3))
    places = [mesh(0.5, 0.5, (sheet + 0.5) * thin) for sheet in range(3)]
    for k, step in enumerate(run.steps):
        stress = step.fields.stress
        for sheet, place in enumerate(places):
            tensor = stress(place)
            along[k, sheet] = tensor[0]
            across[k, sheet] = tensor[4]
    forces = along.sum(axis=1)
    found = []
    for force, published in SHEETS.items():
        for name, values, given in zip(
            ("xx", "yy"), (along, across), published, strict=True
        ):
            for sheet in range(3):
                ours = float(np.interp(force, forces, values[:, sheet]))
                title = f"stress {name}, sheet {sheet + 1}, P = {force:g}"
                found.append(Quantity(title, given[sheet], "P", 0.02, ours))
    return run.steps[-1].solution, found


def three_bars() -> Solved:
    """Three bars in parallel as sub-elements of one material in plane stress, in closed form.

    Young's moduli and yield stresses are those of SSNP303, whose sheets are not sub-elements: each
    of them is in plane stress.
    """
    stiffness = sum(young for young, _ in BARS)

    def force(strain: float) -> float:
        """The force of bars in parallel."""
        return sum(min(young * strain, stress) for young, stress in BARS)

    corners = [stress / young for young, stress in BARS]
    curve = [(strain, force(strain)) for strain in (*corners, 2 * corners[-1])]
    sheet = Material.cyclic(young=stiffness, poisson=0.25, curve=curve)
    held = {"left": (0, None), "clamped": (None, 0)}
    problem = Problem(
        block.structured_mesh(1, 1),
        sheet,
        None,
        prescribed=held,
        kinematics="plane stress",
    )
    found = []
    for strain in (0.5 * corners[0], 2 * corners[0], 1.5 * corners[1]):
        load = {"right": (force(strain), 0.0)}
        result = semismooth_newton(problem.changed(traction=load)).raise_for_status()
        moved = float(result.displacement(problem.mesh(1.0, 0.5))[0])
        found.append(
            Quantity(f"strain at P = {force(strain):g}", strain, "C", 1e-6, moved)
        )
    return result, found


RADII = (1.0, 1.5)
YIELD = 1.0


def hoop(radial: float) -> float:
    """The larger stress of von Mises' ellipse in plane stress, where the other one is known."""
    return (radial + math.sqrt(max(4 * YIELD**2 - 3 * radial**2, 0.0))) / 2


def ring_limit() -> float:
    """The inner pressure at which the whole ring yields: d sigma_r/dr = (sigma_t - sigma_r)/r."""
    run = solve_ivp(
        lambda r, s: [(hoop(s[0]) - s[0]) / r], RADII[::-1], [0.0], rtol=1e-10
    )
    return float(-run.y[0, -1])


def quarter_ring(n: int) -> Mesh:
    """A quarter of a ring with the radii ``RADII``: n x 3 n quadrilaterals."""

    def ring_point(s: float, t: float) -> tuple[float, float]:
        """A point of the ring from one of the unit square."""
        r = RADII[0] + (RADII[1] - RADII[0]) * s
        return r * math.cos(math.pi / 2 * t), r * math.sin(math.pi / 2 * t)

    return MakeStructured2DMesh(quads=True, nx=n, ny=3 * n, mapping=ring_point)


def ring() -> Solved:
    """A thin ring, widened inside until all of it yields (Nadai).

    Hardening 1e-5 mu; a quarter of it, of curved quadrilaterals of order two.
    """
    mesh = quarter_ring(12)
    held = {"bottom": (None, 0), "top": (0, None), "left": Roller(value=-0.05)}
    problem = Problem(
        mesh,
        metal(1000.0, 0.3, YIELD),
        None,
        prescribed=held,
        kinematics="plane stress",
        order=2,
    )
    result = semismooth_newton(problem).raise_for_status()
    along = float(result.equilibrium.reactions["left"][0])
    pressure = along / RADII[0]  # the projection of a quarter of the circle
    return result, [Quantity("limit pressure", ring_limit(), "C", 0.005, pressure)]


def disc_limit() -> float:
    """rho omega^2 of a disc of radius 1 that yields everywhere: sigma_r = sigma_t at its axis."""

    def left(speed: float) -> float:
        """The radial stress that is left at the rim."""

        def slope(r: float, s: np.ndarray) -> list[float]:
            """The derivative of the radial stress by equilibrium."""
            return [(hoop(s[0]) - s[0]) / r - speed * r]

        run = solve_ivp(slope, (1e-6, 1.0), [YIELD], rtol=1e-9, atol=1e-12)
        return float(run.y[0, -1])

    return brentq(left, 1.0, 5.0, xtol=1e-8)


def disc() -> Solved:
    """A thin disc that turns ever faster, without hardening: its limit between two solves.

    Bisection of the square of the speed, by whether there is a solution.
    """

    def disc_point(s: float, t: float) -> tuple[float, float]:
        """A point of the quarter disc from one of the unit square, by concentric squares."""
        return s * math.sqrt(1 - t * t / 2), t * math.sqrt(1 - s * s / 2)

    mesh = MakeStructured2DMesh(quads=True, nx=12, ny=12, mapping=disc_point)
    perfect = Material.metal(
        young=1000.0, poisson=0.3, yield_stress=YIELD, plastic_modulus=0.0
    )
    held = {"bottom": (None, 0), "left": (0, None)}
    problem = Problem(
        mesh, perfect, None, prescribed=held, kinematics="plane stress", order=2
    )
    exact = disc_limit()
    low = 0.9 * exact
    high = 1.1 * exact
    best = None
    while high - low > 2e-3 * exact:
        speed = (low + high) / 2
        result = semismooth_newton(problem.changed(body_force=(speed * x, speed * y)))
        if result.status is Status.CONVERGED:
            low = speed
            best = result
        else:
            high = speed
    return best, [
        Quantity("rho omega^2 at the limit", exact, "C", 0.01, (low + high) / 2)
    ]


CURVE = ((0.001, 200.0), (0.002, 300.0), (0.005, 380.0), (0.01, 420.0))


def masing() -> Solved:
    """A bar with a cyclic curve: Masing's loops, by the curve twice as large.

    The steps end where the slope changes, so that sums over them are exact.
    """
    steel = Material.cyclic(young=200e3, poisson=0.3, curve=CURVE)
    amplitude = 0.01
    steps = 20
    bar = material_point(
        steel, strain={"xx": [amplitude, -amplitude, amplitude]}, steps=steps
    )
    strain = bar.strain[:, 0, 0]
    stress = bar.stress[:, 0, 0]
    loop = np.trapezoid(stress[steps - 1 :], strain[steps - 1 :])
    strains, stresses = np.transpose([(0.0, 0.0), *CURVE])
    below = np.trapezoid(stresses, strains)
    area = 8 * below - 4 * amplitude * stresses[-1]
    quarter = steps + steps // 4 - 1
    turned = stresses[-1] - 2 * np.interp(amplitude / 4, strains, stresses)
    return None, [
        Quantity("area of the loop", area, "C", 1e-3, float(loop)),
        Quantity("stress after a quarter", turned, "C", 1e-6, float(stress[quarter])),
        Quantity("stress after a cycle", stresses[-1], "C", 1e-9, float(stress[-1])),
    ]


E = 1000.0
RADIUS = 1000.0
LOW = 0.02
CYCLES = 4


def bree_cycles(tension: float, heat: float) -> tuple:
    """Growth in the last cycle over R/E, its dissipation over R^2/E and volume, and the last step.

    A thin wide ring, 1 thick, has a uniform strain along it: the tension is that of a pressure
    inside, the temperature is linear in the radius.  Both are multiples of R, see ``bree``.
    """
    mesh = MakeStructured2DMesh(nx=24, ny=1, mapping=lambda s, t: (RADIUS + s, LOW * t))
    perfect = Material.metal(
        young=E, poisson=0.3, yield_stress=YIELD, plastic_modulus=0.0
    )
    problem = Problem(
        mesh,
        perfect,
        None,
        prescribed={"bottom": (None, 0)},
        pressure={"left": tension * YIELD / RADIUS},
        kinematics="axisymmetric",
    )
    hot = 2 * heat * YIELD / E * (0.5 - (x - RADIUS))
    times = tuple(0.5 * k for k in range(1, 4 * CYCLES + 1))

    def changes(time: float) -> dict:
        """The thermal strain at a time."""
        return {"initial_strain": abs((time + 1) % 2 - 1) * hot}

    run = evolve(problem, Schedule(times, changes)).raise_for_status()
    place = mesh(RADIUS + 0.5, LOW / 2)
    radial = [float(run.steps[k].fields.displacement(place)[0]) for k in (-5, -1)]
    growth = (radial[1] - radial[0]) / (RADIUS + 0.5) * E / YIELD
    volume = 2 * math.pi * (RADIUS + 0.5) * LOW
    lost = sum(run.column("dissipation")[-4:]) / volume * E / YIELD**2
    return growth, lost, run.steps[-1].solution


def bree() -> Solved:
    """Bree's plate: constant tension X, thermal stress Y that comes and goes, no hardening.

    24 elements across the wall, two steps each way, the last of four cycles.
    """
    found = []
    for X, Y in ((0.8, 1.5), (0.9, 1.0)):
        exact = 2 * Y * (1 - 2 * math.sqrt((1 - X) / Y))
        growth, _, last = bree_cycles(X, Y)
        found.append(Quantity(f"growth, X = {X}, Y = {Y}", exact, "C", 0.01, growth))
    X = 0.4
    Y = 3.5
    growth, _, last = bree_cycles(X, Y)
    exact = 2 * (X * Y - 1)
    found.append(Quantity(f"growth, X = {X}, Y = {Y}", exact, "C", 0.01, growth))
    growth, lost, _ = bree_cycles(0.2, 3.0)
    found.append(Quantity("growth, X = 0.2, Y = 3", 0.0, "C", 0.01, growth))
    found.append(
        Quantity("work, X = 0.2, Y = 3", 3 * (1 - 2 / 3) ** 2, "C", 0.01, lost)
    )
    _, lost, _ = bree_cycles(0.3, 1.2)
    found.append(Quantity("work, X = 0.3, Y = 1.2", 0.0, "C", 1e-6, lost))
    return last, found


def relaxation() -> Solved:
    """A bar of Norton's creep law that is held: (sigma_0^(1-n) + (n-1) E t/K^n)^(1/(1-n)).

    Implicit Euler steps of first order, 240 of them, each longer than the one before.
    """
    young = 150e3
    K = 1500.0
    n = 5.0
    start = 90.0
    lame_lambda, lame_mu = lame_parameters(young, 0.3)
    creeping = Material(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=1e-6,
        hardening=1e-6,
        rate=Norton(K, n),
    )
    held = {"left": (0, None), "clamped": (None, 0), "right": (start / young, None)}
    problem = Problem(
        block.structured_mesh(1, 1),
        creeping,
        None,
        prescribed=held,
        kinematics="plane stress",
    )
    times = tuple(np.geomspace(1.0, 1e5, 240).tolist())
    run = evolve(problem, Schedule(times, lambda time: {})).raise_for_status()
    found = []
    for step in (119, -1):
        time = times[step]
        exact = (start ** (1 - n) + (n - 1) * young * time / K**n) ** (1 / (1 - n))
        stress = float(run.steps[step].fields.stress(problem.mesh(0.5, 0.5))[0])
        found.append(Quantity(f"stress at t = {time:.3g}", exact, "C", 0.01, stress))
    return run.steps[-1].solution, found


R_VALUES = {0: 1.8, 45: 1.2, 90: 2.3}


def sheet() -> Solved:
    """Hill's sheet by R-values, pulled at three angles: yield stresses, and the R-values again.

    A point under tension, its axes turned; at 45 degrees it may shear.
    """
    found = []
    hill = Hill.r_values(*R_VALUES.values())
    lame_lambda, lame_mu = lame_parameters(1000.0, 0.3)
    for degrees, ratio in R_VALUES.items():
        angle = math.radians(degrees)
        turned = Hill.r_values(*R_VALUES.values(), angle=-angle)
        material = Material(
            lame_lambda=lame_lambda,
            lame_mu=lame_mu,
            yield_stress=PEEQ * YIELD,
            hardening=1e-3,
            hill=turned,
        )
        tensor = CF((1.0, 0, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))
        measure = turned.measure(tensor) / PEEQ
        square = hill.F * math.sin(angle) ** 4 + hill.G * math.cos(angle) ** 4
        square += hill.H * math.cos(2 * angle) ** 2
        square += 0.5 * hill.N * math.sin(2 * angle) ** 2
        exact = YIELD / math.sqrt(square)
        mesh = block.structured_mesh(1, 1)
        ours = YIELD / float(measure(mesh(0.5, 0.5)))
        found.append(
            Quantity(f"yield stress, {degrees} degrees", exact, "C", 1e-9, ours)
        )
        point = material_point(material, stress={"xx": exact * (1 + 1e-5)})
        p = point.plastic_strain[-1]
        found.append(
            Quantity(f"R, {degrees} degrees", ratio, "C", 1e-3, p[1, 1] / p[2, 2])
        )
    return None, found
