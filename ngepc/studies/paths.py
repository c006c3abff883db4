"""Studies along paths in gamma: Table 3, Figures 2, 3, 5 and 6, and the duality gap.

The figures show the end of Algorithm 7.2 at the gamma in their captions: for Example (b) 10 * 7^7 =
8.24e6, the end of Table 3 on the finest mesh; for Example (a) 5^13 = 1.22e9 from gamma_0 = 1 by
factors of 5, which agrees with the caption (1.2e9); the text does not say.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure
from ngsolve import Integrate

from ngepc.checks.sentences import counted
from ngepc.dual.duality import duality_report
from ngepc.dual.path import PathOptions, follow_path, mesh_width
from ngepc.dual.path_steps import PathResult
from ngepc.dual.result import DualResult
from ngepc.pictures.fields import plot_field, plot_mesh, plot_plastic_zone
from ngepc.pictures.sampling import corners_of
from ngepc.pictures.style import beside, save_figure
from ngepc.results.files import check_folder
from ngepc.studies.examples import FAMILIES, THRESHOLDS, example
from ngepc.studies.paper import TABLE_3_INNER, TABLE_3_OUTER
from ngepc.studies.work import OverMeshes, Work, first_of


def followed(
    study: Work, body: str, nodes: int, options: PathOptions, **more: object
) -> PathResult:
    """The path of an example on a mesh, with a line of progress for each gamma."""
    return follow_path(
        example(body, nodes),
        options,
        lambda s: study.progress(
            f"  {body} gamma {s.gamma:9.4g}: {counted(s.iterations, 'step')}"
        ),
        **more,
    ).or_interrupted()


@dataclass(eq=False)
class Table3(OverMeshes):
    """Paths on ``levels`` meshes, stored after each gamma; ``inner_scale`` is c."""

    inner_scale: float = PathOptions().inner_scale

    name = "table3"
    title = "Table 3"
    columns = """nodes = {nodes} | iterations = {outer_iterations}({total_inner_iterations}){ending}
        | paper = {paper} | gamma_end = {gamma_end:.3g} | inner = {inner}
        | last two changes / (tau_out h) = {last} | directly at gamma_end = {direct[steps]}
        | directly / path = {ratio:.2f} | residual = {residual:.1e}
        | V = {V:.6f}"""
    note = (
        "Outer (total inner) iterations of Algorithm 7.2 for Example (b) from v = 0, gamma_0 = "
        "{study.options.gamma_start:g}, theta = {study.options.growth:g}, tau_out = "
        "{study.options.outer_tolerance:g}, tau_in = {study.options.inner_tolerance:g}; inner "
        "tolerances times c = {study.inner_scale:g}, at least one Newton step for each gamma, h "
        "the smallest altitude of a triangle (docs/reading.md says why). The path ends when the "
        "quotient in the sixth column falls below 1.\n\n"
        "Directly: Newton steps of Algorithm 7.1 from v = 0 at gamma_end to the same precision; "
        "the paper reports more than double the iterations of the path for the finest mesh, the "
        "next column has our ratio."
    )

    def __post_init__(self) -> None:
        self.options = PathOptions(inner_scale=self.inner_scale)
        c = self.inner_scale
        if c != PathOptions().inner_scale:
            self.name = f"table3_c{c:g}"
            self.title = f"Table 3 with c = {c:g}"

    def cells(self) -> list[dict]:
        """The meshes."""
        meshes = first_of(FAMILIES["wrench"], self.levels)
        return [{"nodes": n, "inner_scale": self.inner_scale} for n in meshes]

    def solve(self, nodes: int, inner_scale: float) -> dict:
        """A path, and Algorithm 7.1 from v = 0 at its last gamma, to the same tolerance."""
        store = self.path_of({"nodes": nodes, "kept": "path"})
        path = followed(self, "wrench", nodes, self.options, checkpoint=store)
        there = replace(
            self.options, gamma_start=path.gamma_end, gamma_end=path.gamma_end
        )
        direct = follow_path(path.last.problem, there).or_interrupted()
        column = FAMILIES["wrench"].index(nodes)
        h = mesh_width(path.last.problem.mesh)
        names = ("iterations", "path_value", "residual_norm", "halvings")
        end = {"status": direct.status.label}
        end |= {name: getattr(direct.steps[-1], name) for name in names}
        names = ("outer_iterations", "total_inner_iterations", "inner_iterations", "gamma_end",
                 "path_values", "residual_norms")  # fmt: skip
        changes = [step.change for step in path.steps]
        bound = self.options.outer_tolerance * h
        return {
            "h": h,
            "paper": f"{TABLE_3_OUTER[column]}({TABLE_3_INNER[column]})",
            "status": path.status.label,
            **{name: getattr(path, name) for name in names},
            "changes": changes,
            "outer_bound": bound,
            "last": ", ".join(
                f"{change / bound:.3f}" for change in changes[-2:] if change
            ),
            "inner": " ".join(map(str, path.inner_iterations)),
            "ratio": direct.total_inner_iterations / path.total_inner_iterations,
            "residual": path.residual_norms[-1],
            "V": path.path_values[-1],
            "direct": end,
        }


@dataclass(eq=False)
class BothPaths(Work):
    """A study of a path for each example, on one mesh each, small ones by default."""

    lshape_nodes: int = 833
    wrench_nodes: int = 873

    def cells(self) -> list[dict]:
        """A path for each example."""
        meshes = {"lshape": self.lshape_nodes, "wrench": self.wrench_nodes}
        for body, nodes in meshes.items():
            example(body, nodes)
        return [{"body": body, "nodes": nodes} for body, nodes in meshes.items()]


PATHS = {
    "lshape": PathOptions(gamma_start=1.0, growth=5.0, gamma_end=5.0**13),
    "wrench": PathOptions(gamma_end=10.0 * 7.0**7),
}
"""How gamma of the captions is reached."""

FIGURES = {
    2: ("lshape", ("strain", "zone"),
        "Example (a): |p_gamma|_F, plastic zone |p_gamma|_F > 0.1 (paper: gamma = 1.2e9)"),
    3: ("lshape", ("excess",), "Example (a): yield function (3.9) (paper: next to Figure 2)"),
    5: ("wrench", ("mesh", "strain"),
        "Example (b): initial configuration, |p_gamma|_F (paper: gamma = 8.24e6)"),
    6: ("wrench", ("excess", "zone"),
        "Example (b): yield function, plastic zone |p_gamma|_F > 1e-2 (paper: gamma = 8.24e6)"),
}  # fmt: skip
"""Number of a figure -> example, its panels from left to right, and a description."""

HIGHEST_STRAIN = {"lshape": 0.2, "wrench": 0.04}
"""Upper end of the colour scales; the strains at the re-entrant corners grow with refinement."""


def drawn(number: int, result: DualResult) -> Figure:
    """Figure 2, 3, 5 or 6 from a result for its example."""
    bound = result.problem.beta
    body, panels, _ = FIGURES[number]
    draws = {
        "zone": lambda a: plot_plastic_zone(result, THRESHOLDS[body], axes=a),
        "strain": lambda a: plot_field(
            result, vmin=0.0, vmax=HIGHEST_STRAIN[body], axes=a
        ),
        "excess": lambda a: plot_field(
            result, "yield_function", vmin=-bound, vmax=0.0, axes=a
        ),
        "mesh": lambda a: plot_mesh(result, axes=a),
    }
    height = 4.0 if body == "lshape" else 2.6
    figure = beside(*(draws[name] for name in panels), height=height)
    if number == 5:
        before, after = figure.axes[:2]
        before.set(xlim=after.get_xlim(), ylim=after.get_ylim())
    return figure


@dataclass(eq=False)
class Figures(BothPaths):
    """Figures 2, 3, 5 and 6; paths are stored after each gamma."""

    lshape_nodes: int = 3201
    wrench_nodes: int = 6353

    name = "figures"
    title = "Figures 2, 3, 5 and 6"
    keeps = False
    columns = """figure = [{figure}]({file}) | shows = {shows} | nodes = {nodes}
        | gamma = {gamma:.3g}{ending} | Newton steps = {iterations}
        | max |p|_F = {plastic_strain_max:.4g} | zone / body = {zone:.4f}"""
    note = (
        "Deformed configurations, displacement not scaled; lengths and stresses in the units of "
        "the examples. max |p|_F of Example (a) grows without bound under refinement (re-entrant "
        "corner)."
    )

    def solve(self, body: str, nodes: int) -> list[dict]:
        """Follow the path of an example with a checkpoint, and draw figureN.png at its end."""
        store = self.path_of({"body": body, "nodes": nodes})
        check_folder(store.parent)
        path = followed(self, body, nodes, PATHS[body], checkpoint=store)
        fields = path.last.fields
        mesh = path.last.problem.mesh
        strain = corners_of(fields, fields.equivalent_plastic_strain).values
        zone = Integrate(fields.plastic_zone(THRESHOLDS[body]), mesh)
        whole = Integrate(1.0, mesh)
        numbers = {
            "gamma": path.gamma_end,
            "status": path.status.label,
            "residual_norm": path.residual_norms[-1],
            "inner_iterations": path.inner_iterations,
            "iterations": path.total_inner_iterations,
            "plastic_strain_max": float(strain.max()),
            **{"zone_area": zone, "body_area": whole, "zone": zone / whole},
        }
        found = []
        for number in (n for n, (of, *_) in FIGURES.items() if of == body):
            file = f"figure{number}.png"
            save_figure(drawn(number, path.last), self.folder / file)
            found.append(
                {"figure": number, "file": file, "shows": FIGURES[number][2], **numbers}
            )
        return found

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """The pictures that ``solve`` has drawn."""
        return [self.folder / record["file"] for record in records]


BY_TENS = PathOptions(growth=10.0, gamma_end=1e6, inner_scale=1e-8)


class Duality(BothPaths):
    """The paths of both examples to gamma = 1e6 by factors of ten."""

    name = "duality"
    title = "Duality"
    columns = """example = {body} | nodes = {nodes} | gamma = {gamma:.3g} | J + J* = {gap:.3g}
        | (z, u.n - psi) = {contact_term:.3g} | int beta|p| + (q, p) = {plastic_term:.3g}
        | M1 = {contact_penalty:.3g} | M2 = {plastic_penalty:.3g} | T = {tichonov:.3g}
        | [u.n - psi]+ = {penetration:.3g} | int |z (u.n - psi)| = {complementarity:.3g}
        | [z]+ = {tension:.3g} | (3.8) = {stress_deviation:.3g} | (3.9) = {yield_deviation:.3g}"""
    note = (
        "The five columns after J + J* add up to it. M1, M2, T vanish as gamma grows (proof of "
        "Theorem 4.2); what is left of the gap on a fixed mesh comes from z = 0 at the ends of "
        "Gamma_c and q = 0 on the boundary. Brackets [.]+: L2 norms of what violates (2.13) and "
        "(2.11). (3.8): L2 norm of q - (h p - dev sigma), whose element means are zero to "
        "rounding; (3.9): of |q| - beta minus the yield function of the stress."
    )

    def solve(self, body: str, nodes: int) -> list[dict]:
        """Follow the path of an example: a record for each gamma."""
        found: list = []
        path = followed(
            self,
            body,
            nodes,
            BY_TENS,
            observer=lambda r: found.append(asdict(duality_report(r))),
        )
        return [
            {
                "gamma": s.gamma,
                "iterations": s.iterations,
                "status": s.status.label,
                **report,
            }
            for s, report in zip(path.steps, found, strict=False)
        ]
