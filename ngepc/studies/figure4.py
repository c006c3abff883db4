"""Figure 4: convergence quotients of the last Newton steps on several meshes, both examples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ngepc.dual.newton import NewtonOptions
from ngepc.dual.starts import coarse_start
from ngepc.geometries import lshape, wrench
from ngepc.pictures.curves import COLOURS, MARKERS
from ngepc.pictures.figures import save
from ngepc.pictures.picture import beside
from ngepc.results import records
from ngepc.studies.figures import example
from ngepc.studies.output import Table, write_table
from ngepc.studies.quotients import convergence_quotients
from ngepc.studies.tables import Cell, CellStore, Outcome

Progress = Callable[[str], None]

FAMILIES = {"lshape": lshape.PAPER_NODES, "wrench": wrench.PAPER_NODES}
TITLES = {"lshape": "Example (a)", "wrench": "Example (b)"}


class Figure4:
    """The study; each run is kept in ``folder``/cells.

    Parameters
    ----------
    folder
        Where results go.
    levels
        Number of meshes of each example, 1 to 6, the coarsest of the paper's tables first.
    gamma
        Regularisation; Example (a) starts from the 417-node solution, Example (b) from v = 0.
    progress
        Called with a line of text after each run.

    Raises
    ------
    ValueError
        If there are not so many meshes.
    """

    def __init__(
        self, folder: Path, levels: int = 3, gamma: float = 1e4, progress: Progress | None = None
    ) -> None:
        if not 1 <= levels <= 6:
            raise ValueError(f"levels={levels}: 1 to 6 are available")
        self.folder, self.gamma, self.levels = Path(folder), gamma, levels
        self.options = NewtonOptions(max_iterations=2000)
        self.progress = progress or (lambda line: None)
        settings = {"study": "figure4", "gamma": gamma, "ngepc": records.provenance()["version"]}
        self.store = CellStore(self.folder / "cells", settings)

    def run(self) -> list[dict]:
        """One record for each example and mesh."""
        cells = [Cell(n, k) for n, family in FAMILIES.items() for k in family[: self.levels]]
        table = []
        for cell in cells:
            record = self.store.get(Cell(f"quotients-{cell.row}", cell.nodes), self._solve).record
            quotients = ", ".join(f"{q:.2g}" for q in record["quotients"])
            self.progress(f"{cell.row} {cell.nodes}: {record['iterations']} steps, Q = {quotients}")
            table.append(record)
        return table

    def _solve(self, cell: Cell) -> Outcome:
        name = cell.row.removeprefix("quotients-")
        start = coarse_start(name, self.gamma, self.options) if name == "lshape" else None
        quotients = convergence_quotients(
            example(name, cell.nodes), self.gamma, start, self.options
        )
        return Outcome({"example": name, **asdict(quotients)})

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write figure4.png, .csv, .md and .json; returns their paths."""
        head = ["example", "nodes", "steps", *(f"Q_{j}" for j in range(1, 6))]
        head += ["residual of v*", "rounding of v*"]
        notes = [
            f"Quotients of the H norms of v^j - v* at gamma = {self.gamma:g}. v* is the solution "
            "for the tolerance 1e-14, or the last iterate before the residual stops falling (its "
            "residual is in the table). In parentheses: the distance is below ten times the "
            "rounding of v*, the quotient says nothing.",
        ]
        rows = [_row(record) for record in table]
        picture = save(draw(table), self.folder / "figure4.png")
        written = write_table(
            self.folder,
            Table(
                name="figure4",
                title="Figure 4: convergence quotients",
                head=head,
                rows=rows,
                notes=notes,
                cells=table,
            ),
        )
        return [picture, *written]


def _row(r: dict) -> list[str]:
    entries = [
        f"{q:.3g}" if sound else f"({q:.2g})"
        for q, sound in zip(r["quotients"], r["meaningful"], strict=True)
    ]
    entries = [""] * (5 - len(entries)) + entries
    first = [TITLES[r["example"]], str(r["nodes"]), str(r["iterations"])]
    return [*first, *entries, f"{r['reference_residual']:.1e}", f"{r['rounding']:.1e}"]


def draw(table: Sequence[dict]) -> Figure:
    """The quotients of both examples beside each other, one curve for each mesh."""
    names = dict.fromkeys(record["example"] for record in table)

    def panel(name: str) -> Callable[[Axes], None]:
        return lambda axes: _curves(axes, TITLES[name], [r for r in table if r["example"] == name])

    return beside(*(panel(name) for name in names), width=4.2, height=3.2)


def _curves(axes: Axes, title: str, table: Sequence[dict]) -> None:
    for index, record in enumerate(table):
        first = 6 - len(record["quotients"])
        pairs = zip(record["quotients"], record["meaningful"], strict=True)
        points = [(first + k, q) for k, (q, sound) in enumerate(pairs) if sound]
        style = {"color": COLOURS[index % len(COLOURS)], "marker": MARKERS[index % len(MARKERS)]}
        j, quotients = zip(*points, strict=True) if points else ((), ())
        axes.plot(j, quotients, label=f"{record['nodes']} nodes", markersize=4, **style)
    axes.axhline(1.0, color="#808890", linewidth=0.8, linestyle=":")
    axes.set_yscale("log")
    axes.set_xticks(range(1, 6))
    axes.set_xlabel(r"$j$, Newton step $\omega - 5 + j$", fontsize=9)
    axes.set_ylabel(r"convergence quotient $Q_j$", fontsize=9)
    axes.set_title(title, fontsize=10)
    axes.tick_params(labelsize=8)
    axes.legend(fontsize=8, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
