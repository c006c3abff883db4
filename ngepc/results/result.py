"""Results of the solvers: quantities, forces, energies, contact, and notes for the user."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from html import escape

import numpy as np
from ngsolve import (
    H1,
    CoefficientFunction,
    Grad,
    GridFunction,
    IfPos,
    Integrate,
    Norm,
    VectorH1,
)

from ngepc.checks.sentences import at_most_percent, counted, in_percent
from ngepc.discretisation.body import Iterate
from ngepc.discretisation.finer import unresolved_data
from ngepc.discretisation.gap_records import deepest_overlap, nearer_between_nodes
from ngepc.discretisation.mortar import deepest_pair_overlap
from ngepc.discretisation.points import Points
from ngepc.discretisation.rows import ContactRows
from ngepc.discretisation.sampled import hidden_overlap, what_is_unseen
from ngepc.model.data import order_note
from ngepc.model.elements import plastic_points, vertex_coordinates
from ngepc.model.own import require_same_elements, require_same_mesh
from ngepc.model.problem import Problem
from ngepc.model.processes import nodes_of
from ngepc.model.round import round_note
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.fields import Fields, Quantities, frobenius
from ngepc.results.outcome import Ending, History, Status

UNBALANCED = 1e-3
"""Loads and reactions that differ by a larger part of the loads are said."""

FEW_FACETS = 4
"""Fewer facets in contact do not resolve a contact zone."""

SLIPPING = 1e-10
"""Fraction of the largest displacement above which a row that touches has slipped."""

DEEP = 0.01
"""Larger overlaps between nodes are reported, relative to the largest displacement."""

SMALL_STRAIN = 0.03
SMALL_ROTATION = 0.05
"""Strain |eps(u)| and rotation (rad) above which the message warns of large deformations."""

NEGLIGIBLE = 1e-6
"""Spurious strains that are not spoken of, relative to the largest strain."""

FEW_PLACES = 0.01
"""Large strains in a smaller part of the body are called local."""


class Result(Quantities, Ending):
    """The base class of all results; everything is available for every status.

    Subclasses have the ``Quantities`` and what is declared here.
    """

    history: History  # the records of the iterates
    order_one: History | None = None  # of a solve with order one before
    method_label: str  # 'exact', 'gamma = 1e4': what was solved
    residual_norm: float  # at the end; the norm depends on the method
    primal_energy: float  # J(u, p) of (2.14)
    dual_energy: float  # J*_gamma(v), or -J by the identity that a minimum satisfies
    yield_excess: CoefficientFunction  # > 0 where the body yields in this step
    contact_pressure: CoefficientFunction  # on Gamma_c, positive in compression
    contact_force: float  # its resultant
    equilibrium: Equilibrium  # nodal forces of loads, obstacles and supports

    @property
    def iterations(self) -> int:
        """Newton steps done."""
        return self.history.records[-1].iteration if self.history.records else 0

    @property
    def steps_in_words(self) -> str:
        """The number of Newton steps, and of those of order one before them, if any."""
        words = str(self.iterations)
        if self.order_one is not None:
            before = self.order_one.records[-1].iteration
            words += f" after {before} of order one"
        return words

    @property
    def fields(self) -> Fields:
        """The quantities of u and p alone, without the solver's other variables."""
        return Fields(self.problem, self.displacement, self.plastic_increment)

    @property
    def applied_force(self) -> np.ndarray:
        """Resultant of tractions and body force on the body, N components (force)."""
        return self.equilibrium.resultant(self.equilibrium.applied)

    @property
    def contact_resultant(self) -> np.ndarray:
        """Resultant force of the obstacles on the body, with friction, N components (force)."""
        return self.equilibrium.resultant(self.equilibrium.contact)

    @property
    def reaction(self) -> np.ndarray:
        """Resultant force of the supports on the body, N components (force).

        Each support's own is in ``equilibrium.reactions``.  The applied force, the contact
        resultant and the reaction add up to zero.
        """
        return self.equilibrium.resultant(self.equilibrium.reaction)

    def summary(self) -> dict[str, str]:
        """The summary of a result: name -> text; steps of a history do not keep iterates."""
        problem = self.problem
        mesh = self.problem.mesh
        elements = counted(problem.processes.total(mesh.ne), "element")
        size = f"{nodes_of(mesh)} nodes, {elements}"
        steps = {"Newton steps": self.steps_in_words} if self.history.records else {}
        rows = {
            "status": str(self.status),
            "method": self.method_label,
            **steps,
            "residual": f"{self.residual_norm:.2g}",
            "body": f"{size}, order {problem.order}, {problem.kinematics.name}",
            "energy J": f"{self.primal_energy:.10g}",
        }
        if problem.touching_names:
            rows["contact force"] = f"{self.contact_force:.8g}"
        return rows | ({"note": self.message} if self.message else {})

    def __repr__(self) -> str:
        """The summary without the note, on one line."""
        rows = self.summary()
        rows.pop("note", None)
        texts = [rows.pop("status"), *(f"{name} {text}" for name, text in rows.items())]
        return f"<{type(self).__name__}: {', '.join(texts)}>"

    def _repr_html_(self) -> str:
        left = "style='text-align:left'"
        cells = "".join(
            f"<tr><th {left}>{escape(name)}</th><td {left}>{escape(text)}</td></tr>"
            for name, text in self.summary().items()
        )
        return f"<table>{cells}</table>"


