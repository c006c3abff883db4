"""A contact problem with plastic flow whose solution is known in closed form.

Pick a smooth displacement u and a contact pressure pi >= 0.  The plastic strain follows from u
point by point (return_mapping.py), the stress from both, and the loads from equilibrium:

    f = -div sigma in the body,   g = sigma n on the free sides,   g = sigma n + pi n on Gamma_c,
    psi = u.n + d,   d >= 0 and d = 0 where pi > 0.

The body is elastic below and yields above a curve that no mesh follows, and it touches the
obstacle on a part of Gamma_c whose ends are no vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

from coordinates import coordinates, deviator, tensor
from ngsolve import (
    CF,
    CoefficientFunction,
    Id,
    IfPos,
    InnerProduct,
    Integrate,
    Mesh,
    Norm,
    Trace,
    cos,
    dx,
    sin,
    sqrt,
    x,
    y,
)

from ngepc.model.material import Material
from ngepc.model.problem import Problem, as_scalar

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1000.0
)

FINE_ORDER = 12


@dataclass(frozen=True, eq=False)
class Manufactured:
    """A problem with its solution.

    Parameters
    ----------
    problem
        Loads, supports and gap that belong to the solution.
    displacement
        u (length), 2 components.
    strain
        eps(u), 2 x 2.
    plastic_increment
        Coordinates of p (1), 2 components.
    stress
        sigma (stress), 2 x 2.
    contact_pressure
        pi on Gamma_c (stress), >= 0.
    """

    problem: Problem
    displacement: CoefficientFunction
    strain: CoefficientFunction
    plastic_increment: CoefficientFunction
    stress: CoefficientFunction
    contact_pressure: CoefficientFunction

    def energy(self) -> float:
        """J(u, p) of (2.14) by a high order on the mesh of the problem (force times length)."""
        problem, u, p = self.problem, self.displacement, self.plastic_increment
        elastic = self.strain - tensor(p, 2)
        stored = (
            InnerProduct(self.stress, elastic) + problem.effective_hardening * p * p
        )
        density = stored / 2 + as_scalar(problem.beta) * Norm(p) - problem.f * u
        fine = {"bonus_intorder": FINE_ORDER}
        work = sum(
            Integrate(
                g * u, problem.mesh, definedon=problem.mesh.Boundaries(name), order=20
            )
            for name, g in problem.tractions.items()
        )
        return Integrate(density * dx(**fine), problem.mesh) - work


def stretched_and_pressed(
    mesh: Mesh,
    material: Material = STEEL,
    strain: float = 2e-3,
    pressure: float = 1.0,
    order: int = 1,
) -> Manufactured:
    """The unit square, fixed below, sheared and stretched upwards, pressed by an obstacle above.

    Parameters
    ----------
    mesh
        A mesh of ``ngepc.geometries.block`` with sides (1, 1).
    material
        Material data that are numbers.
    strain
        Size of the strains (1); with the default material the upper part yields at 2e-3.
    pressure
        Largest contact pressure (stress), at x = 1/2; it falls to zero at x = 0.2 and x = 0.8.
    order
        Of the displacements of the problem.
    """
    u = strain * CF((x * y + y * y * sin(2 * x) / 2, y * y * cos(x) / 2 - x * y / 2))
    e = CF(
        (
            u[0].Diff(x),
            (u[0].Diff(y) + u[1].Diff(x)) / 2,
            (u[0].Diff(y) + u[1].Diff(x)) / 2,
            u[1].Diff(y),
        ),
        dims=(2, 2),
    )
    p = returned(e, material)
    elastic = e - tensor(p, 2)
    sigma = (
        material.lame_lambda * Trace(elastic) * Id(2) + 2 * material.lame_mu * elastic
    )
    f = CF(
        tuple(-sigma[i, 0].Diff(x) - sigma[i, 1].Diff(y) for i in range(2))
    ).Compile()
    sigma = sigma.Compile()
    inside = 1 - ((x - 0.5) / 0.3) ** 2
    pi = pressure * IfPos(inside, inside * inside, 0.0)
    apart = strain * IfPos(inside, 0.0, inside * inside)
    problem = Problem(
        mesh,
        material,
        clamped="clamped",
        traction={
            "left": CF((-sigma[0, 0], -sigma[1, 0])).Compile(),
            "right": CF((sigma[0, 0], sigma[1, 0])).Compile(),
            "contact": CF((sigma[0, 1], sigma[1, 1] + pi)).Compile(),
        },
        body_force=f,
        contact="contact",
        gap=u[1] + apart,
        kinematics="two-dimensional",
        order=order,
    )
    return Manufactured(problem, u, e.Compile(), p.Compile(), sigma, pi)


def returned(e: CoefficientFunction, material: Material) -> CoefficientFunction:
    """Coordinates of the plastic strain of a first step with strain ``e``: the radial return."""
    N = e.dims[0]
    s = 2 * material.lame_mu * coordinates(deviator(e, N), N)
    size = sqrt(s * s + 1e-300)
    excess = size - material.yield_stress
    modulus = 2 * material.lame_mu + material.effective_hardening
    return IfPos(excess, excess, 0.0) / (modulus * size) * s
