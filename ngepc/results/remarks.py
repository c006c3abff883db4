"""Remarks on a solution that a user must know: how far it can be trusted, and what is odd."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, Grad, GridFunction, IfPos, Integrate

from ngepc.checks.arguments import is_number
from ngepc.checks.sentences import at_most_percent, counted, in_percent
from ngepc.discretisation.finer import unresolved_data
from ngepc.discretisation.gap_records import nearer_between_nodes, overlaps
from ngepc.discretisation.points import Points
from ngepc.discretisation.sampled import what_is_unseen
from ngepc.discretisation.shared_forces import range_of_force
from ngepc.model.data import order_note
from ngepc.model.elements import plastic_points, vertex_coordinates
from ngepc.model.problem import Problem
from ngepc.model.round import round_note
from ngepc.results.fields import Fields, frobenius
from ngepc.results.outcome import Status

UNBALANCED = 1e-3
"""Loads and reactions that differ by a larger part of the loads are said."""

UNSTRAINED = 1e-12
"""Forces below this part of |K| |u| are rounding errors where no load acts."""

UNSHARED = 1e-3
"""Contact forces that are determined up to a smaller part of themselves are not spoken of."""

FEW_FACETS = 4
"""Fewer facets in contact do not resolve a contact zone."""

DEEP = 0.01
"""Larger overlaps between nodes are reported, relative to the largest displacement."""

SMALL_STRAIN = 0.03
SMALL_ROTATION = 0.05
"""Strain |eps(u)| and rotation (rad) above which the message warns of large deformations."""

SLIPPERY = 0.01
"""Bounds of friction in a smaller ratio to the pressure than any friction of metals are said."""

NEGLIGIBLE = 1e-6
"""Spurious strains that are not spoken of, relative to the largest strain."""

FEW_PLACES = 0.01
"""Large strains in a smaller part of the body are called local."""


def remarks_on(result: Any, points: Points | None, hidden: float) -> list[str]:
    """The remarks on a ``DiscreteSolution``, worst first.

    ``points`` have looked at the data of the material, if there are such; ``hidden`` is the deepest
    overlap between nodes.
    """
    found = []
    if math.isfinite(longest_way(result)):
        found += remarks_on_state(result, hidden)
    resolved = partial(unresolved_data, points=points)
    notes = (order_note, round_note, what_is_unseen, resolved, nearer_between_nodes)
    found += [note(result.problem) for note in notes]
    return list(filter(None, found))


def remarks_on_state(result: Any, hidden: float) -> list[str]:
    """What is to be said about displacements and forces, some of it empty, see ``remarks_on``."""
    still = unstrained(result)
    few = few_facets(result.contact_facets, result.contact_nodes)
    rubs = result.problem.friction is not None
    return [
        still or out_of_balance(result),
        without_touch(result),
        without_motion(result),
        deformed_much(result),
        "" if still else few,
        rubs and like_a_coefficient(result.problem, result.largest_pressure),
        shared_in_many_ways(result),
        undetermined(result),
        overlaps_between_nodes(result, hidden),
        overlaps_of_supports(result),
    ]


def longest_way(result: Any) -> float:
    """The largest component of u at a node (length)."""
    return result.problem.processes.maximum(np.abs(result.state.u))


def unstrained(result: Any) -> str:
    """A remark where obstacles and supports move a body and do not press it."""
    balance = result.equilibrium
    largest = result.problem.processes.maximum
    pressed = largest(np.abs(balance.contact))
    loaded = largest(np.abs(balance.applied)) > 0
    if not result.status.is_solution or loaded or not pressed:
        return ""
    held = max(map(np.linalg.norm, balance.reactions.values()), default=0.0)
    if max(pressed, held) > UNSTRAINED * result.state.trial_forces:
        return ""
    return "No load acts, and the contact forces are rounding errors."


def out_of_balance(result: Any) -> str:
    """A remark on loads that the supports do not balance though the residual is small."""
    if not result.status.is_solution or result.status is Status.BOUNDED:
        return ""
    balance = result.equilibrium
    given = np.abs(balance.applied) + np.abs(balance.contact)
    loads = float(np.linalg.norm(balance.resultant(given)))
    size = max([loads, *map(np.linalg.norm, balance.reactions.values())])
    left = float(np.linalg.norm(balance.resultant(balance.free_residual)))
    if not loads or left <= UNBALANCED * size:
        return ""
    return (
        f"Loads and reactions are out of balance by {in_percent(left / size)}, and "
        "displacements may be off by more: rounding errors of slender bodies or elements, or "
        "a large tolerance."
    )


def without_touch(result: Any) -> str:
    """A remark where no contact force acts: how far the obstacle is."""
    if not result.status.is_solution or result.contact_nodes:
        return ""
    gap, place = smallest_gap_left(result)
    touching = result.state.touching_distance
    if not -touching <= gap < np.inf:
        return ""
    where = tuple(float(f"{c:.4g}") for c in place)
    if gap <= touching:
        return f"No contact force acts: the body just reaches the obstacle at {where}."
    missed = ""
    vertices = vertex_coordinates(result.problem.mesh)
    if gap > result.problem.processes.extent(vertices).max():
        missed = (
            ", more than the size of the body: no obstacle lies along the normals of the contact "
            "boundary, or it is far away"
        )
    found = f"the smallest gap left is {gap:.3g} at {where}{missed}"
    return f"Nothing touches the obstacle: {found}."


def smallest_gap_left(result: Any) -> tuple[float, list[float]]:
    """The smallest gap that u leaves, inf without contact, and the place of it.

    That of rigid obstacles is looked at in many points, since the contact rows, which are means or
    Bernstein coefficients, may be nearer than the obstacle; that of two bodies is one of the rows.
    """
    rows = result.rows
    apart = ~rows.tied
    apart[result.state.body.contact.on_obstacles] = False
    gaps = result.open_gap[apart]
    places = rows.between(vertex_coordinates(result.problem.mesh))[apart]
    for depth, points in overlaps(result.problem, result.state.u):
        gaps = np.append(gaps, -depth)
        places = np.vstack([places, points])
    nearest = (np.inf, [])
    if len(gaps):
        first = int(gaps.argmin())
        nearest = float(gaps[first]), places[first].tolist()
    return min(result.problem.processes.all(nearest))


def without_motion(result: Any) -> str:
    """A remark where all displacements are zero."""
    solved = result.status.is_solution
    if solved and not longest_way(result) and not result.contact_nodes:
        return "Nothing loads or moves the body: its displacements are zero."
    return ""


def deformed_much(result: Any) -> str:
    """A remark on strains or rotations that are not small."""
    if result.status in (Status.LIMIT_LOAD, Status.ITERATION_LIMIT):
        return ""  # an iterate, whose strains may be far from those of a solution
    return not_small(result.largest_strain, result.largest_rotation, result.fields)


def not_small(strain: float, rotation: float, fields: Fields) -> str:
    """A remark where the largest strain or rotation (rad) of these fields is not small."""
    if strain <= SMALL_STRAIN and rotation <= SMALL_ROTATION:
        return ""
    return large_motion(strain, rotation, large_part(fields))


def like_a_coefficient(problem: Problem, pressure: float) -> str:
    """A remark on Tresca's bound that is meant for Coulomb's coefficient, as it seems.

    It is a number of at most one, and small beside the largest contact ``pressure`` (stress).
    """
    bound = problem.friction
    if not is_number(bound) or not 0 < bound <= min(1.0, SLIPPERY * pressure):
        return ""
    return (
        f"friction={bound:g} is a bound of the shear stress, "
        f"{at_most_percent(bound / pressure)} of the largest contact pressure, {pressure:.3g}: "
        f"a coefficient of friction is friction=Coulomb({bound:g})."
    )


def shared_in_many_ways(result: Any) -> str:
    """A remark on a contact force that depends on how boundaries share that of a node."""
    if not result.status.is_solution:
        return ""
    low, high = range_of_force(result.state)
    if high - low <= UNSHARED * high:
        return ""
    return (
        "Where contact boundaries with friction meet, many divisions of the force of a node "
        f"between them are in equilibrium: the contact force is {result.contact_force:.5g}, one "
        f"of {low:.5g} to {high:.5g} with the same displacements and stresses."
    )


def undetermined(result: Any) -> str:
    """A remark on motions of a part that no contact force rules out."""
    loose = result.undetermined_motions if result.status.is_success else 0
    if not loose:
        return ""
    not_determined = "is not" if loose == 1 else "are not"
    return (
        f"{counted(loose, 'rigid motion')} of a part held by contact alone "
        f"{not_determined} determined: its position is not unique, its stresses are."
    )


def overlaps_between_nodes(result: Any, hidden: float) -> str:
    """A remark on an obstacle that varies between nodes."""
    if hidden <= DEEP * longest_way(result):
        return ""
    return (
        f"Between nodes the body overlaps an obstacle by up to {hidden:.3g}: "
        "refine the contact boundary there."
    )


def overlaps_of_supports(result: Any) -> str:
    """A remark on supports that push two bodies into each other where no row can act."""
    forced = result.state.body.contact.forced_overlap(result.state.u)
    if forced <= DEEP * longest_way(result):
        return ""
    return (
        f"Supports hold two bodies where they overlap by up to {forced:.3g}: no contact "
        "force acts there; give displacements that agree, or leave one body free."
    )


def few_facets(facets: int, nodes: int) -> str:
    """A remark on a contact of so many whole facets and nodes, "" where they are enough or none."""
    if not nodes or facets >= FEW_FACETS:
        return ""
    return (
        f"Too few facets are in contact ({counted(facets, 'whole facet')}, "
        f"{counted(nodes, 'node')}): the pressures, and a contact force that balance alone does "
        "not determine, may be far off. Refine the contact boundary."
    )


def turning(problem: Problem, u: GridFunction) -> float:
    """The largest |curl(u)| / 2 at the points of plasticity (rad)."""
    slopes = at_plastic_points(problem, Grad(u)).reshape(-1, problem.N, problem.N)
    skew = (slopes - slopes.swapaxes(1, 2)) / 2
    size = np.sqrt((skew**2).sum(axis=(1, 2)) / 2)
    return problem.processes.maximum(size)


def at_plastic_points(problem: Problem, value: CoefficientFunction) -> np.ndarray:
    """A coefficient at the points of plasticity, shape (points, components)."""
    mesh = problem.mesh
    rules = plastic_points(mesh, problem.order)
    return np.asarray(value(mesh.MapToAllElements(rules, mesh.Materials(".*"))))


def large_part(fields: Fields) -> float:
    """The part of the volume in which strains or rotations are not small."""
    problem = fields.problem
    slopes = Grad(fields.displacement)
    turned = frobenius(slopes - slopes.trans) / 8**0.5
    excess = IfPos(
        frobenius(fields.strain) - SMALL_STRAIN, 1.0, turned - SMALL_ROTATION
    )
    weight = problem.kinematics.weight
    part, whole = (
        problem.processes.total(
            Integrate(density, problem.mesh, element_wise=True).NumPy().sum()
        )
        for density in (weight * IfPos(excess, 1.0, 0.0), weight)
    )
    return float(part / whole)


def large_motion(strain: float, rotation: float, part: float) -> str:
    """A remark on the error of linearised strains at the largest strain and rotation (rad).

    ``part`` is that of the volume in which one of them is large.  At corners and at edges of
    contact they grow with every refinement, however small the loads are.
    """
    spurious = rotation**2 / 2
    sizes = f"Strains reach {in_percent(strain)}"
    if spurious > NEGLIGIBLE * strain:
        sizes += (
            f" and rotations {rotation:.2g} rad (which the model takes for a strain of "
            f"{in_percent(spurious)})"
        )
    limits = f"They are above {in_percent(SMALL_STRAIN)} or {SMALL_ROTATION:g} rad"
    if part < FEW_PLACES:
        return (
            f"{sizes}. {limits} in {at_most_percent(part)} of the body only; at corners and edges "
            "of contact they grow with every refinement."
        )
    return (
        f"{sizes}. {limits} in {in_percent(part)} of the body: the model is for small ones, and "
        "elongations, stresses and forces may be wrong by as much."
    )
