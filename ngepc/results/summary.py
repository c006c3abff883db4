"""A result in one line, and as a small table for notebooks."""

from __future__ import annotations

from html import escape

from ngepc.model.processes import nodes_of


class Summarised:
    """One line for ``repr`` and a table for notebooks; results of all solvers inherit it."""

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
