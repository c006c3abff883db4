"""Hill's ellipsoid: a yield stress that depends on the direction in the sheet, with its axes.

R. Hill, A theory of the yielding and plastic flow of anisotropic metals, Proc. R. Soc. A 193, 1948:
in the axes 1, 2, 3 of the material

    S^2 = F (s_22 - s_33)^2 + G (s_33 - s_11)^2 + H (s_11 - s_22)^2
          + 2 L s_23^2 + 2 M s_31^2 + 2 N s_12^2,

where S takes the place of the equivalent stress of von Mises, F = G = H = 1/2, L = M = N = 3/2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from ngsolve import CF, CoefficientFunction, cos, sin, sqrt

from ngepc.checks.arguments import Coefficient, is_number, require_number
from ngepc.checks.declared import Datum, Declared, PositiveDatum

_LEAST = 1e-12  # relative size of the smallest eigenvalue that a form may have


@dataclass(frozen=True, kw_only=True, eq=False)
class Hill(Declared):
    """Anisotropic yield of a material, relative to its ``yield_stress``.

    Parameters
    ----------
    F, G, H
        Coefficients of the squares of differences of normal stresses (1).
    L, M, N
        Coefficients of twice the squares of shear stresses (1), > 0.
    angle
        From the axis x to the axis 1 of the material, about z (radians); a number, at most 2 pi, or
        a coefficient.

    Raises
    ------
    TypeError, ValueError
        For what is no number in its legal range, or where S^2 is not positive.
    """

    F: Datum = 0.5
    G: Datum = 0.5
    H: Datum = 0.5
    L: PositiveDatum = 1.5
    M: PositiveDatum = 1.5
    N: PositiveDatum = 1.5
    angle: Datum = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if is_number(self.angle) and abs(self.angle) > 2 * math.pi:
            needed = "radians are needed, at most one turn, 2 pi"
            raise ValueError(f"angle={self.angle:g}: {needed}")

    @classmethod
    def r_values(
        cls, r_0: float, r_45: float, r_90: float, angle: Coefficient = 0.0
    ) -> Hill:
        """A sheet by its R-values (plastic strain in the width over that in the thickness).

        ``r_0`` is that of a bar along the axis 1, whose yield stress is that of the material;
        ``r_45`` and ``r_90`` are those at 45 and 90 degrees to it, all > 0.  Out of the plane the
        sheet shears like an isotropic one.
        """
        for name, value in (("r_0", r_0), ("r_45", r_45), ("r_90", r_90)):
            require_number(name, value, 0, strict=True)
        G = 1 / (1 + r_0)
        F = G * r_0 / r_90
        return cls(F=F, G=G, H=r_0 * G, N=(F + G) * (r_45 + 0.5), angle=angle)

    @classmethod
    def yield_ratios(
        cls,
        *,
        r_11: float = 1.0,
        r_22: float = 1.0,
        r_33: float = 1.0,
        r_12: float = 1.0,
        r_23: float = 1.0,
        r_31: float = 1.0,
        angle: Coefficient = 0.0,
    ) -> Hill:
        """Ratios > 0 of the yield stresses along the axes and in shear to the isotropic ones."""
        given = {"r_11": r_11, "r_22": r_22, "r_33": r_33}
        given |= {"r_12": r_12, "r_23": r_23, "r_31": r_31}
        for name, value in given.items():
            require_number(name, value, 0, strict=True)
        one, two, three = (1 / r**2 for r in (r_11, r_22, r_33))
        return cls(
            F=(two + three - one) / 2,
            G=(three + one - two) / 2,
            H=(one + two - three) / 2,
            L=1.5 / r_23**2,
            M=1.5 / r_31**2,
            N=1.5 / r_12**2,
            angle=angle,
        )

    def _in_axes(self, s: CoefficientFunction) -> CoefficientFunction:
        """A tensor in the axes of the material."""
        cosine = cos(self.angle)
        sine = sin(self.angle)
        turned = CF((cosine, -sine, 0, sine, cosine, 0, 0, 0, 1), dims=(3, 3))
        return turned.trans * s * turned

    def dual_measure(self, p: CoefficientFunction) -> CoefficientFunction:
        """The g of a plastic strain, scalar (1): the largest s : p for ``measure`` s <= 1.

        (2/3)^(1/2) g is the equivalent plastic strain of Hill, and g = |p| for von Mises.
        """
        own = self._in_axes(p)
        F = self.F
        G = self.G
        H = self.H
        first = G * own[1, 1] - H * own[2, 2]
        second = H * own[2, 2] - F * own[0, 0]
        third = F * own[0, 0] - G * own[1, 1]
        square = F * first**2 + G * second**2 + H * third**2
        square = square / (F * G + G * H + H * F) ** 2
        shear = own[1, 2] ** 2 / self.L + own[2, 0] ** 2 / self.M
        shear = shear + own[0, 1] ** 2 / self.N
        return sqrt(1.5 * (square + 2 * shear))

    def measure(self, s: CoefficientFunction) -> CoefficientFunction:
        """(2/3)^(1/2) S of a stress tensor, scalar (stress): |dev s| for von Mises."""
        own = self._in_axes(s)
        square = self.F * (own[1, 1] - own[2, 2]) ** 2
        square = square + self.G * (own[2, 2] - own[0, 0]) ** 2
        square = square + self.H * (own[0, 0] - own[1, 1]) ** 2
        shear = (
            self.L * own[1, 2] ** 2 + self.M * own[2, 0] ** 2 + self.N * own[0, 1] ** 2
        )
        return sqrt(2 / 3 * (square + 2 * shear))

    def form(
        self, basis: np.ndarray, values: Callable[[Coefficient], np.ndarray]
    ) -> np.ndarray:
        """The matrix of 2/3 S^2 on the coordinates of deviators, (points, d, d).

        It is the unit matrix for von Mises.  ``basis`` (d, 3, 3) are the tensors of the
        coordinates, ``values`` gives a datum at the points.  ValueError where it is not positive
        definite.
        """
        given = {
            field.name: values(getattr(self, field.name)) for field in fields(self)
        }
        angle = given["angle"]
        cosine = np.cos(angle)
        sine = np.sin(angle)
        zero = np.zeros_like(cosine)
        axes = np.stack(
            [
                np.stack([cosine, -sine, zero], axis=-1),
                np.stack([sine, cosine, zero], axis=-1),
                np.stack([zero, zero, zero + 1.0], axis=-1),
            ],
            axis=-2,
        )
        turned = np.einsum("pki,dkl,plj->pdij", axes, basis, axes, optimize=True)
        squares = {
            "F": turned[..., 1, 1] - turned[..., 2, 2],
            "G": turned[..., 2, 2] - turned[..., 0, 0],
            "H": turned[..., 0, 0] - turned[..., 1, 1],
            "L": np.sqrt(2) * turned[..., 1, 2],
            "M": np.sqrt(2) * turned[..., 2, 0],
            "N": np.sqrt(2) * turned[..., 0, 1],
        }
        form = sum(
            given[name][:, None, None] * v[:, :, None] * v[:, None, :]
            for name, v in squares.items()
        )
        form = 2 / 3 * form
        eigenvalues = np.linalg.eigvalsh(form)
        if (eigenvalues[:, 0] <= _LEAST * eigenvalues[:, -1]).any():
            raise ValueError(f"{self!r}: S^2 > 0 is needed for every deviator")
        return form
