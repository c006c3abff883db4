"""Separate parameters for the terms of (D_gamma), and no error from the plastic one.

The plastic strain carries the hardening h |p|^2 / 2.  It is split, h = h_F + h_G: h_F stays in the
quadratic part F, so that D is elliptic, and h_G |p|^2 / 2 + beta |p| forms the nonsmooth part G.
The conjugate of G is the paper's penalty M^2 with gamma_q = 1 / h_G, exactly: the plastic term
is not regularised at all and its stiffness is moderate.  See docs/balanced.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from ngsolve import Integrate

from ngepc.checks.arguments import Coefficient, require_number
from ngepc.checks.kinds import require_attributes, require_instance
from ngepc.dual.plastic_strain import (
    ElementwisePlasticStrain,
    PlasticStrain,
    require_plastic_strain,
)
from ngepc.dual.predictor import ReturnMapping
from ngepc.dual.regularisation import Coupled, Units
from ngepc.dual.tichonov import FullProduct, Tichonov, require_tichonov
from ngepc.linalg.linesearch import NearMinimum
from ngepc.model.problem import Problem, as_scalar
from ngepc.parallel import gathered, vertex_coordinates

FINENESS = 500.0
"""gamma_T h_mesh^2 / (2 mu_2 + h) where gamma is not given: regularisation below 10 percent of
the discretisation error on both examples, docs/balanced.md."""

REFERENCE_STIFFNESS = 2100.0
"""2 mu_2 + h of Example (a)."""


@dataclass(frozen=True, kw_only=True)
class PenaltyContact:
    """The contact condition z <= 0 by M^1(z) = gamma_z/2 |[z]^+|^2.

    On the open gap this is an adhesion (psi - u.n)^2 / (2 gamma_z).

    Parameters
    ----------
    gamma
        gamma_z > 0, a number in reference units (length / stress).

    Raises
    ------
    TypeError, ValueError
        If gamma is out of range.
    """

    gamma: float = 1e2

    def __post_init__(self) -> None:
        require_number("gamma", self.gamma, 0, strict=True)


@dataclass(frozen=True, kw_only=True)
class ExactContact:
    """The contact condition z <= 0 as a constraint, without parameter, see ``contact_newton``.

    Parameters
    ----------
    friction_gamma
        gamma of the friction term M^3 where a problem has one, in reference units.

    Raises
    ------
    TypeError, ValueError
        If gamma is out of range.
    """

    friction_gamma: float = 1e2

    def __post_init__(self) -> None:
        require_number("friction_gamma", self.friction_gamma, 0, strict=True)


@dataclass(frozen=True, kw_only=True)
class NodalContact(ExactContact):
    """``ExactContact`` with (u.n - psi, z) integrated at the vertices of Gamma_c.

    u.n <= psi then holds at the nodes and z_i times the lumped area is the force on node i, as in
    the primal method: pressures are smoother and contact zones of few cells better, docs/step42.md.
    """


@dataclass(frozen=True)
class Balanced:
    """Hardening split for the plastic term, gamma for the Tichonov term only.

    Parameters
    ----------
    gamma
        gamma_T > 0 of the Tichonov term, a number in ``units``; None chooses it and the units by
        the problem, see ``resolved``.
    share
        h_F / h, the share of the hardening that stays in F, in (0, 1).  q stands for
        dev(h_F p) - dev sigma.
    contact
        How z <= 0 is imposed: ``ExactContact()``, ``NodalContact()`` or ``PenaltyContact(gamma)``.
    tichonov
        The space H and its product; without boundary conditions by default, docs/balanced.md.
    plastic_strain
        ``ElementwisePlasticStrain()`` as in the paper, or ``PointwisePlasticStrain()``.
    units
        Reference units of gamma and of the tolerance; None stands for Units() beside a given
        gamma and for units of the problem otherwise.
    predictor
        What a first step into the plastic range may try beside its line search; None for nothing.

    Raises
    ------
    TypeError, ValueError
        If gamma or the share is out of range, or another argument of the wrong kind.
    """

    gamma: float | None = None
    share: float = 0.5
    contact: ExactContact | PenaltyContact = field(default_factory=ExactContact)
    tichonov: Tichonov = field(default_factory=FullProduct)
    plastic_strain: PlasticStrain = field(default_factory=ElementwisePlasticStrain)
    units: Units | None = None
    predictor: ReturnMapping | None = field(default_factory=ReturnMapping)

    contact_shift = 0.0
    plastic_shift = 0.0
    linesearch = NearMinimum()

    def __post_init__(self) -> None:
        if self.gamma is not None:
            require_number("gamma", self.gamma, 0, strict=True)
            if self.units is None:
                object.__setattr__(self, "units", Units())
        if require_number("share", self.share, 0, strict=True) >= 1:
            raise ValueError(f"share={self.share!r}: a number in (0, 1) is needed")
        kinds = (ExactContact, PenaltyContact)
        require_instance(
            "contact", self.contact, kinds, "ExactContact(), NodalContact() or PenaltyContact()"
        )
        require_tichonov(self.tichonov)
        require_plastic_strain(self.plastic_strain)
        if self.units is not None:
            require_instance("units", self.units, Units, "Units(...) or None")
        if self.predictor is not None:
            needed = "ReturnMapping() or None"
            require_attributes("predictor", self.predictor, ("improved", "start"), needed)

    def resolved(self, problem: Problem) -> Balanced:
        """With numbers for gamma and units: gamma_T = FINENESS (2 mu_2 + h) / h_mesh^2.

        1 / h_mesh^2 is the mean of 1 / h_T^2 over the elements T, with h_T = |T|^(1/N): where a
        mesh is graded most elements are small, and those decide.  The smoothing length
        ((2 mu_2 + h) / gamma_T)^(1/2) of the Tichonov term is then a fixed small part of h_mesh.
        The units are those in which 2 mu_2 + h has the size it has in Example (a) and the body
        the extent 1, so that nothing depends on the units of the problem.
        """
        if self.gamma is not None:
            return self
        mesh, N = problem.mesh, problem.N
        volumes = gathered(np.array(Integrate(1.0, mesh, element_wise=True)), mesh)
        stiffness = as_scalar(2 * problem.material.lame_mu + problem.material.effective_hardening)
        mean = Integrate(stiffness, mesh) / volumes.sum()
        extent = np.ptp(vertex_coordinates(mesh), axis=0).max()
        units = self.units or Units(stress=mean / REFERENCE_STIFFNESS, length=float(extent))
        gamma_T = FINENESS * mean * np.mean(volumes ** (-2 / N))
        return replace(self, gamma=float(gamma_T * units.length**2 / units.stress), units=units)

    @property
    def hardening_share(self) -> float:
        """h_F / h."""
        return self.share

    @property
    def exact_contact(self) -> bool:
        """Whether z <= 0 is a constraint."""
        return isinstance(self.contact, ExactContact)

    @property
    def nodal_contact(self) -> bool:
        """Whether the contact integrals have the vertices as points."""
        return isinstance(self.contact, NodalContact)

    @property
    def gamma_tichonov(self) -> float:
        """gamma_T (stress / length^2).

        Raises
        ------
        ValueError
            If gamma is None and not yet resolved.
        """
        if self.gamma is None:
            raise ValueError("gamma=None: call resolved(problem) first")
        return self.gamma * self.units.stress / self.units.length**2

    @property
    def gamma_contact(self) -> float:
        """gamma_z of contact and friction penalties (length / stress)."""
        gamma = self.contact.friction_gamma if self.exact_contact else self.contact.gamma
        return gamma * self.units.length / self.units.stress

    def gamma_plastic(self, problem: Problem) -> Coefficient:
        """gamma_q = 1 / h_G: no parameter, but the conjugate of h_G |p|^2 / 2 (1 / stress)."""
        h = problem.material.effective_hardening
        return 1 / ((1 - self.share) * h)

    def yield_bound(self, problem: Problem) -> Coefficient:
        """Beta (stress)."""
        return problem.beta


def split(regularisation: Coupled, share: float = 0.9) -> Balanced:
    """The paper's regularisation with the hardening split: the same gamma_T, gamma_z and spaces.

    The plastic term of ``Coupled(gamma)`` is hardening 1/gamma in G.  Here G has (1 - share) h
    instead, taken from F: the limits in gamma agree, the Newton steps are few.  The multipliers
    of its solution start the coupled problem (``follow_path(..., closing=Coupled)``).

    Parameters
    ----------
    regularisation
        The coupled one, without shifts or beta_gamma.
    share
        h_F / h in (0, 1); the nearer to 1, the nearer to the coupled problem.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """
    require_instance("regularisation", regularisation, Coupled, "Coupled(gamma)")
    shifts = (regularisation.contact_shift, regularisation.plastic_shift)
    if shifts != (0.0, 0.0) or regularisation.beta_gamma is not None:
        raise ValueError(f"regularisation={regularisation!r}: no shifts and no beta_gamma here")
    return Balanced(
        regularisation.gamma,
        share=share,
        contact=PenaltyContact(gamma=regularisation.gamma),
        tichonov=regularisation.tichonov,
        plastic_strain=regularisation.plastic_strain,
        units=regularisation.units,
    )
