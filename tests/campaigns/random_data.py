"""Random problems that yield and touch, with all data that derivatives are taken with respect to.

Plane strain, the paper's two dimensions, axisymmetric and solid, displacements of order 1 and 2,
triangles, quadrilaterals and tetrahedra, all laws, contact without friction, with
Tresca's and with Coulomb's, two bodies, moved supports, initial plastic strain, load histories.
"""

from collections import defaultdict
from dataclasses import replace

import numpy as np
from ngsolve import CF, Grad, InnerProduct, Sym, ds, dx, x
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.evolution.solver import evolve
from ngepc.geometries import block
from ngepc.geometries.published import stacked_blocks
from ngepc.methods.newton import semismooth_newton
from ngepc.model.hardening import Swift, Tabulated, Voce
from ngepc.model.hill import Hill
from ngepc.model.kinematics import KINEMATICS, PLANE_STRESS, TWO_DIMENSIONAL
from ngepc.model.material import Material
from ngepc.model.overlay import Overlay
from ngepc.model.places import Contact, Coulomb
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ
from ngepc.model.viscosity import Norton
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import Status
from ngepc.sensitivity.functionals import DisplacementAt, Reaction, as_functional
from ngepc.sensitivity.gradient import states_of
from ngepc.sensitivity.law_data import PARTS, with_constants
from ngepc.sensitivity.parameters import MATERIAL


