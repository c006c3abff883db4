"""``ngepc study NAME``: all tables, figures and checks; one registry."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ngepc.cli import arguments
from ngepc.cli.arguments import count, counts, location, positive, words

EXAMPLES = """examples:
  ngepc study table1 --levels 2 --figures --out out/demo
  ngepc study cost --modes default
Ctrl-C at any time: the same command goes on where it was.
"""


def all_converged(table: Sequence[dict]) -> bool:
    """Whether every status in the records, also in nested ones, is 'converged'."""
    flat = [r | {k: v for d in r.values() if isinstance(d, dict) for k, v in d.items()}
            for r in table]  # fmt: skip
    return all(
        value == "converged" for r in flat for key, value in r.items() if key.endswith("status")
    )


def nothing_to_complain(table: Sequence[dict]) -> bool:
    """Whether no record has a complaint."""
    return not any(record["complaints"] for record in table)


def in_agreement(table: Sequence[dict]) -> bool:
    """Whether derivatives agree with differences, Taylor's formula and the envelope theorem."""
    return all(
        r["largest error"] < 1e-6 and (r["Taylor"] or 2) > 1.95 and (r["envelope"] or 0) < 1e-10
        for r in table
    )


@dataclass(frozen=True)
class Study:
    """A study: what it is called, what it takes, which ``Work`` does it, when it has succeeded.

    Parameters
    ----------
    help
        A line for help pages.
    work
        Module and class in ``ngepc.studies``; the options are keywords of the class.
    options
        Name -> (type, help); a tuple names what may be chosen, None stands for a switch.
    success
        What makes the exit status 0.
    """

    help: str
    work: str
    options: dict[str, tuple[Callable | tuple | None, str]] = field(default_factory=dict)
    success: Callable[[Sequence[dict]], bool] = all_converged

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments; those not given keep the defaults of the class."""
        for name, (kind, text) in self.options.items():
            what = {"choices": kind} if isinstance(kind, tuple) else {"type": kind}
            what = {"action": "store_true"} if kind is None else what
            flag = f"--{name.replace('_', '-')}"
            parser.add_argument(flag, help=text, default=argparse.SUPPRESS, **what)
        text = "folder, default out"
        parser.add_argument("--out", type=location, default=Path("out"), help=text)

    def run(self, args: argparse.Namespace) -> int:
        """Measure, write, name what was written; the exit status."""
        arguments.check_targets((), args.out)
        module, _, name = self.work.partition(":")
        kind = getattr(importlib.import_module(f"ngepc.studies.{module}"), name)
        given = {name: getattr(args, name) for name in self.options if hasattr(args, name)}
        work = kind(args.out, progress=arguments.teller(args.quiet), **given)
        table = work.run()
        arguments.name_written(work.write(table))
        return 0 if self.success(table) else 1


LEVELS = {"levels": (count, "meshes of the family, from the coarsest; default 3")}
NODES = {"lshape_nodes": (count, "mesh of Example (a)"), "wrench_nodes": (count, "of Example (b)")}
FIGURES = {"figures": (None, "pictures, too")}
NAMES = {"rows": (words, "names of rows separated by commas; default all")}
COUNTS = {
    **LEVELS,
    "rows": (words, "such as 1e0,1e3,default,default*,primal; default the paper's and default"),
    "tolerance": (positive, "default 1e-10"),
    "figures": (None, "figures and an HTML page, too"),
}

STUDIES = {
    "table1": Study("Newton steps over meshes and gamma, Example (a)", "counts:Table1", COUNTS),
    "table2": Study("Newton steps over meshes and gamma, Example (b)", "counts:Table2", COUNTS),
    "table3": Study(
        "path-following for Example (b), and direct solves beside it",
        "table3:Table3",
        {**LEVELS, "inner_scale": (positive, "c, default 0.1")},
    ),
    "figures": Study(
        "Figures 2, 3, 5 and 6 at the end of paths in gamma",
        "figures:Figures",
        {"only": (counts, "numbers of the figures, such as 2,3; default 2,3,5,6"), **NODES},
    ),
    "figure4": Study(
        "convergence quotients of the last Newton steps",
        "figure4:Figure4",
        {**LEVELS, "gamma": (positive, "default 1e4")},
    ),
    "duality": Study(
        "the duality gap and its parts along paths in gamma",
        "duality:Duality",
        {**NODES, "gamma_end": (positive, "default 1e6")},
    ),
    "differentiability": Study(
        "the norm gap of Definition 6.1, counts without the Tichonov term",
        "differentiability:Differentiability",
        {
            "levels": (count, "radii of the discs, default 7"),
            "nodes": (count, "finest mesh of the counts, default 1601"),
            "gamma": (positive, "of the counts, default 1e4"),
        },
        success=bool,
    ),
    "step42": Study("the body of step-42 by two methods", "step42:Step42", LEVELS),
    "counts": Study(
        "Newton steps of the default method: meshes, nested, hardening, 3D; the primal one beside",
        "newton_counts:NewtonCounts",
        LEVELS,
        success=bool,
    ),
    "cost": Study(
        "what a solve costs in elastic solves: counts, ratios, scaling, memory",
        "cost:Cost",
        {**LEVELS, "modes": (words, "of default,order 2,primal,1e4")},
    ),
    "locking": Study("volume locking: three tests, orders 1 and 2", "locking:Locking", LEVELS),
    "bounds": Study("guaranteed bounds beside the error", "bounds:Bounds", LEVELS | FIGURES),
    "benchmarks": Study(
        "published problems with numbers: NAFEMS, Code_Aster, Hill, Hertz, Mindlin, ...",
        "benchmarks:Benchmarks",
        NAMES | FIGURES,
        success=nothing_to_complain,
    ),
    "large": Study(
        "large bodies: Newton steps and iterations of multigrid solvers, time and memory",
        "large:Large",
        {**LEVELS, "solver": (("pyamg", "petsc"), "default pyamg")},
    ),
    "processes": Study(
        "a large body shared by processes: the same steps, time and memory of each",
        "processes:Processes",
        {**LEVELS, "counts": (counts, "numbers of processes, default 1,2,4,8")},
    ),
    "derivatives": Study(
        "gradients of random problems beside differences, Taylor slopes, the envelope theorem",
        "derivatives:Derivatives",
        {"count": (count, "problems, default 200")},
        success=in_agreement,
    ),
}
"""Name -> study."""


def configure(parser: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """Add one subcommand for each study."""
    studies = parser.add_subparsers(dest="study", required=True, metavar="STUDY")
    for name, study in STUDIES.items():
        sub = studies.add_parser(
            name, help=study.help, description=f"{study.help}.", parents=[common]
        )
        study.configure(sub)


def run(args: argparse.Namespace) -> int:
    """Run the chosen study."""
    return STUDIES[args.study].run(args)
