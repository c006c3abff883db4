"""Von Mises material with hardening, kinematic, isotropic or both (section 2; docs/hardening.md).

Elasticity is C e = mu_1 tr(e) I + 2 mu_2 e.  The yield function is

    phi(sigma, alpha) = |dev sigma - dev alpha_2|_F - sigma_y (1 + H alpha_1),

with the back stress alpha_2 = k p (kinematic) and the scalar alpha_1 (isotropic).  Eliminating
alpha from one time step leaves two numbers:

    effective_hardening   h    = k + (H sigma_y)^2 k_1     in  H~ p : p = h |p|^2,
    yield_bound           beta = sigma_y (1 + H alpha_1,0) in  int beta |p|.

A ``HardeningLaw`` R adds (2/3)^(1/2) (R(PEEQ) - R(0)) to the bound: then int beta |p| becomes the
integral of a convex function of |p|.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, fields
from typing import Annotated, ClassVar

from ngsolve import CoefficientFunction

from ngepc._deprecated import old_names
from ngepc.checks.arguments import Coefficient, is_number
from ngepc.checks.declared import (
    Check,
    Datum,
    Declared,
    NotNegativeDatum,
    PositiveDatum,
)
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.model.hardening import HardeningLaw
from ngepc.model.hill import Hill
from ngepc.model.overlay import Overlay
from ngepc.model.tensile import (
    PEEQ,
    elastic_data,
    kinematic_share_of,
    law_of_curve,
    plastic_data,
)
from ngepc.model.viscosity import RateLaw

RATE = {"kind": RateLaw, "needed": "a RateLaw such as Norton(...)"}
HILL = {"kind": Hill, "needed": "Hill(...)"}
OVERLAY = {"kind": Overlay, "needed": "Overlay(...)"}
LAW = {"kind": HardeningLaw, "needed": "a HardeningLaw such as Voce(...)"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Material(Declared):
    """Material data with the paper's names; numbers or scalar coefficients, stresses in one unit.

    ``Material.metal`` takes the numbers of data sheets, Young's modulus, the yield stress of a
    tensile test and so on.  Here ``yield_stress`` is the bound of |dev sigma|, (2/3)^(1/2) times
    that of a tensile test.

    Parameters
    ----------
    lame_lambda, lame_mu
        Lamé parameters mu_1 and mu_2 (stress); elliptic means lame_mu > 0 and
        N lame_lambda + 2 lame_mu > 0 in N dimensions.
    yield_stress
        sigma_y > 0 (stress), compared with the Frobenius norm |dev sigma|_F.
    hardening
        Kinematic modulus k >= 0 (stress), H = k I in the paper.
    hardening_modulus, hardening_stiffness
        Isotropic data H >= 0 (1) and k_1 >= 0 (stress): h gains (H sigma_y)^2 k_1.
    law
        Isotropic hardening beyond that, by what its flow stress gains; None if there is none.
    rate
        Overstress that depends on the rate of plastic strain, such as ``Norton(...)``, or None.
        With a rate, time steps need a length, ``Problem.duration``.
    hill
        Anisotropic yield; None for von Mises.  Isotropic hardening enlarges the ellipsoid.
    overlay
        Sub-elements that yield one after the other, without other hardening (``Material.cyclic``);
        ``yield_stress`` is then the bound of the first one.  None for a single yield surface.

    Raises
    ------
    TypeError, ValueError
        For anything that is not a finite number or scalar coefficient in its legal range.
    """

    lame_lambda: Datum
    lame_mu: PositiveDatum
    yield_stress: PositiveDatum
    hardening: NotNegativeDatum = 0.0
    hardening_modulus: NotNegativeDatum = 0.0
    hardening_stiffness: NotNegativeDatum = 0.0
    law: Annotated[HardeningLaw, Check(require_instance, **LAW)] | None = None
    rate: Annotated[RateLaw, Check(require_instance, **RATE)] | None = None
    hill: Annotated[Hill, Check(require_instance, **HILL)] | None = None
    overlay: Annotated[Overlay, Check(require_instance, **OVERLAY)] | None = None

    _call: ClassVar[tuple[str, tuple[tuple[str, object], ...]]] = ("Material", ())
    """The constructor of a data sheet that made the material, and its arguments."""

    @classmethod
    def metal(
        cls,
        *,
        young: Coefficient,
        poisson: Coefficient,
        yield_stress: Coefficient | None = None,
        tangent_modulus: Coefficient | None = None,
        plastic_modulus: Coefficient | None = None,
        curve: Sequence[tuple[float, float]] | None = None,
        kind: str = "isotropic",
        kinematic_share: float | None = None,
        rate: RateLaw | None = None,
        hill: Hill | None = None,
    ) -> Material:
        """A metal by the numbers of a tensile test, as on a data sheet.

        Parameters
        ----------
        young, poisson
            Young's modulus E > 0 (stress), Poisson's ratio in (-1, 1/2) (1).
        yield_stress
            R > 0, at which a bar begins to yield (stress).  With a curve None for its first point.
        tangent_modulus
            Slope E_t of the stress-strain curve beyond yielding, 0 <= E_t < E (stress).
        plastic_modulus
            Slope H' >= 0 of the stress over the plastic strain (stress): give one of the two, or a
            curve.  Zero is perfect plasticity.
        curve
            Pairs (total strain, stress) of a tensile test; the stress stays at its last value.
        kind
            "isotropic": the yield stress grows, also for the way back; "kinematic": it moves along
            (Bauschinger's effect); "mixed".  A curve is isotropic.
        kinematic_share
            The part of the hardening that is kinematic if it is mixed, in (0, 1).
        rate
            Overstress that depends on the rate of plastic strain, such as ``Norton(...)``, or None.
        hill
            Anisotropic yield of a rolled sheet, such as ``Hill.r_values(...)``, or None.  The other
            numbers are those of a bar along its axis 1, and ``kind`` is "isotropic".

        Returns
        -------
        Material
            It prints as it was given.

        Raises
        ------
        TypeError, ValueError
            If a value is not legal, or the hardening is not given exactly once.
        """
        ways = {
            "tangent_modulus": tangent_modulus,
            "plastic_modulus": plastic_modulus,
            "curve": curve,
        }
        lame_lambda, lame_mu = elastic_data(young, poisson)
        share = kinematic_share_of(kind, kinematic_share)
        if hill is not None and share > 0:
            raise ValueError(
                f"kind={kind!r}: kind='isotropic' is needed with hill (Material(...) "
                "takes the modulus of a back stress)"
            )
        data = plastic_data(young, yield_stress, ways, share)
        data |= {"lame_lambda": lame_lambda, "lame_mu": lame_mu}
        metal = cls(**data, rate=rate, hill=hill)
        given = {
            "young": young,
            "poisson": poisson,
            "yield_stress": yield_stress,
            **ways,
        }
        given |= {"kind": kind, "kinematic_share": kinematic_share, "rate": rate}
        given |= {"hill": hill}
        return metal._printed_as("Material.metal", given)

    @classmethod
    def cyclic(
        cls,
        *,
        young: float,
        poisson: float,
        curve: Sequence[tuple[float, float]],
        yield_stress: float | None = None,
    ) -> Material:
        """A metal by its cyclic stress-strain curve, with sub-elements in parallel (Besseling).

        A bar that is loaded for the first time follows the curve; each later branch of a loop is
        the curve twice as large (Masing), begins to yield early (Bauschinger), and the loop is
        closed after the first cycle.  Hence there is no ratcheting, and the mean stress of a cycle
        between two strains does not relax.  Neither of them has a potential.

        Parameters
        ----------
        young, poisson
            Young's modulus E > 0 (stress), Poisson's ratio in (-1, 1/2) (1).
        curve
            Pairs (strain amplitude, stress amplitude) of stabilised cycles, two at least beyond the
            origin; straight between them, and the last line goes on.  It must not bend upwards.
        yield_stress
            At which the bar begins to yield (stress).  None for the first point of the curve.

        Returns
        -------
        Material
            It prints as it was given.

        Raises
        ------
        TypeError, ValueError
            If a value is not legal, or the curve bends upwards.
        """
        lame_lambda, lame_mu = elastic_data(young, poisson)
        overlay = Overlay.of_curve(law_of_curve(young, curve, yield_stress), lame_mu)
        metal = cls(
            lame_lambda=lame_lambda,
            lame_mu=lame_mu,
            yield_stress=overlay.bounds[0],
            overlay=overlay,
        )
        given = {"young": young, "poisson": poisson, "curve": curve}
        given |= {"yield_stress": yield_stress}
        return metal._printed_as("Material.cyclic", given)

    def _printed_as(self, constructor: str, given: dict[str, object]) -> Material:
        """The same material, which prints as the call of a constructor that made it."""
        entries = tuple((n, value) for n, value in given.items() if value is not None)
        other = copy(self)
        vars(other)["_call"] = (constructor, entries)
        return other

    @property
    def data_sheet(self) -> dict[str, object]:
        """The arguments of ``Material.metal`` or ``cyclic``, by name; empty for other materials."""
        _, given = self._call
        return dict(given)

    def __repr__(self) -> str:
        """The call that made it, numbers with all digits; coefficients by their kind."""
        name, given = self._as_call()
        texts = (f"{key}={_with_all_digits(value)}" for key, value in given.items())
        return f"{name}({', '.join(texts)})"

    def _as_call(self) -> tuple[str, dict[str, object]]:
        """Name of the constructor, and the arguments that were given."""
        if self.data_sheet:
            return self._call[0], self.data_sheet
        every = {field.name: getattr(self, field.name) for field in fields(self)}
        absent = [
            one is None or (is_number(one) and one == 0) for one in every.values()
        ]
        pairs = zip(every.items(), absent, strict=True)
        return "Material", dict(pair for pair, missing in pairs if not missing)

    @property
    def young(self) -> Coefficient:
        """Young's modulus in three dimensions (stress)."""
        lam = self.lame_lambda
        mu = self.lame_mu
        return mu * (3 * lam + 2 * mu) / (lam + mu)

    @property
    def poisson(self) -> Coefficient:
        """Poisson's ratio in three dimensions (1)."""
        return self.lame_lambda / (2 * (self.lame_lambda + self.lame_mu))

    @property
    def tensile_yield_stress(self) -> Coefficient:
        """R, at which a bar begins to yield, for tensors of three dimensions (stress)."""
        return self.yield_stress / PEEQ

    @classmethod
    def kinematic(
        cls,
        *,
        lame_lambda: Datum,
        lame_mu: Datum,
        yield_stress: Datum,
        hardening: Datum,
    ) -> Material:
        """Linear kinematic hardening: back stress ``hardening`` times p, see (2.16).

        ``yield_stress`` is the bound of |dev sigma|; ``Material.metal`` takes that of a bar.
        """
        elastic = {"lame_lambda": lame_lambda, "lame_mu": lame_mu}
        return cls(**elastic, yield_stress=yield_stress, hardening=hardening)

    @classmethod
    def isotropic(
        cls,
        *,
        lame_lambda: Datum,
        lame_mu: Datum,
        yield_stress: Datum,
        hardening_modulus: Datum,
        hardening_stiffness: Datum,
    ) -> Material:
        """Linear isotropic hardening with the paper's H and k_1, see (2.15).

        ``yield_stress`` is the bound of |dev sigma|; ``Material.metal`` takes that of a bar.
        """
        elastic = {
            "lame_lambda": lame_lambda,
            "lame_mu": lame_mu,
            "yield_stress": yield_stress,
        }
        H = hardening_modulus
        k_1 = hardening_stiffness
        return cls(**elastic, hardening_modulus=H, hardening_stiffness=k_1)

    @classmethod
    def with_law(
        cls,
        *,
        lame_lambda: Datum,
        lame_mu: Datum,
        law: HardeningLaw,
        hardening: Datum = 0.0,
    ) -> Material:
        """Isotropic hardening by the flow stress of a bar, and linear kinematic hardening."""
        yield_stress = PEEQ * require_instance("law", law, **LAW).stress(0.0)
        elastic = {"lame_lambda": lame_lambda, "lame_mu": lame_mu}
        return cls(**elastic, yield_stress=yield_stress, hardening=hardening, law=law)

    @property
    def isotropic_hardening(self) -> Coefficient:
        """(H sigma_y)^2 k_1, the isotropic part of the effective hardening (stress)."""
        H = self.hardening_modulus
        k1 = self.hardening_stiffness
        return (H * self.yield_stress) * (H * self.yield_stress) * k1

    @property
    def scalar_growth(self) -> Coefficient:
        """k_1 H sigma_y, by which alpha_1 grows with |p| (stress)."""
        return self.hardening_stiffness * self.hardening_modulus * self.yield_stress

    @property
    def effective_hardening(self) -> Coefficient:
        """The scalar h of H~ p : p = h |p|^2 in (2.14) (stress)."""
        return self.hardening + self.isotropic_hardening

    def yield_bound(
        self, hardening_variable: Coefficient = 0.0, accumulated: Coefficient = 0.0
    ) -> Coefficient:
        """Beta = sigma_y (1 + H alpha_1,0) and what the law gains up to a PEEQ (stress)."""
        bound = self.yield_stress * (1 + self.hardening_modulus * hardening_variable)
        if self.law is None:
            return bound
        return bound + PEEQ * (self.law.stress(accumulated) - self.law.stress(0.0))


def split_hardening(value: object) -> tuple:
    """(alpha_1, alpha_2) from ``initial_hardening``; None for what is not given.

    Neither for the plastic strains of sub-elements, a vector.
    """
    if isinstance(value, tuple):
        return value
    if is_vector(value):
        return (None, None)
    tensor = isinstance(value, CoefficientFunction) and len(value.dims) == 2
    return (None, value) if tensor else (value, None)


def is_vector(value: object) -> bool:
    """Whether a value is a vector-valued coefficient."""
    return isinstance(value, CoefficientFunction) and len(value.dims) == 1


def _with_all_digits(value: object) -> str:
    """A datum as Python reads it; coefficients and laws by their kind."""
    plain = is_number(value) or isinstance(value, str | list | tuple)
    return repr(value) if plain else in_words(value)


__getattr__ = old_names(__name__)