def random_problem(seed):
    """A small problem that yields; kinematics, order and contact follow ``seed``."""
    random = np.random.default_rng(seed)
    kinematics = PLANE_STRESS if seed % 12 == 0 else KINEMATICS[seed % 4]
    N, two = kinematics.N, (seed // 24) % 2 == 1
    quads = seed % 4 != 3 and seed % 3 == 0 and not two
    if two:
        mesh = stacked_blocks(N, float(random.uniform(0.3, 0.4)))
    elif quads:
        mesh = MakeStructured2DMesh(quads=True, nx=4, ny=4)
    else:
        size = (1.0, 0.7) if N == 2 else (1.0, 1.0, 1.0)
        mesh = block.mesh(float(random.uniform(0.2, 0.35)) if N == 2 else 0.5, size)
    bottom, top = ("bottom", "top") if quads else ("clamped", "contact")
    load, along = random.uniform(2, 5), [random.uniform(-1, 1), *(N - 2) * [0.0], 1.0]
    move = random.uniform(-1e-3, 1e-3, N) * [
        0.0 if kinematics.hoop else 1.0,
        *(N - 1) * [1.0],
    ]
    p = np.zeros((kinematics.size, kinematics.size))
    p[:2, :2] = [[3e-4, 1e-4], [1e-4, -3e-4]]
    material, gap = random_material(random), float(random.uniform(-0.001, 0.003))
    bound, mu = float(random.uniform(0.1, 2)), Coulomb(float(random.uniform(0.1, 0.5)))
    still = (0.0,) * (N - 1) + (float(random.uniform(-0.004, -0.001)),)
    strain = {}
    if seed % 3 == 1:
        material = with_random_law(material, seed)
        strain = {"initial_strain": 1e-4}
    if seed % 3 == 2:
        material = with_random_part(material, seed, kinematics)
    if material.rate is not None:
        strain["duration"] = 1.0
    return Problem(
        mesh,
        material,
        None,
        {"right": tuple((load * np.array(along)).tolist())},
        contact=Contact("above", "below") if two else top,
        gap=None if two else gap,
        friction=(None, bound, mu)[(seed // 8) % 3],
        body_force=(0.0,) * (N - 1) + (load,),
        prescribed={bottom: tuple(move.tolist())} | ({"top": still} if two else {}),
        initial_plastic_strain=CF(tuple(p.ravel().tolist()), dims=p.shape) * (1 + x),
        kinematics=kinematics,
        order=1 + (seed // 4) % 2,
        **strain,
    )


def with_random_law(material, seed):
    """The material with a law of hardening in place of its isotropic part."""
    random = np.random.default_rng([seed, 1])
    stress = material.yield_stress / PEEQ
    more = random.uniform(1.1, 2.0)
    drawn = (
        Voce(stress, float(more), float(random.uniform(20, 200))),
        Swift(
            stress, float(random.uniform(0.002, 0.02)), float(random.uniform(0.1, 1))
        ),
        table_of_steel(stress, more),
    )
    return Material.with_law(
        lame_lambda=material.lame_lambda,
        lame_mu=material.lame_mu,
        law=drawn[(seed // 3) % 3],
        hardening=material.hardening,
    )


def with_random_part(material, seed, kinematics):
    """The material with a rate, sub-elements, or Hill's ellipsoid that may grow and creep.

    The paper's two dimensions take the rate alone.
    """
    random = np.random.default_rng([seed, 2])
    kind = (seed // 3 + seed // 15) % 5
    rate = Norton(float(random.uniform(1, 5)), float(random.uniform(1, 6)))
    if kind == 0 or kinematics is TWO_DIMENSIONAL:
        return replace(material, rate=rate)
    if kind in (1, 2):
        shares = (0.4, 0.25, 0.15, 0.1)[: random.integers(2, 5)]
        rises = np.cumprod(random.uniform(1.2, 2.0, len(shares))) * 1.1
        bounds = (rises * material.yield_stress).tolist()
        bounds[0] = float(material.yield_stress)
        overlay = Overlay(shares, bounds)
        return Material(
            lame_lambda=material.lame_lambda,
            lame_mu=material.lame_mu,
            yield_stress=bounds[0],
            overlay=overlay,
        )
    values = random.uniform(0.7, 2.5, 3).tolist()
    hill = Hill.r_values(*values, angle=float(random.uniform(-1, 1)))
    return replace(material, hill=hill, rate=rate if kind == 4 else None)


def law_of(material):
    """The name of a law for groups of problems."""
    names = ["linear"] if material.law is None else [type(material.law).__name__]
    for part in ("rate", "hill", "overlay"):
        given = getattr(material, part)
        names += [] if given is None else [type(given).__name__]
    return ", ".join(names[1:] if names[0] == "linear" and len(names) > 1 else names)


def table_of_steel(stress, more):
    """A table that reaches strain 1, as it has to where nothing else hardens."""
    strains = (0.0, 0.002, 0.05, 1.0)
    rises = (0.0, more / 4, 3 * more, 6 * more)
    return Tabulated(strains, tuple(stress + rise for rise in rises))


def random_material(random):
    """A material with kinematic, isotropic or combined hardening."""
    kinematic, isotropic = [(1, 0), (0, 1), (1, 1)][random.integers(3)]
    return Material(
        lame_lambda=1e3 * random.uniform(0.5, 2),
        lame_mu=1e3 * random.uniform(0.5, 1.5),
        yield_stress=random.uniform(0.8, 1.4),
        hardening=kinematic * random.uniform(30, 120),
        hardening_modulus=2.0 * isotropic,
        hardening_stiffness=isotropic * random.uniform(8, 30),
    )


def functionals(problem):
    """One functional of each kind."""
    N, support = problem.N, next(iter(problem.prescribed))
    side = next(iter(problem.tractions))

    def form(u, p, stress):
        strain = Sym(Grad(u))
        body = InnerProduct(stress, stress) + 1e5 * InnerProduct(p, p)
        return (body + 1e5 * InnerProduct(strain, strain)) * dx + 1e4 * u * u * ds(side)

    return {
        "contact force": as_functional("contact_force"),
        "energy": as_functional("primal_energy"),
        "displacement": DisplacementAt((0.9, 0.5, 0.6)[:N], N - 1),
        "reaction": Reaction(support, N - 1),
        "form": as_functional(form),
    }


def sizes(problem):
    """The parameters of a problem with the size of a change of order one."""
    material = problem.material
    found = {name: float(getattr(material, name)) for name in MATERIAL}
    found = {name: value for name, value in found.items() if value}
    if material.law is not None or material.overlay is not None:
        del found["yield_stress"]  # it follows these
    found |= data_of_parts(material)
    if problem.initial_strain is not None:
        found["initial_strain"] = problem.initial_strain
    factors = ("traction", "body_force", "prescribed", "initial_plastic_strain")
    found |= dict.fromkeys(factors, 1.0)
    found |= {} if problem.gap is None else {"gap": 1e-2}
    return found | ({} if problem.friction is None else {"friction": 0.3})


def data_of_parts(material):
    """The data of the laws of a material by name, with their values."""
    found = {}
    for part in PARTS:
        given = getattr(material, part)
        for field, value in [] if given is None else vars(given).items():
            name = f"{part}.{field}"
            if isinstance(value, tuple) and field != "plastic_strain":
                found |= {f"{name}[{k}]": one for k, one in enumerate(value)}
            elif field != "plastic_strain":
                found[name] = value
    return found


def moved(problem, rates):
    """The problem with its data moved by these rates."""
    rate = defaultdict(float, rates)
    before = vars(problem.material)
    before = before | data_of_parts(problem.material)
    constants = {n: before[n] + r for n, r in rates.items() if n in before}
    problem = with_constants(problem, constants)
    friction = problem.friction
    if isinstance(friction, Coulomb):
        coefficient = friction.coefficient + rate["friction"]
        friction = replace(friction, coefficient=coefficient)
    elif friction is not None:
        friction += rate["friction"]
    return replace(
        problem,
        traction={n: (1 + rate["traction"]) * g for n, g in problem.tractions.items()},
        body_force=(1 + rate["body_force"]) * problem.f,
        gap=None if problem.gap is None else problem.gap + rate["gap"],
        friction=friction,
        prescribed={
            n: tuple(None if c is None else (1 + rate["prescribed"]) * c for c in cs)
            for n, cs in problem.prescribed.items()
        },
        initial_plastic_strain=(1 + rate["initial_plastic_strain"]) * problem.p_0,
        initial_strain=None
        if problem.initial_strain is None
        else problem.initial_strain + rate["initial_strain"],
    )


TWELVE_DIGITS = NewtonOptions(tolerance=1e-12)
"""Differences divide what is left of the residual by a small step."""


def once(problem, start=None):
    """The solution of one time step."""
    at = None if start is None else start.displacement
    result = semismooth_newton(problem, start=at, options=TWELVE_DIGITS)
    return result.raise_for_status()


def carried(problem):
    """The problem with loads halved until the body carries them: a saturated law has a limit."""
    while semismooth_newton(problem).status is Status.LIMIT_LOAD:
        problem = moved(problem, {"traction": -0.5, "body_force": -0.5})
    return problem


def four_times(problem, start=None):
    """Loading, more loading, reversal and reloading by the traction."""
    steps = [
        (t, {"traction": {name: factor * g for name, g in problem.tractions.items()}})
        for t, factor in ((1.0, 0.6), (2.0, 1.0), (3.0, -0.3), (4.0, 0.5))
    ]
    return evolve(problem, steps).raise_for_status()


def last_state(result):
    """The state at the end."""
    return states_of(result)[-1]()
