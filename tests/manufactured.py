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

from ngepc.model.data import as_scalar
from ngepc.model.material import Material
from ngepc.model.problem import Problem

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
    e = strain_of(u)
    p = returned(e, material)
    sigma = stress(u, material)
    f = body_force(material, strain)
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


def strain_of(u: CoefficientFunction) -> CoefficientFunction:
    """The symmetric gradient of a function of x and y."""
    shear = (u[0].Diff(y) + u[1].Diff(x)) / 2
    return CF((u[0].Diff(x), shear, shear, u[1].Diff(y)), dims=(2, 2))


def stress(u: CoefficientFunction, material: Material) -> CoefficientFunction:
    """The stress of a first step with displacement ``u``, 2 x 2."""
    e = strain_of(u)
    elastic = e - tensor(returned(e, material), 2)
    return (
        material.lame_lambda * Trace(elastic) * Id(2) + 2 * material.lame_mu * elastic
    )


def returned(e: CoefficientFunction, material: Material) -> CoefficientFunction:
    """Coordinates of the plastic strain of a first step with strain ``e``: the radial return."""
    N = e.dims[0]
    s = 2 * material.lame_mu * coordinates(deviator(e, N), N)
    size = sqrt(s * s + 1e-300)
    excess = size - material.yield_stress
    modulus = 2 * material.lame_mu + material.effective_hardening
    return IfPos(excess, excess, 0.0) / (modulus * size) * s


def body_force(material: Material, strain: float) -> CoefficientFunction:
    """-div sigma with a name for every derivative: NGSolve's own takes ten times as long.

    With a = (e_xx - e_yy)/2 and b = e_xy the deviator of the strain is (a, b; b, -a), its norm
    r = (2 a^2 + 2 b^2)^(1/2), and 2 mu p = factor times it.
    """
    s2, c2 = strain * sin(2 * x), strain * cos(2 * x)
    s1, c1 = strain * sin(x), strain * cos(x)
    # second derivatives of u
    u_xx, u_xy, u_yy = -2 * y * y * s2, strain + 2 * y * c2, s2
    v_xx, v_xy, v_yy = -y * y * c1 / 2, -y * s1 - strain / 2, c1
    # half the difference of the normal strains, the shear strain, and their derivatives
    a = (strain * y + y * y * c2 - y * c1 + strain * x / 2) / 2
    b = (strain * x + y * s2 - y * y * s1 / 2 - strain * y / 2) / 2
    a_x, a_y = (u_xx - v_xy) / 2, (u_xy - v_yy) / 2
    b_x, b_y = (u_xy + v_xx) / 2, (u_yy + v_xy) / 2

    mu, bound = material.lame_mu, material.yield_stress
    elastic_x = material.lame_lambda * (u_xx + v_xy) + 2 * mu * (u_xx + b_y)
    elastic_y = material.lame_lambda * (u_xy + v_yy) + 2 * mu * (b_x + v_yy)

    share = 4 * mu * mu / (2 * mu + material.effective_hardening)
    square = 2 * (a * a + b * b) + 1e-300
    r = sqrt(square)
    factor = share * (1 - bound / (2 * mu * r))
    slope = share * bound / (2 * mu * r * square)
    factor_x = slope * 2 * (a * a_x + b * b_x)
    factor_y = slope * 2 * (a * a_y + b * b_y)
    plastic_x = factor_x * a + factor_y * b + factor * (a_x + b_y)
    plastic_y = factor_x * b - factor_y * a + factor * (b_x - a_y)

    yields = 2 * mu * r - bound
    return CF(
        (
            IfPos(yields, plastic_x, 0.0) - elastic_x,
            IfPos(yields, plastic_y, 0.0) - elastic_y,
        )
    ).Compile()
