"""Published problems of solids: material points and limit loads."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from ngsolve import x as X
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.evolution.material_point import material_point
from ngepc.geometries.published import half_block
from ngepc.methods.newton import semismooth_newton
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.model.tensile import lame_parameters
from ngepc.results.result import Result

ELASTIC = 1e9
"""A yield stress that is never reached."""
NEARLY_PERFECT = 1e-5
"""Hardening over shear modulus, used for perfect plasticity."""


class Quantity(NamedTuple):
    """One number of a problem: name, reference, kind of reference, tolerance, and our number.

    ``kind`` is P for published, C for a closed form, O for a separate computation.  The tolerance
    is relative.
    """

    name: str
    reference: float
    kind: str
    tolerance: float
    ours: float

    @property
    def difference(self) -> float:
        """Relative difference of our number from the reference; absolute if that is 0."""
        return self.ours / self.reference - 1 if self.reference else self.ours

    @property
    def holds(self) -> bool:
        """Whether the difference is within the tolerance."""
        return abs(self.difference) <= self.tolerance


Solved = tuple[Result | None, list[Quantity]]
"""A result, None for a material point, and the numbers compared."""


def metal(
    young: float,
    poisson: float,
    stress: float,
    *,
    isotropic: float = 0.0,
    kinematic: float = 0.0,
) -> Material:
    """Von Mises plasticity from uniaxial data: yield stress and plastic moduli (stress)."""
    lame_lambda, lame_mu = lame_parameters(young, poisson)
    bound = math.sqrt(2 / 3) * stress
    least = 0.0 if isotropic or kinematic else NEARLY_PERFECT * lame_mu
    elastic = {"lame_lambda": lame_lambda, "lame_mu": lame_mu, "yield_stress": bound}
    laws = {"hardening_modulus": 1 / bound, "hardening_stiffness": 2 / 3 * isotropic}
    return Material(**elastic, hardening=max(2 / 3 * kinematic, least), **laws)


NL1_CORNERS = ((1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 0))
NL1_STRESS = {
    62.5e3: (5.000, 5.862, 5.482, 6.362, 6.640, 7.322, 4.230, 5.673),
    0.0: (5, 5, 5, 5, 5, 5, 3.917, 5),
}
"""Plastic modulus -> von Mises stress at the ends of the legs."""


def nl1() -> Solved:
    """NAFEMS NL1: a point whose strains are all given, in multiples of 0.25e-4.

    Ours is the limit of many increments, extrapolated from 50 and 100 on each leg; the published
    values of the last two legs lie up to 1 percent beside the limit.
    """
    strain: dict[str, object] = dict.fromkeys(("zz", "xy", "xz", "yz"), 0.0)
    strain |= {
        n: 0.25e-4 * c
        for n, c in zip(("xx", "yy"), np.transpose(NL1_CORNERS), strict=True)
    }
    found = []
    for modulus, published in NL1_STRESS.items():
        metal_h = metal(250e3, 0.25, 5.0, isotropic=modulus)
        runs = [material_point(metal_h, strain=strain, steps=n) for n in (50, 100)]
        coarse, fine = (run.von_mises[run.corners] for run in runs)
        limit = 2 * fine - coarse  # implicit Euler is of first order
        for leg, (value, ours) in enumerate(zip(published, limit, strict=True), 1):
            found.append(
                Quantity(f"H = {modulus:g}, leg {leg}", value, "P", 0.01, float(ours))
            )
    return None, found


TANGENT = 195000 * 1930 / (195000 - 1930)
STRESS = {"A": (151.2, 93.1), "B": (257.2, 33.1)}
STRAIN = {"A": (0.0148297, 0.0136014, 0.0205473), "B": (0.035265, 0.020471, 0.042329)}
TOLERANCE = {"A": 1e-3, "B": 1e-2}
"""At two corners: sigma_xx and tau_xy; strains xx, xy and cumulated plastic strain."""


def pulled(material: Material, corners: str) -> Solved:
    """A point under (sigma_xx, tau_xy) to A and on to B: strains and cumulated plastic strain."""
    xx, xy = np.transpose([STRESS[corner] for corner in corners])
    run = material_point(material, stress={"xx": xx, "xy": xy}, steps=50)
    computed = (
        run.strain[:, 0, 0],
        run.strain[:, 0, 1],
        run.accumulated_plastic_strain,
    )
    quantities = []
    for corner, end in zip(corners, run.corners, strict=True):
        rows = zip(("eps_xx", "eps_xy", "p"), computed, STRAIN[corner], strict=True)
        for name, ours, value in rows:
            given = (f"{name} at {corner}", value, "P", TOLERANCE[corner])
            quantities.append(Quantity(*given, float(ours[end])))
    return None, quantities


def ssnp15() -> Solved:
    """Code_Aster SSNP15: tension and shear to A and on to B, isotropic hardening.

    50 increments to A and 50 from there to B.
    """
    return pulled(metal(195000, 0.3, 181, isotropic=TANGENT), "AB")


def ssnp14() -> Solved:
    """Code_Aster SSNP14: the same with kinematic hardening, to A."""
    return pulled(metal(195000, 0.3, 181, kinematic=TANGENT), "A")


HILL_PRESSURES = (0.13, 0.15, 0.17, 0.18, 0.185)


def hill() -> Solved:
    """Hill's thick cylinder in plane strain, 100 <= r <= 200: pressures up to the limit.

    Hardening 1e-5 mu. The closed form takes sigma_zz for the mean of the other two stresses, which
    is exact for nu = 1/2.
    """
    mesh = MakeStructured2DMesh(
        nx=80, ny=1, mapping=lambda s, t: (100 + 100 * s, 2 * t)
    )
    k = 0.24 / math.sqrt(3)
    flat = {"bottom|top": (None, 0)}
    body = {"kinematics": "axisymmetric", "order": 2, "prescribed": flat}
    free = Problem(mesh, metal(210.0, 0.3, 0.24), None, **body)
    blown = replace(free, prescribed=flat | {"left": (2.0, None)})
    limit = semismooth_newton(blown).raise_for_status()
    found = limit.equilibrium.reactions["left"][0] / (2 * math.pi * 100 * 2)
    quantities = [
        Quantity("limit pressure", 2 * k * math.log(2), "C", 0.005, float(found))
    ]
    for pressure in HILL_PRESSURES:
        loaded = replace(free, pressure={"left": pressure})
        state = semismooth_newton(loaded).raise_for_status().state
        r = float(state.discrete.points.at(X)[state.at.yields].max())
        closed = k * (2 * math.log(r / 100) + 1 - (r / 200) ** 2)
        quantities.append(
            Quantity(f"p at plastic radius {r:.1f}", closed, "C", 0.005, pressure)
        )
    return limit, quantities


def prandtl() -> Solved:
    """Prandtl's rough flat punch of half width 1 on a half-plane, moved until all flows.

    Hardening 1e-5 mu, displacements of order two; from above, as the theorems say.
    """
    body = half_block(6, 4, 1.0, 0.03, 0.25)
    perfect = metal(1e3, 0.3, math.sqrt(3))  # k = 1
    held = {"contact": (0, -0.1), "symmetry": (0, None), "bottom|right": (0, 0)}
    problem = Problem(body, perfect, None, prescribed=held, order=2)
    result = semismooth_newton(problem).raise_for_status()
    mean = -float(result.equilibrium.reactions["contact"][1])
    return result, [Quantity("mean pressure / k", 2 + math.pi, "C", 0.02, mean)]
