"""How displacements become strains: plane strain and stress, the paper's, axisymmetric, solid.

A kinematics knows the strain eps(u) of a displacement u, the trace-free symmetric tensors that a
plastic strain can be, and the weight of a volume integral.  Trace-free tensors are kept in
orthonormal coordinates, in place of P and M^(1/2) of (3.1): P(p) : P(q) = p . q and M = I.

    name               mesh  tensors  coordinates  strain                       weight
    "plane strain"     2D    3 x 3    d = 3        eps_zz = 0, p_zz is free     1
    "two-dimensional"  2D    2 x 2    d = 2        2 x 2, the law of the paper  1
    "plane stress"     2D    3 x 3    d = 3        eps_zz is free at each point 1
    "axisymmetric"     2D    3 x 3    d = 3        (r, z, hoop): u_r / r        2 pi r
    "solid"            3D    3 x 3    d = 5        3 x 3                        1

In plane stress the law finds the eps_zz with sigma_zz = 0; a ``thickness`` multiplies the weight of
plane strain and plane stress.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations_with_replacement, product

import numpy as np
from ngsolve import (
    CF,
    CoefficientFunction,
    Grad,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Sym,
    Trace,
    x,
)

from ngepc.checks.arguments import require_number
from ngepc.checks.coefficients import as_constant
from ngepc.checks.sentences import in_words

_R2 = math.sqrt(2.0)
_R6 = math.sqrt(6.0)

_PLANE = np.array([[[1, 0], [0, -1]], [[0, 1], [1, 0]]]) / _R2
_SOLID = np.array(
    [
        np.diag([1, -1, 0]) / _R2,
        np.diag([1, 1, -2]) / _R6,
        np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]) / _R2,
        np.array([[0, 0, 1], [0, 0, 0], [1, 0, 0]]) / _R2,
        np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0]]) / _R2,
    ]
)


@dataclass(frozen=True, eq=False)
class Kinematics:
    """How displacements become strains, one row of the table in ``ngepc.model.kinematics``.

    Parameters
    ----------
    name
        The name that ``Problem(kinematics=...)`` accepts.
    N
        Dimension of the mesh and of displacements, 2 or 3.
    basis
        Orthonormal trace-free symmetric matrices, shape (d, size, size).
    hoop
        Whether the third direction is the circumference of a body of revolution about x = 0.
    thin
        Whether sigma_zz = 0 and the law finds eps_zz, which ``strain`` is without.
    thickness
        Of a plane body (length).
    """

    name: str
    N: int
    basis: np.ndarray
    hoop: bool = False
    thin: bool = False
    thickness: float = 1.0

    def __reduce__(self) -> tuple:
        """The kinematics of the package are pickled by name and thickness."""
        for known in KINEMATICS:
            others = vars(self) | {"thickness": known.thickness}
            if all(others[name] is value for name, value in vars(known).items()):
                return package_kinematics, (self.name, self.N, self.thickness)
        return Kinematics, tuple(vars(self).values())

    @property
    def across(self) -> np.ndarray:
        """Coordinates of the deviator of a unit strain eps_zz, shape (d,)."""
        return self.basis[:, 2, 2].copy()

    @property
    def size(self) -> int:
        """Tensors are ``size`` x ``size`` matrices."""
        return self.basis.shape[1]

    @property
    def d(self) -> int:
        """Number of coordinates of a trace-free symmetric tensor."""
        return len(self.basis)

    @property
    def directions(self) -> tuple[str, str, str]:
        """Names of the directions of tensors: r, z and θ around the axis of a ring, or x, y, z."""
        return ("r", "z", "θ") if self.hoop else ("x", "y", "z")

    @property
    def weight(self) -> CoefficientFunction:
        """The factor of volume and surface integrals: 2 pi r for a ring, a thickness, 1."""
        return self.weight_at(x) if self.hoop else as_constant(self.thickness)

    def weight_at(
        self, radius: CoefficientFunction | np.ndarray
    ) -> CoefficientFunction | np.ndarray | float:
        """The same where ``x`` is ``radius``."""
        return 2 * math.pi * radius if self.hoop else self.thickness

    def strain(self, u: CoefficientFunction) -> CoefficientFunction:
        """Linearised strain eps(u), ``size`` x ``size``, of a displacement or a proxy."""
        e = Sym(Grad(u))
        if self.size == self.N:
            return e
        hoop = zero = CF(0.0)
        # evaluated on the axis too, for pictures: the radial strain
        if self.hoop and isinstance(u, GridFunction):
            off = x * x - 1e-24
            hoop = IfPos(off, u[0] / IfPos(off, x, 1.0), e[0, 0])
        elif self.hoop:
            hoop = u[0] / x
        return CF(
            (e[0, 0], e[0, 1], zero, e[1, 0], e[1, 1], zero, zero, zero, hoop),
            dims=(3, 3),
        )

    def coordinates(self, A: CoefficientFunction) -> CoefficientFunction:
        """The d coordinates of dev A, for a symmetric tensor ``A``."""
        basis = (constant(tuple(E.ravel().tolist()), self.size) for E in self.basis)
        return CF(tuple(InnerProduct(E, A) for E in basis))

    def tensor(self, p: CoefficientFunction) -> CoefficientFunction:
        """The trace-free symmetric tensor P(p) with the d coordinates ``p``."""
        parts = [p[i] for i in range(self.d)]
        zero = CF(0.0)
        entries = {}
        for i, j in combinations_with_replacement(range(self.size), 2):
            factors = self.basis[:, i, j].tolist()
            terms = [c * q for c, q in zip(factors, parts, strict=True) if c]
            entries[i, j] = entries[j, i] = sum(terms[1:], terms[0]) if terms else zero
        every = product(range(self.size), repeat=2)
        return CF(tuple(entries[pair] for pair in every), dims=(self.size, self.size))

    def deviator(self, A: CoefficientFunction) -> CoefficientFunction:
        """Dev A = A - tr(A)/size I."""
        return A - Trace(A) / self.size * Id(self.size)

    def zero(self) -> CoefficientFunction:
        """The tensor 0."""
        return constant((0.0,) * self.size**2, self.size)


@cache
def constant(entries: tuple[float, ...], size: int) -> CoefficientFunction:
    """The tensor with these entries, row by row: NGSolve takes almost a millisecond for it."""
    return CF(entries, dims=(size, size))


PLANE_STRAIN = Kinematics("plane strain", 2, _SOLID[:3])
PLANE_STRESS = Kinematics("plane stress", 2, _SOLID[:3], thin=True)
TWO_DIMENSIONAL = Kinematics("two-dimensional", 2, _PLANE)
AXISYMMETRIC = Kinematics("axisymmetric", 2, _SOLID[:3], hoop=True)
SOLID = Kinematics("solid", 3, _SOLID)

KINEMATICS = (PLANE_STRAIN, TWO_DIMENSIONAL, AXISYMMETRIC, SOLID, PLANE_STRESS)
THICK = ("plane strain", "plane stress")  # kinematics of plane bodies with a thickness


def kinematics_of(name: Kinematics | str | None, dimension: int) -> Kinematics:
    """The kinematics with a name, or itself; None is plane strain in 2D and solid in 3D."""
    if isinstance(name, Kinematics) and dimension == name.N:
        return name
    legal = {k.name: k for k in KINEMATICS if dimension == k.N}
    if name is None:
        return next(iter(legal.values()))
    needed = (
        f"kinematics={name!r}: one of {list(legal)} is needed in {dimension} dimensions"
    )
    if not isinstance(name, Kinematics | str):
        raise TypeError(needed)
    if name not in legal:
        raise ValueError(needed)
    return legal[name]


def package_kinematics(name: str, dimension: int, thickness: float) -> Kinematics:
    """The kinematics of the package with a name and a thickness."""
    known = kinematics_of(name, dimension)
    return known if known.thickness == thickness else with_thickness(known, thickness)


def with_thickness(kinematics: Kinematics, thickness: float | None) -> Kinematics:
    """The kinematics with a thickness; None for 1.

    TypeError, ValueError if it is no positive number, or the kinematics has no thickness.
    """
    t = (
        1.0
        if thickness is None
        else require_number("thickness", thickness, 0, strict=True)
    )
    if thickness is not None and kinematics.name not in THICK:
        needed = " or ".join(f"kinematics={name!r}" for name in THICK)
        given = f"thickness={in_words(thickness)} with kinematics={kinematics.name!r}"
        raise ValueError(f"{given}: {needed} is needed")
    if kinematics.name not in THICK or kinematics.thickness == t:
        return kinematics  # the user's own kinematics are kept as they are
    return replace(kinematics, thickness=t)
