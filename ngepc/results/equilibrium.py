"""The forces on the body: loads, obstacles and supports, node by node.

For every continuous P1 displacement v, also one that moves the supports, the weak form of (2.14)
reads

    int sigma : eps(v) = [int_Gn g . v + int f . v] + <contact, v> + <reaction, v>,

so the reactions balance the stress, the loads and contact at the held components.
Rigid motions have no strain: the three forces add up to zero, up to the imbalance that the solver
has left at the free components.  So do their moments where rotations are P1 displacements, on
straight elements; curved ones leave an error of higher order in h.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ngepc._deprecated import renamed
from ngepc.checks.arguments import boundary_names, require_vector
from ngepc.checks.sentences import in_words
from ngepc.discretisation.supports import shares_of_supports
from ngepc.model.elements import corner_vertices, vertex_coordinates
from ngepc.model.places import Place
from ngepc.model.problem import Problem


@dataclass(frozen=True, eq=False, repr=False)
class Equilibrium:
    """Nodal forces on the body at a solution, arrays of shape (N, nodes).

    ``residual_force`` is the internal minus the applied minus the contact forces: the reactions at
    held components, what the solver has left at free ones.
    """

    problem: Problem
    applied: np.ndarray  # forces of tractions and body force
    contact: np.ndarray  # of the obstacles, with their friction
    residual_force: np.ndarray
    free: np.ndarray  # boolean, the components that no support holds
    others: Mapping[Place, np.ndarray] = field(default_factory=dict)
    """Place of each roller and spring -> its nodal forces on the body."""

    missing = renamed("missing", "residual_force")
    imbalance = renamed("imbalance", "free_residual")

    def __repr__(self) -> str:
        """The resultants, in place of the forces of all nodes."""
        forces = {
            "applied": self.applied,
            "contact": self.contact,
            "reaction": self.reaction,
            "out of balance": self.free_residual,
        }
        sums = {name: self.resultant(nodal).tolist() for name, nodal in forces.items()}
        texts = (
            f"{name} ({', '.join(f'{component:.6g}' for component in force)})"
            for name, force in sums.items()
        )
        return f"<Equilibrium: {', '.join(texts)}>"

    @property
    def reaction(self) -> np.ndarray:
        """Forces of the supports, zero at free components without rollers or springs.

        The axis of a body of revolution, where no displacement is radial, is no support.
        """
        held = ~self.free
        if self.problem.kinematics.hoop:
            shares = shares_of_supports(self.problem)
            held = sum(shares.values(), np.zeros(held.shape)) > 0
        return sum(self.others.values(), np.where(held, self.residual_force, 0.0))

    @property
    def free_residual(self) -> np.ndarray:
        """Forces out of balance, zero at held components."""
        return np.where(self.free, self.residual_force, 0.0)

    @property
    def reactions(self) -> dict[Place, np.ndarray]:
        """Name of each support -> its force on the body, N components.

        A component that several supports hold at a node is shared equally among them.
        """
        shares = shares_of_supports(self.problem)
        each = {place: share * self.residual_force for place, share in shares.items()}
        for place, forces in self.others.items():
            each[place] = each.get(place, 0.0) + forces
        return {place: self.resultant(forces) for place, forces in each.items()}

    def resultant(
        self, forces: np.ndarray, boundaries: str | Sequence[str] | None = None
    ) -> np.ndarray:
        """The sum of nodal forces over the mesh, N components (force).

        Translations have coefficients at the vertices alone, for order two as well.
        ``boundaries`` are names, 'a', 'a|b' or a sequence: the sum over their vertices alone.  That
        of ``contact`` over one side of a contact of two bodies is the force on that body.
        """
        own = self.problem.processes.own
        forces = self._at_vertices(forces, boundaries)
        return self.problem.processes.total(forces[own].sum(axis=0))

    def moment(
        self,
        forces: np.ndarray,
        about: Sequence[float] | None = None,
        boundaries: str | Sequence[str] | None = None,
    ) -> np.ndarray:
        """Sum of (x - about) x F over the nodes (force times length).

        ``about`` is a point, None for the origin; ``boundaries`` are those of ``resultant``: the
        torque of ``reaction`` at one support, for example.  Three components; for N = 2 one,
        positive counterclockwise.
        """
        mesh = self.problem.mesh
        processes = self.problem.processes
        N = mesh.dim
        own = processes.own
        about = np.array(
            require_vector("about", (0.0,) * N if about is None else about, (N,))
        )
        forces = self._at_vertices(forces, boundaries)[own]
        arms = vertex_coordinates(mesh)[own] - about
        pairs = [(0, 1)] if N == 2 else [(1, 2), (2, 0), (0, 1)]
        moments = [
            arms[:, a] @ forces[:, b] - arms[:, b] @ forces[:, a] for a, b in pairs
        ]
        return processes.total(np.array(moments))

    def _at_vertices(
        self, forces: np.ndarray, boundaries: str | Sequence[str] | None
    ) -> np.ndarray:
        """Nodal forces at the vertices (vertices, N), zero off the boundaries if some are given."""
        mesh = self.problem.mesh
        if np.ndim(forces) != 2:
            raise ValueError(
                f"forces={in_words(forces)}: those of all nodes are needed, such as .reaction of "
                "an Equilibrium"
            )
        forces = forces[:, : mesh.nv].T
        if boundaries is None:
            return forces
        names = boundary_names("boundaries", boundaries, mesh)
        there = np.zeros((mesh.nv, 1), bool)
        there[corner_vertices(mesh, names)] = True
        return np.where(there, forces, 0.0)
