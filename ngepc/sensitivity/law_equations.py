"""The equations of the law for changes of its data, of the strain and of the history.

With the trial stress s = 2 mu_2 (e - p_0) - dev alpha_2,0 and M = 2 mu_2 + h the plastic strain p
of a step is smallest for

    M/2 |p|^2 - s : p + int_0^g beta,    g the measure of p, n = dg/dp,

so that changes satisfy, where s yields, with the derivative T of p by s,

    p' = T (s' - M' p - beta(g)' n),       beta(g)' that at the same g,
    s' = (2 mu_2)' (e - p_0) + 2 mu_2 (e' - p_0') - dev alpha_2,0',
    tau' = (2 mu_2)' (e - p_0 - p) + 2 mu_2 (e' - p_0' - p'),         tau the deviatoric stress.

Hill's form A changes the measure, g^2 = p : A^-1 p, and with it

    g' = - g/2 n : A' n,    n' = - A^-1 A' n + 1/2 (n : A' n) n       for the same p.

The sub-elements of an overlay satisfy the same equations, each with its share of 2 mu_2 and its own
p_0; p and tau are sums over them.  If a component z of the strain is free, its change is the one
that keeps the conjugate stress zero.  A step passes

    p_0 + p,   dev alpha_2,0 + k p,   alpha_1 + k_1 H sigma_y g,   PEEQ  and, with friction, u_0 = u

to the next one, whose beta grows with alpha_1 by H sigma_y and with PEEQ by the law.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ngepc.discretisation.hill_law import HillLaw
from ngepc.discretisation.law import Law, Return
from ngepc.discretisation.overlay_law import OverlayLaw
from ngepc.local.system import State
from ngepc.model.tensile import PEEQ
from ngepc.sensitivity.equations import Block, Tape

Equation = tuple[str, str, Block]
"""(name, of, block): block times the array ``of`` is added to the array ``name``."""


class YieldSurface(NamedTuple):
    """A sub-element of the law, or the law itself if it has none, and its returned stress."""

    law: Law
    at: Return
    number: int | None

    def named(self, name: str) -> str:
        """The name of the surface's own array, such as "p 2" for sub-element 2."""
        return name if self.number is None else f"{name} {self.number}"


def yield_surfaces_of(state: State) -> list[YieldSurface]:
    """The sub-elements at a state; of most laws one, the law itself."""
    law = state.discrete.law
    if not isinstance(law, OverlayLaw):
        return [YieldSurface(law, state.at, None)]
    pairs = zip(law.parts, state.at.parts, strict=True)
    return [YieldSurface(*pair, number) for number, pair in enumerate(pairs)]


def equations_of_law(state: State) -> Tape:
    """The equations above at a state; ``state.at.yields`` decides where s yields."""
    law = state.discrete.law
    surfaces = yield_surfaces_of(state)
    equations: list[Equation] = []
    for surface in surfaces:
        equations += _shared(state, surface)
        equations += _of_surface(surface)
        equations += _summed(state, surface)
    equations += [("mean", "volume", law.bulk), ("mean", "bulk", state.volume)]
    equations += _free_component(state, surfaces)
    for surface in surfaces:
        equations += _gained(surface)
    if surfaces[0].number is not None:
        equations.append(("gained", "p", _along(state.at.normal)))
    return Tape([*equations, *_left_behind(state, surfaces)])


def _of_surface(surface: YieldSurface) -> list[Equation]:
    """The equations of one yield surface."""
    law, at, _ = surface
    named = surface.named
    two_mu = law.two_mu[:, None]
    normal = np.where(at.yields[:, None], at.normal, 0.0)
    sooner, dearer = law.resistance.by_accumulated(at.gained)

    def flow(s: np.ndarray) -> np.ndarray:
        """T s."""
        return law.flow_change(at, s)

    lost = -flow(normal)
    softer = -flow(at.plastic_strain)
    _, stress = law.stress(at)
    return [
        (named("beta"), "accumulated", law.resistance.growth),
        (named("radius"), named("beta"), 1.0),
        (named("radius"), "accumulated", sooner),
        (named("hardened"), named("beta"), at.gained),
        (named("hardened"), "accumulated", dearer),
        (named("radius"), "linear", at.gained),
        (named("hardened"), "linear", 0.5 * at.gained**2),
        (named("trial"), "strain", law.two_mu),
        (named("trial"), named("initial"), -law.two_mu),
        (named("trial"), "back", -1.0),
        (named("trial"), named("two_mu"), (at.trial + law.back) / two_mu),
        (named("p"), named("trial"), (flow, flow)),
        (named("p"), named("two_mu"), softer),
        (named("p"), "hardening", softer),
        (named("p"), named("radius"), lost),
        *_of_form(surface),
        (named("stress"), "strain", law.two_mu),
        (named("stress"), named("initial"), -law.two_mu),
        (named("stress"), named("p"), -law.two_mu),
        (named("stress"), named("two_mu"), stress / two_mu),
    ]


def _of_form(surface: YieldSurface) -> list[Equation]:
    """The equations of Hill's form."""
    law, at, _ = surface
    if not isinstance(law, HillLaw):
        return []
    n = np.where(at.yields[:, None], at.normal, 0.0)
    by_measure = 0.5 * (law.resistance.slope(at.gained) * at.gained - at.radius)

    def flow(A: np.ndarray) -> np.ndarray:
        """The change of p for the same s."""
        turned = np.einsum("pij,pj->pi", A, n)
        along = by_measure * np.einsum("pi,pi->p", n, turned)
        pushed = (
            at.radius[:, None] * np.linalg.solve(law.form, turned[..., None])[..., 0]
        )
        return law.flow_change(at, pushed + along[:, None] * n)

    def transposed(p: np.ndarray) -> np.ndarray:
        """The same backwards."""
        s = law.flow_change(at, p)
        pushed = at.radius[:, None] * np.linalg.solve(law.form, s[..., None])[..., 0]
        pushed += (by_measure * np.einsum("pi,pi->p", n, s))[:, None] * n
        return pushed[:, :, None] * n[:, None, :]

    return [("p", "form", (flow, transposed))]


