"""What every solver gives back: quantities, forces, energies, and how the run ended."""

from __future__ import annotations

from html import escape

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.model.processes import nodes_of
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.fields import Fields, Quantities
from ngepc.results.outcome import Ending, History


class Result(Quantities, Ending):
    """What the results of all solvers have in common, there whatever the status says.

    Those that inherit have the ``Quantities`` and what is declared here.
    """

    history: History  # the records of the iterates
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
        """What a user must know of a result: name -> text."""
        problem = self.problem
        kinematics, mesh = problem.kinematics.name, problem.mesh
        elements = problem.processes.total(mesh.ne)
        rows = {
            "status": str(self.status),
            "method": self.method_label,
            "Newton steps": str(self.iterations),
            "residual": f"{self.residual_norm:.2g}",
            "body": f"{nodes_of(mesh)} nodes, {elements} elements, order {problem.order}, "
            f"{kinematics}",
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
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(text)}</td></tr>"
            for name, text in self.summary().items()
        )
        return f"<table>{cells}</table>"