@dataclass(frozen=True, eq=False, repr=False)
class DiscreteSolution(Result):
    """Quantities of both exact methods for contact rows, available for every status.

    They have ``largest_strain`` besides, the largest |eps(u)| at the points.
    """

    state: Iterate  # the last iterate: displacements and forces of the rows, and what follows
    status: Status
    ending: str  # a sentence about how the run ended, empty if it converged
    history: History
    linear_solver: str = ""
    """'sparsecholesky', 'PETSc', 'PyAMG': what was given or chosen."""
    order_one: History | None = None
    """Records of the solve with order one that gave the start of one with order two, if any."""

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return require_same_mesh(self.state.body.problem)

    @property
    def _points(self) -> Points | None:
        """Integration points that have looked at the data of the material, if there are such."""
        return None

    @property
    def rows(self) -> ContactRows:
        """The contact conditions N u <= gaps."""
        return self.state.body.contact.rows

    @property
    def displacement(self) -> GridFunction:
        """u (length): its nodes follow points that move; of order one also through refinement."""
        u = self._displacement
        if u.space.globalorder > 1:
            require_same_elements(self.state.body.problem)
        return u

    @cached_property
    def _displacement(self) -> GridFunction:
        require_same_elements(self.state.body.problem)
        return self.state.body.supports.function(self.state.u)

    @property
    def residual_norm(self) -> float:
        """Relative norm of the residual forces and of the violation of contact conditions."""
        return self.state.residual_norm

    @property
    def residual_rounding(self) -> float:
        """Rounding error of ``residual_norm``: smaller tolerances cannot be reached."""
        return self.state.rounding

    @property
    def primal_energy(self) -> float:
        """J(u, p) of (2.14), with int F |slip| where there is friction (force times length)."""
        return self.state.energy

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Nodal forces of loads, obstacles and supports."""
        state = self.state
        body = self.state.body
        others = {p: -f.T for p, f in body.contact.roller_forces(state.contact).items()}
        contact = -state.contact_forces.T - sum(
            others.values(), np.zeros(body.load.T.shape)
        )
        for place in body.supports.springs:
            others[place] = (
                others.get(place, 0.0) - body.supports.pull(state.u, place).T
            )
        forces = body.load.T, contact, state.residual_force.T
        return Equilibrium(self.problem, *forces, body.free.T, others)

    @property
    def yield_excess(self) -> CoefficientFunction:
        """|p| of this step: positive where the body yields, the plastic active set."""
        return Norm(self.plastic_increment)

    @property
    def nodal_contact_forces(self) -> np.ndarray:
        """Force >= 0 of each contact row, positive in compression, shape (m,)."""
        return self.state.multipliers

    @property
    def nodal_friction_forces(self) -> np.ndarray:
        """Tangential forces of the body on the obstacle at each row, shape (m, N - 1)."""
        return self.state.tangential_forces

    @property
    def nodal_slip(self) -> np.ndarray:
        """Slip of each row in this step (length), rounding errors where it sticks, (m, N - 1)."""
        return self.state.slip

    @property
    def open_gap(self) -> np.ndarray:
        """gaps - N u of each contact row (length), shape (m,)."""
        return self.state.open_gap

    @cached_property
    def penetration(self) -> float:
        """The deepest overlap with an obstacle or another body at any point (length).

        It is evaluated at 13 points along each edge, and inside facets likewise, at 129 and 49
        where an obstacle varies.  Rows that must stay closed count with what they open or
        overlap.  Where the gap is quadratic on straight
        facets, linear for order one, nothing but rounding is left for a solution.
        """
        problem = self.problem
        depth = max(deepest_overlap(problem, self.state.u), self._hidden_overlap)
        for pair in problem.contact_pairs:
            if not pair.tied:
                depth = max(depth, deepest_pair_overlap(problem, pair, self.state.u))
        tied = np.abs(self.open_gap[self.rows.tied])
        depth = max(depth, float(tied.max(initial=0.0)))
        return problem.processes.maximum(np.array([depth]))

    @cached_property
    def _hidden_overlap(self) -> float:
        """The deepest overlap with an obstacle that varies between nodes (length)."""
        depth = hidden_overlap(self.problem, self.state.u)
        return self.problem.processes.maximum(np.array([depth]))

    @property
    def pressing(self) -> np.ndarray:
        """``nodal_contact_forces`` without those of tied rows, shape (m,)."""
        return np.where(self.rows.tied, 0.0, self.nodal_contact_forces)

    @property
    def contact_force(self) -> float:
        """Integral of the contact pressure, positive in compression (force)."""
        return float(self.state.body.contact.sum_of(self.pressing))

    @property
    def obstacle_forces(self) -> dict[str, np.ndarray]:
        """Contact boundary -> force of its rigid obstacle on the body, N components (force).

        With friction.  Where two boundaries meet at an angle each has its own forces, while
        ``contact_pressure`` has one value at their common vertices.
        """
        contact = self.state.body.contact
        parts = contact.of_obstacles(self.state.contact)
        return {
            name: self.equilibrium.resultant(-contact.forces(x).T)
            for name, x in parts.items()
        }

    @cached_property
    def contact_pressure(self) -> GridFunction:
        """Contact forces over the area that belongs to them (stress), positive in compression.

        Draw it on the contact boundary; inside the body it is the P1 extension and means nothing.
        """
        return self._density("contact_pressure", self.pressing[:, None])

    @property
    def friction_force(self) -> tuple[float, ...]:
        """Resultant of the friction on the body, N components (force)."""
        return tuple(self.state.body.contact.sum_of(self._friction_on_body).tolist())

    @cached_property
    def friction_stress(self) -> GridFunction:
        """Friction on the body over the area that belongs to it (stress), N components, P1."""
        return self._density("friction_stress", self._friction_on_body)

    @property
    def _friction_on_body(self) -> np.ndarray:
        """Friction of the obstacle on the body at each row, shape (m, N)."""
        return -np.einsum("md,mdj->mj", self.nodal_friction_forces, self.rows.tangents)

    def _density(self, name: str, forces: np.ndarray) -> GridFunction:
        """Forces of the rows, shape (m, components), over the area that belongs to them, P1."""
        values = self.state.body.contact.densities(forces)
        mesh = self.problem.mesh
        space = H1(mesh, order=1) if values.shape[1] == 1 else VectorH1(mesh, order=1)
        density = GridFunction(space, name=name)
        density.vec.FV().NumPy()[:] = values.T.ravel()
        return density

    @cached_property
    def sliding(self) -> GridFunction:
        """1 where friction acts and the vertex slips, without friction at all that touch; P1."""
        least = SLIPPING * self.problem.processes.maximum(np.abs(self.state.u))
        slips = np.linalg.norm(self.nodal_slip, axis=1) > least
        slips |= self.problem.friction is None
        acts = (self.pressing > 0) | (
            self.state.body.contact.bound(self.state.contact) > 0
        )
        sliding = GridFunction(H1(self.problem.mesh, order=1), name="sliding")
        nodes = self.rows.nodes[slips & acts]
        values = sliding.vec.FV().NumPy()
        values[nodes[nodes < len(values)]] = 1.0
        return sliding

    @cached_property
    def largest_rotation(self) -> float:
        """The largest rotation at the points (rad), the norm of the vector curl(u) / 2."""
        return turning(self.problem, self.displacement)

    @property
    def contact_area(self) -> float:
        """Area that belongs to the rows with a contact force."""
        return self.state.body.contact.area(self.pressing > 0)

    @cached_property
    def contact_facets(self) -> int:
        """Number of contact facets all of whose vertices are pressed."""
        pressed = set(self.rows.nodes[self.pressing > 0].tolist())
        facets = self.problem.mesh.Boundaries(
            "|".join(self.problem.touching_names)
        ).Elements()
        here = sum(
            pressed.issuperset(vertex.nr for vertex in f.vertices) for f in facets
        )
        return self.problem.processes.total(here)

    @property
    def contact_nodes(self) -> int:
        """Number of nodes with a contact force."""
        return int(self.state.body.contact.sum_of(self.pressing > 0))

    @property
    def undetermined_motions(self) -> int:
        """Number of rigid motions of floating parts that no contact force rules out, 0 mostly."""
        return self.state.body.floating.undetermined(self.state.contact)

    @cached_property
    def message(self) -> str:
        """How the run ended, and remarks on the solution that a user must know, worst first."""
        seen = [] if self.status is Status.UNHELD else self._observations()
        converged = self.status in (Status.CONVERGED, Status.BOUNDED)
        texts = (*seen, self.ending) if converged else (self.ending, *seen)
        return " ".join(filter(None, texts))

    def _observations(self) -> list[str]:
        found = list(filter(None, [self._lack_of_balance()]))
        processes = self.problem.processes
        rows = self.rows
        touching = self.contact_nodes
        places = rows.between(vertex_coordinates(self.problem.mesh)).tolist()
        gaps = np.where(rows.tied, np.inf, self.open_gap).tolist()
        gap, place = min(
            processes.all(min(zip(gaps, places, strict=True), default=(np.inf, [])))
        )
        solved = self.status.is_solution
        if solved and 0 <= gap < np.inf and not touching:
            found.append(
                f"Nothing touches the obstacle: the smallest gap left is {gap:.3g}"
                f" at {tuple(float(f'{c:.4g}') for c in place)}."
            )
        size = processes.maximum(np.abs(self.state.u))
        if solved and not size and not touching:
            found.append("Nothing loads or moves the body: its displacements are zero.")
        strain = self.largest_strain
        rotation = self.largest_rotation
        if strain > SMALL_STRAIN or rotation > SMALL_ROTATION:
            found.append(large_motion(strain, rotation, large_part(self.fields)))
        found += filter(None, [few_facets(self.contact_facets, touching)])
        if self.status.is_success and (loose := self.undetermined_motions):
            not_determined = "is not" if loose == 1 else "are not"
            found.append(
                f"{counted(loose, 'rigid motion')} of a part held by contact alone "
                f"{not_determined} determined: its position is not unique, its stresses are."
            )
        if self._hidden_overlap > DEEP * size:
            found.append(
                f"Between nodes the body overlaps an obstacle by up to {self._hidden_overlap:.3g}: "
                "refine the contact boundary there."
            )
        forced = self.state.body.contact.forced_overlap(self.state.u)
        if forced > DEEP * size:
            found.append(
                f"Supports hold two bodies where they overlap by up to {forced:.3g}: no contact "
                "force acts there; give displacements that agree, or leave one body free."
            )
        resolved = partial(unresolved_data, points=self._points)
        notes = (order_note, round_note, what_is_unseen, resolved, nearer_between_nodes)
        found += filter(None, (note(self.problem) for note in notes))
        return found

    def _lack_of_balance(self) -> str:
        """A remark on loads that the supports do not balance though the residual is small."""
        if not self.status.is_solution or self.status is Status.BOUNDED:
            return ""
        balance = self.equilibrium
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