def _shared(state: State, surface: YieldSurface) -> list[Equation]:
    """The data of a sub-element from those of the point."""
    if surface.number is None:
        return []
    law = state.discrete.law
    named = surface.named
    return [
        (named("two_mu"), "two_mu", law.shares[surface.number]),
        (named("two_mu"), named("share"), law.two_mu),
        (named("initial"), "parts", _side_by_side(state, surface)[::-1]),
    ]


def _side_by_side(state: State, surface: YieldSurface) -> tuple[Callable, Callable]:
    """The map from the plastic strain of a sub-element to those of all, and its transpose."""
    law = state.discrete.law
    d = law.back.shape[1]
    own = np.s_[:, surface.number * d : (surface.number + 1) * d]

    def put(p: np.ndarray) -> np.ndarray:
        """The plastic strains of all sub-elements, zero except this one."""
        parts = np.zeros((len(p), len(law.parts) * d))
        parts[own] = p
        return parts

    def taken(parts: np.ndarray) -> np.ndarray:
        """The plastic strain of this sub-element."""
        return parts[own]

    return put, taken


def _summed(state: State, surface: YieldSurface) -> list[Equation]:
    """The contribution of a sub-element to the plastic strain and the stress of the point."""
    if surface.number is None:
        return []
    named = surface.named
    return [
        ("p", named("p"), state.discrete.law.shares[surface.number]),
        ("p", named("share"), surface.at.plastic_strain),
        ("stress", named("stress"), 1.0),
    ]


def _free_component(state: State, surfaces: list[YieldSurface]) -> list[Equation]:
    """The equations of the free component of the strain, whose stress stays zero."""
    law = state.discrete.law
    at = state.at
    if law.across is None:
        return []
    moduli = law.closed_moduli(at, law.yielding_part(at))
    across = np.broadcast_to(law.across, at.trial.shape)
    equations: list[Equation] = [
        ("normal", "mean", 1.0),
        ("normal", "stress", (lambda s: s @ law.across, lambda n: n[:, None] * across)),
        ("free", "normal", -1 / law.stiffness_across(moduli)),
        ("volume", "free", 1.0),
        ("mean", "free", law.bulk),
        ("strain", "free", across),
    ]
    for surface in surfaces:
        named = surface.named
        pulled = surface.law.two_mu[:, None] * across
        moved = surface.law.flow_change(surface.at, pulled)
        stress = pulled - surface.law.two_mu[:, None] * moved
        equations += [
            (named("trial"), "free", pulled),
            (named("p"), "free", moved),
            (named("stress"), "free", stress),
        ]
        if surface.number is not None:
            share = law.shares[surface.number]
            equations += [("p", "free", share * moved), ("stress", "free", stress)]
    return equations


def _gained(surface: YieldSurface) -> list[Equation]:
    """The measure of the plastic strain of a yield surface."""
    law, at, _ = surface
    named = surface.named
    normal = np.where(at.yields[:, None], at.normal, 0.0)
    equations = [(named("gained"), named("p"), _along(normal))]
    if isinstance(law, HillLaw):
        by_form = form_slope(surface)
        pair = (
            lambda A: np.einsum("pij,pij->p", by_form, A),
            lambda g: g[:, None, None] * by_form,
        )
        equations.append(("gained", "form", pair))
    return equations


def form_slope(surface: YieldSurface) -> np.ndarray:
    """The derivative of g by Hill's form for the same p, - g/2 n n, shape (points, d, d)."""
    at = surface.at
    n = np.where(at.yields[:, None], at.normal, 0.0)
    return -0.5 * at.gained[:, None, None] * n[:, :, None] * n[:, None, :]


def _along(normal: np.ndarray) -> Block:
    """The product with vectors at the points."""
    return (lambda p: np.einsum("pd,pd->p", normal, p), lambda g: normal * g[:, None])


def _left_behind(state: State, surfaces: list[YieldSurface]) -> list[Equation]:
    """The equations of the history variables for the next step."""
    at = state.at
    points = state.discrete.points
    material = state.discrete.law.material
    growth = points.at(material.scalar_growth)
    sharper = points.at(material.yield_stress * material.hardening_modulus)
    equations: list[Equation] = [
        ("next_initial", "initial", 1.0),
        ("next_initial", "p", 1.0),
        ("next_parts", "parts", 1.0),
        ("next_back", "back", 1.0),
        ("next_back", "p", points.at(material.hardening)),
        ("next_back", "kinematic", at.plastic_strain),
        ("next_alpha_1", "alpha_1", 1.0),
        ("next_alpha_1", "gained", growth),
        ("next_alpha_1", "isotropic", at.gained),
        ("next_beta", "next_alpha_1", sharper),
        ("next_accumulated", "accumulated", 1.0),
        ("next_accumulated", "gained", PEEQ),
        ("next_start", "u", 1.0),
    ]
    for surface in surfaces:
        if surface.number is not None:
            places = _side_by_side(state, surface)
            equations.append(("next_parts", surface.named("p"), places))
    return equations
