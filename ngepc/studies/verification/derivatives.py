"""Exact derivatives against central differences on random problems.

Plane strain, the paper's two dimensions, axisymmetric and solid, displacements of order 1 and 2,
triangles, quadrilaterals and tetrahedra, all kinds of hardening, contact, moved supports, initial
plastic strain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import CF, Grad, InnerProduct, Sym, ds, dx, x
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.dual.newton import semismooth_newton
from ngepc.evolution.solver import evolve
from ngepc.geometries import block
from ngepc.local.system import State
from ngepc.model.kinematics import KINEMATICS
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.sensitivity.functionals import DisplacementAt, Functional, Reaction, as_functional
from ngepc.sensitivity.gradient import gradient
from ngepc.sensitivity.parameters import MATERIAL
from ngepc.sensitivity.states import Solution, states_of

STENCIL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
"""Central difference of fourth order."""

STEP = 3e-5
"""Its step, relative to the size of the parameters."""

SIDES = {True: ("bottom", "top", "right"), False: ("clamped", "contact", "right")}


def random_problem(seed: int) -> Problem:
    """A small problem that yields; kinematics and order follow ``seed``."""
    random = np.random.default_rng(seed)
    kinematics = list(KINEMATICS.values())[seed % 4]
    N, quads = kinematics.N, seed % 4 != 3 and seed % 3 == 0
    if quads:
        mesh = MakeStructured2DMesh(quads=True, nx=4, ny=4)
    else:
        size = (1.0, 0.7) if N == 2 else (1.0, 1.0, 1.0)
        mesh = block.mesh(float(random.uniform(0.2, 0.35)) if N == 2 else 0.5, size)
    bottom, top, right = SIDES[quads]
    load, along = random.uniform(2, 5), [random.uniform(-1, 1), *(N - 2) * [0.0], 1.0]
    move = random.uniform(-1e-3, 1e-3, N) * [0.0 if kinematics.hoop else 1.0, *(N - 1) * [1.0]]
    p = np.zeros((kinematics.size, kinematics.size))
    p[:2, :2] = [[3e-4, 1e-4], [1e-4, -3e-4]]
    return Problem(
        mesh,
        random_material(random),
        None,
        {right: tuple((load * np.array(along)).tolist())},
        contact=top,
        gap=float(random.uniform(-0.001, 0.003)),
        body_force=(0.0,) * (N - 1) + (load,),
        prescribed={bottom: tuple(move.tolist())},
        initial_plastic_strain=CF(tuple(p.ravel().tolist()), dims=p.shape) * (1 + x),
        kinematics=kinematics,
        order=1 + (seed // 4) % 2,
    )


def random_material(random: np.random.Generator) -> Material:
    """A material with kinematic, isotropic or combined hardening."""
    kinematic, isotropic = [(1, 0), (0, 1), (1, 1)][random.integers(3)]
    return Material.combined(
        lame_lambda=1e3 * random.uniform(0.5, 2),
        lame_mu=1e3 * random.uniform(0.5, 1.5),
        yield_stress=random.uniform(0.8, 1.4),
        hardening=kinematic * random.uniform(30, 120),
        hardening_modulus=2.0 * isotropic,
        hardening_stiffness=isotropic * random.uniform(8, 30),
    )


def functionals(problem: Problem) -> dict[str, Functional]:
    """One functional of each kind."""
    N, support = problem.N, next(iter(problem.prescribed))
    side = next(iter(problem.tractions))

    def form(u: CF, p: CF, stress: CF) -> object:
        strain = Sym(Grad(u))
        body = InnerProduct(stress, stress) + 1e5 * InnerProduct(p, p)
        return (body + 1e5 * InnerProduct(strain, strain)) * dx + 1e4 * u * u * ds(side)

    return {
        "contact force": as_functional("contact_force"),
        "energy": as_functional("primal_energy"),
        "displacement": DisplacementAt((0.9, 0.5, 0.8)[:N], N - 1),
        "reaction": Reaction(support, N - 1),
        "form": as_functional(form),
    }


def sizes(problem: Problem) -> dict[str, float]:
    """The parameters of a problem with the size of a change of order one."""
    constants = {name: getattr(problem.material, name) for name in MATERIAL}
    factors = ("traction", "body_force", "prescribed", "initial_plastic_strain")
    found = {name: float(value) for name, value in constants.items() if value}
    return found | dict.fromkeys(factors, 1.0) | {"gap": 1e-2}


def moved(problem: Problem, rates: Mapping[str, float]) -> Problem:
    """The problem with its data moved by these rates."""
    rate = {name: rates.get(name, 0.0) for name in sizes(problem)}
    constants = {name: getattr(problem.material, name) for name in MATERIAL if name in rate}
    return replace(
        problem,
        material=replace(problem.material, **{n: c + rate[n] for n, c in constants.items()}),
        traction={n: (1 + rate["traction"]) * g for n, g in problem.tractions.items()},
        body_force=(1 + rate["body_force"]) * problem.f,
        gap=problem.gap + rate["gap"],
        prescribed={
            n: tuple((1 + rate["prescribed"]) * c for c in cs)
            for n, cs in problem.prescribed.items()
        },
        initial_plastic_strain=(1 + rate["initial_plastic_strain"]) * problem.p_0,
    )


def once(problem: Problem, start: Solution | None = None) -> Solution:
    """The solution of one time step."""
    at = None if start is None else start.displacement
    return semismooth_newton(problem, start=at).raise_for_status()


def four_times(problem: Problem, start: Solution | None = None) -> Solution:
    """Loading, more loading, reversal and reloading by the traction."""
    steps = [
        (t, {"traction": {name: factor * g for name, g in problem.tractions.items()}})
        for t, factor in ((1.0, 0.6), (2.0, 1.0), (3.0, -0.3), (4.0, 0.5))
    ]
    return evolve(problem, steps).raise_for_status()


@dataclass(frozen=True)
class Comparison:
    """A derivative beside its central difference.

    Parameters
    ----------
    functional, parameter
        What was differentiated with respect to what.
    exact, difference
        The two numbers, for a change of order one.
    size
        The largest derivative of the functional with respect to any parameter.
    smooth
        Whether the same points yield and the same rows are closed all over the difference.
    """

    functional: str
    parameter: str
    exact: float
    difference: float
    size: float
    smooth: bool

    @property
    def error(self) -> float:
        """Relative to the largest derivative of the functional, if it has one that is not 0."""
        return abs(self.exact - self.difference) / (self.size or 1.0)


def last_state(result: Solution) -> State:
    """The state at the end."""
    return states_of(result)[-1]()


def compared(
    problem: Problem, solve: Callable[..., Solution] = once, every: slice = slice(None)
) -> list[Comparison]:
    """Gradients of all functionals beside central differences.

    Parameters
    ----------
    problem, solve
        What is solved, and how.
    every
        Which of the parameters in ``sizes``: all, or for tests a part of them.
    """
    result, amounts, found = solve(problem), sizes(problem), []
    chosen, here = functionals(problem), last_state(result)
    gradients = {key: gradient(result, value, list(amounts)) for key, value in chosen.items()}
    for name, amount in list(amounts.items())[every]:
        problems = [moved(problem, {name: k * STEP * amount}) for k in STENCIL]
        states = [last_state(solve(other, result)) for other in problems]
        smooth = all(same_sides(here, state) for state in states)
        for key, functional in chosen.items():
            values = [functional.slope(state).value for state in states]
            difference = float(np.dot(list(STENCIL.values()), values)) / STEP
            slopes = gradients[key]
            size = max(abs(slopes[n] * a) for n, a in amounts.items())
            found.append(Comparison(key, name, slopes[name] * amount, difference, size, smooth))
    return found


def same_sides(one: State, other: State) -> bool:
    """Whether the same points yield and the same rows press."""
    points = (one.at.yields == other.at.yields).all()
    return bool(points and ((one.multipliers > 0) == (other.multipliers > 0)).all())


def derivatives_study(
    seeds: Iterable[int] = range(200), solve: Callable[..., Solution] = once
) -> list[dict]:
    """For each random problem the largest error, and how many differences cross a kink."""
    rows = []
    for seed in seeds:
        problem = random_problem(seed)
        found = compared(problem, solve)
        smooth = [c.error for c in found if c.smooth]
        rows.append(
            {
                "seed": seed,
                "kinematics": problem.kinematics.name,
                "order": problem.order,
                "compared": len(smooth),
                "across a kink": len(found) - len(smooth),
                "largest error": max(smooth, default=0.0),
            }
        )
    return rows
