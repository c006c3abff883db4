"""Results of the solvers: quantities, forces, energies, contact, and notes for the user."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from html import escape

import numpy as np
from ngsolve import H1, CoefficientFunction, GridFunction, Norm, VectorH1

from ngepc.checks.sentences import counted
from ngepc.discretisation.body import Iterate
from ngepc.discretisation.gap_records import deepest_overlap
from ngepc.discretisation.mortar import deepest_pair_overlap
from ngepc.discretisation.points import Points
from ngepc.discretisation.rows import ContactRows
from ngepc.discretisation.sampled import hidden_overlap
from ngepc.model.own import require_same_elements, require_same_mesh
from ngepc.model.problem import Problem
from ngepc.model.processes import nodes_of
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.fields import Fields, Quantities
from ngepc.results.outcome import Ending, History, Status
from ngepc.results.remarks import remarks_on, turning

SLIPPING = 1e-10
"""Fraction of the largest displacement above which a row that touches has slipped."""


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
        name_style = "style='text-align:left;white-space:nowrap'"
        cells = "".join(
            f"<tr><th {name_style}>{escape(name)}</th><td {left}>{escape(text)}</td></tr>"
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
    def largest_pressure(self) -> float:
        """The largest contact pressure of a vertex (stress)."""
        values = self.contact_pressure.vec.FV().NumPy()
        return self.problem.processes.maximum(values)

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
        seen = []
        if self.status is not Status.UNHELD:
            seen = remarks_on(self, self._points, self._hidden_overlap)
        converged = self.status in (Status.CONVERGED, Status.BOUNDED)
        texts = (*seen, self.ending) if converged else (self.ending, *seen)
        return " ".join(filter(None, texts))
