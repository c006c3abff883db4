"""The Hilbert space H of v = (z, q) with its product b, and the reference units of gamma.

    b([z, q], [w, r]) = <B_z z, w> + <B_q q, r>

B also measures the residual: its inverse is the solution of the Poisson problems of Algorithm 7.1.
All products have one unit, stress^2 length^(N-2), that of the gradients in Omega, so that their
sum makes sense; the others carry powers of a reference length L (``Units.length``, 1 as in the
paper).  In an L2 term it matters: L is the length beyond which such a term outweighs the gradient,
so a body of another size needs L = its size to give the scaled result.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple

from ngsolve import CF, InnerProduct, grad
from ngsolve.comp import ProxyFunction

from ngepc.checks.declared import Check, Declared, Positive
from ngepc.checks.kinds import require_instance


@dataclass(frozen=True)
class SurfaceGradient:
    """(R2): H^1_0(Gamma_c) x H^1_0(Omega)^d with L (grad z, grad w) + (grad q, grad r)."""

    fixed: ClassVar[bool] = True
    """z = 0 at the ends of Gamma_c, q = 0 on the boundary of the body."""
    values: ClassVar[float] = 0.0
    """Factor of the additional (z, w) / L and (q, r) / L^2."""

    def contact(self, z: ProxyFunction, w: ProxyFunction, length: float) -> CF:
        """The integrand of <B_z z, w> on Gamma_c, with the reference length."""
        return length * grad(z).Trace() * grad(w).Trace() + self.values / length * z * w

    def plastic(self, q: ProxyFunction, r: ProxyFunction, length: float) -> CF:
        """The integrand of <B_q q, r> in Omega."""
        return InnerProduct(grad(q), grad(r)) + self.values / length**2 * InnerProduct(
            q, r
        )


@dataclass(frozen=True)
class FullProduct(SurfaceGradient):
    """The full products of H^1(Gamma_c) x H^1(Omega)^d, (z, w) / L and (q, r) / L^2 added.

    No boundary condition at all, the alternative that section 7 names for q.
    """

    fixed = False
    values = 1.0


@dataclass(frozen=True, kw_only=True)
class Units(Declared):
    """Reference units in which gamma and the tolerance are plain numbers, docs/units.md.

    Parameters
    ----------
    stress, length
        The stress and the length that count as one, in the units of the problem.  A steel part
        in Pa and m whose scaled twin has lame_mu = 1e3 and size 1 has stress = mu / 1e3 and
        length = its size.
    """

    stress: Positive = 1.0
    length: Positive = 1.0


PRODUCT = Check(
    require_instance, kind=SurfaceGradient, needed="SurfaceGradient() or FullProduct()"
)
UNITS = Check(require_instance, kind=Units, needed="Units(...)")


@dataclass(frozen=True, kw_only=True)
class DualSpaces(Declared):
    """Choices that are fixed along a path in gamma, so that matrices are assembled once.

    Parameters
    ----------
    tichonov
        The space H and its product, by default (R2).
    units
        Reference units of gamma; their length is that of the products.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    """

    tichonov: Annotated[SurfaceGradient, PRODUCT] = field(
        default_factory=SurfaceGradient
    )
    units: Annotated[Units, UNITS] = field(default_factory=Units)


class Weights(NamedTuple):
    """gamma_z (length / stress), gamma_q (1 / stress) and gamma_T (stress / length^2)."""

    contact: float
    plastic: float
    tichonov: float


@dataclass(frozen=True)
class Coupled(DualSpaces):
    """The paper's regularisation: one gamma for contact, yield bound and Tichonov term.

    Parameters
    ----------
    gamma
        gamma > 0, a number in reference units.
    tichonov, units
        As in ``DualSpaces``.
    gamma_tichonov
        gamma_T > 0 of the Tichonov term alone, a number in reference units; None for gamma.

    Raises
    ------
    TypeError, ValueError
        If an argument is out of range or of the wrong kind.
    """

    gamma: Positive
    gamma_tichonov: Positive | None = field(default=None, kw_only=True)

    @property
    def weights(self) -> Weights:
        """The gammas in the units of the problem."""
        stress = self.units.stress
        length = self.units.length
        gamma_T = self.gamma if self.gamma_tichonov is None else self.gamma_tichonov
        return Weights(
            self.gamma * length / stress,
            self.gamma / stress,
            gamma_T * stress / length**2,
        )
