"""Every command and every study with its options: tables, from which the parser is made.

The work itself is in ``solve``, ``work``, ``figures`` and ``receipts``, and in ``ngepc.studies``.
This module does not import NGSolve, so that help and usage errors appear at once.
"""

import argparse
import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, NoReturn

from ngepc._version import __version__


def positive(text: str, kind: type = float, needed: str = "a finite number") -> float:
    """A number > 0."""
    with suppress(ValueError):
        if 0 < (value := kind(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"{text!r}: {needed} > 0 is needed")


def count(text: str) -> int:
    """An integer > 0."""
    return positive(text, int, "an integer")


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas, such as 1e0,1e3,default."""
    parts = tuple(word.strip() for word in text.split(","))
    if not all(parts):
        raise argparse.ArgumentTypeError(
            f"{text!r}: words separated by commas are needed"
        )
    return parts


def counts(text: str) -> tuple[int, ...]:
    """Integers > 0 separated by commas, such as 2,3."""
    return tuple(map(count, words(text)))


def location(text: str) -> Path:
    """The name of a file or folder, not empty; '-' may stand for standard output."""
    if not text:
        raise argparse.ArgumentTypeError(
            f"{text!r}: the name of a file or folder is needed"
        )
    return Path(text)


OPTIONS = {
    "problem": (("lshape", "wrench"), "Example (a) or (b) of the paper"),
    "[example]": (
        ("lshape", "wrench", "sphere"),
        "Example (a) or (b) of the paper, or a sphere pressed into a block",
        "lshape",
    ),
    "--port N": (count, "port of the page on this machine; default: a free one"),
    "--no-browser": (None, "print the address of the page, but do not open it"),
    "--nodes N": (
        count,
        "use the paper's mesh with N nodes; default: its coarsest in the tables",
    ),
    "--maxh H": (positive, "use an unstructured mesh of this width instead"),
    "--json FILE": (location, "write the result as JSON; - for standard output"),
    "--method": (
        ("default", "primal"),
        "default: the exact method; primal: a second, independent solver",
        "default",
    ),
    "--gamma G": (positive, "use the paper's method with this gamma"),
    "--start START": (
        str,
        "zero (default), coarse (a solution on a coarse mesh) or a file of --save",
        "zero",
    ),
    "body": (
        (
            "cut",
            "strip",
            "square",
            "sheet",
            "punch",
            "rough-punch",
            "bree",
            "bree-hot",
            "hole",
            "hole-both",
        ),
        "a vertical cut, ground under a strip, a square, a sheet with a hole, a block of clay"
        " under a punch; loads that vary (shakedown): Bree's plate, a plate with a hole",
    ),
    "--width X": (
        positive,
        "refine until (upper - lower) / lower is at most X; default 0.01",
        0.01,
    ),
    "--max-cells N": (
        count,
        "largest number of elements; default: 10000 triangles or 2000 tetrahedra",
    ),
    "--error TOL": (
        positive,
        "refine the mesh until the relative energy error is below TOL",
    ),
    "--goal NAME": (
        ("contact_force", "work"),
        "refine the mesh until this number is guaranteed to --percent",
    ),
    "--percent P": (positive, "half width of the interval in percent, default 1"),
    "--tolerance X": (positive, "tolerance of the residual, default 1e-10"),
    "--max-iterations N": (count, "largest number of Newton steps, default 300"),
    "--save FILE": (location, "save the run in a .npz file"),
    "--receipt FILE": (
        location,
        "write the proof of the interval to a .npz file, for ngepc check",
    ),
    "--figures DIR": (location, "write PNG figures to this folder"),
    "--gamma-start G": (positive, "first gamma, default 10"),
    "--growth X": (positive, "theta > 1, the growth of gamma, default 7"),
    "--gamma-end G": (
        positive,
        "continue to this gamma, however little V_gamma changes",
    ),
    "--inner-tolerance X": (positive, "tau_in, default 10"),
    "--inner-scale C": (
        positive,
        "factor on the inner tolerances, default 0.1 (in the paper 1)",
    ),
    "--outer-tolerance X": (positive, "tau_out, default 0.7"),
    "--residual-tolerance X": (
        positive,
        "follow the path until the residual is below X",
    ),
    "--max-outer-iterations N": (count, "largest number of gammas, default 30"),
    "--checkpoint FILE": (
        location,
        "save the path after each gamma; the same command resumes from it",
    ),
    "run_file": (location, "a file written by ngepc solve --save"),
    "receipt": (location, "a file written by ngepc.write_receipt"),
    "--out FILE": (location, "the HTML file; default: next to the run"),
    "folder": (location, "target folder, created if necessary"),
    "--solutions": (None, "also copy the solutions of the exercises"),
    "--force": (None, "replace existing files"),
    "--out DIR": (location, "output folder, default: out", Path("out")),
    "--levels N": (
        count,
        "number of meshes from the coarsest, default 3 (differentiability: radii, default 7)",
    ),
    "--rows A,B": (
        words,
        "only these rows, such as 1e0,default,default*,primal or NAFEMS R94",
    ),
    "--figures": (None, "also draw figures"),
    "--lshape-nodes N": (count, "number of nodes of Example (a)"),
    "--wrench-nodes N": (count, "number of nodes of Example (b)"),
    "--solver": (("pyamg", "petsc"), "linear solver, default pyamg"),
    "--counts N,M": (counts, "numbers of processes, default 1,2,4,8"),
    "--order N": (count, "order of the displacements, 1 or 2, default 1"),
}
"""Usage -> what reads the value (or the words to choose from, None for a switch), help, default."""

BODY = ("problem", "--nodes N", "--maxh H", "--json FILE")
NEWTON = ("--tolerance X", "--max-iterations N")
PATH = (
    "--gamma-start G",
    "--growth X",
    "--gamma-end G",
    "--inner-tolerance X",
    "--inner-scale C",
    "--outer-tolerance X",
    "--residual-tolerance X",
    "--max-outer-iterations N",
)
"""Fields of NewtonOptions and PathOptions."""


EXAMPLES = """
ngepc solve lshape                               the default method on 833 nodes
ngepc solve wrench --nodes 6353 --figures out    with pictures
ngepc solve lshape --gamma 1e4 --start coarse    the paper's method, as in Table 1
ngepc solve lshape --error 1e-2                  refine until the error is at most 1 percent
ngepc solve lshape --goal contact_force          refine until the force is known to 1 percent
ngepc solve lshape --save run.npz                save the run, for a report or as a start
ngepc solve lshape --receipt proof.npz           write the proof of the energy for ngepc check
ngepc limit cut --width 0.005 --figures out      bounds of the load at which a cut collapses
ngepc limit hole-both --width 0.01               factor of loads that vary (shakedown)
ngepc check receipt.npz                          check the proof that the file contains
ngepc report run.npz                             an HTML report with an interactive view
ngepc path wrench --nodes 1641                        as in Table 3
ngepc path lshape --gamma-end 1e6 --checkpoint p.npz  after Ctrl-C the same command resumes
ngepc study table1 --levels 2 --out out/demo      after Ctrl-C the same command resumes
ngepc study benchmarks --figures                 published problems, with pictures
ngepc lab lshape                                 drag the load and see the solution
ngepc notebooks mine --solutions                 lectures and exercises; then: jupyter lab mine
eval "$(register-python-argcomplete ngepc)"      completion by the Tab key, in this shell
"""
"""A line of them belongs to the command that it names."""


class Command(NamedTuple):
    """Help, usage of the options, and what does the work.

    For studies that is MODULE:CLASS of ``ngepc.studies``, for commands MODULE:FUNCTION of
    ``ngepc.cli``, by default the function of ``work`` with the name of the command.
    """

    help: str
    options: Sequence[str] = ("--levels N",)
    work: str = ""


COMMANDS = {
    "solve": Command(
        "solve one problem on one mesh",
        (
            *BODY,
            "--method",
            "--gamma G",
            "--start START",
            "--error TOL",
            "--goal NAME",
            "--percent P",
            *NEWTON,
            "--save FILE",
            "--receipt FILE",
            "--figures DIR",
        ),
        "solve:solve",
    ),
    "path": Command(
        "follow the path in gamma on one mesh", (*BODY, "--checkpoint FILE", *PATH)
    ),
    "study": Command("make a table or figure of the paper, or another measurement", ()),
    "report": Command(
        "write an HTML report about a saved run",
        ("run_file", "--out FILE"),
        "figures:report",
    ),
    "check": Command(
        "check the proof in a receipt", ("receipt",), "receipts:check_file"
    ),
    "limit": Command(
        "lower and upper bounds of a limit load, or of loads that vary (shakedown)",
        ("body", "--width X", "--max-cells N", "--json FILE", "--figures DIR"),
    ),
    "lab": Command(
        "a live laboratory in the browser: drag loads, gaps, yield stress",
        ("[example]", "--port N", "--no-browser"),
        "figures:open_lab",
    ),
    "notebooks": Command(
        "copy the notebooks to a folder", ("folder", "--solutions", "--force")
    ),
}

COUNTS = ("--levels N", "--rows A,B")
NODES = ("--lshape-nodes N", "--wrench-nodes N")

STUDIES = {
    "table1": Command(
        "Newton steps over meshes and gamma, Example (a)", COUNTS, "counts:Table1"
    ),
    "table2": Command(
        "Newton steps over meshes and gamma, Example (b)", COUNTS, "counts:Table2"
    ),
    "table3": Command(
        "path-following for Example (b), compared with direct solves",
        ("--levels N", "--inner-scale C"),
        "paths:Table3",
    ),
    "figures": Command(
        "Figures 2, 3, 5 and 6, ends of paths in gamma", NODES, "paths:Figures"
    ),
    "figure4": Command(
        "quotients of the last Newton steps", work="convergence:Figure4"
    ),
    "duality": Command("the duality gap along paths in gamma", NODES, "paths:Duality"),
    "differentiability": Command(
        "the norm gap", work="differentiability:Differentiability"
    ),
    "without_tichonov": Command(
        "Newton steps with and without Tichonov's term",
        ("--nodes N", "--gamma G"),
        "convergence:WithoutTichonov",
    ),
    "step42": Command("the body of step-42 by two methods", work="step42:Step42"),
    "counts": Command("Newton steps of the default method", work="counts:NewtonCounts"),
    "cost": Command("cost of a solve, in elastic solves", work="cost:Cost"),
    "locking": Command(
        "volume locking: three tests, orders 1 and 2", work="locking:Locking"
    ),
    "overlap": Command(
        "overlap between nodes, and stability of the contact pressure",
        work="overlap:BetweenNodes",
    ),
    "bounds": Command(
        "guaranteed error bounds and the true error", work="bounds:Bounds"
    ),
    "benchmarks": Command(
        "published problems: NAFEMS, Code_Aster, Hill, Hertz, Mindlin, ...",
        ("--rows A,B", "--figures"),
        "benchmarks:Benchmarks",
    ),
    "accuracy": Command(
        "time to 5 and 1 percent error, ngepc and CalculiX", work="accuracy:Accuracy"
    ),
    "threads": Command(
        "wall time with one and with several threads", (), work="threads:Threads"
    ),
    "large": Command(
        "large bodies by multigrid",
        ("--levels N", "--order N", "--solver"),
        "large:Large",
    ),
    "processes": Command(
        "a large body on several processes: time and memory",
        ("--levels N", "--order N", "--counts N,M"),
        "large:Processes",
    ),
}
"""Name -> study."""


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def parse_known_args(
        self, *args: object, **named: object
    ) -> tuple[argparse.Namespace, list]:
        """The arguments; those not known are an error of the command that they were given to."""
        found, rest = super().parse_known_args(*args, **named)
        if rest:
            self.error(f"unrecognized arguments: {' '.join(rest)}")
        return found, rest


def parser() -> argparse.ArgumentParser:
    """The argument parser with all commands and studies."""
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    verbose = "log every Newton step, and where an error arose"
    common.add_argument("--verbose", action="store_true", help=verbose)
    common.add_argument("--quiet", action="store_true", help="no progress, no summary")
    page = {
        "formatter_class": argparse.RawDescriptionHelpFormatter,
        "parents": [common],
    }
    text = "Elasto-plastic contact by semismooth Newton methods."
    top = OneLineParser(
        prog="ngepc", description=text, epilog=examples_of("ngepc"), **page
    )
    top.add_argument("--version", action="version", version=f"ngepc {__version__}")
    subs = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        sub = subs.add_parser(
            name, help=command.help, epilog=examples_of(f"ngepc {name}"), **page
        )
        declare(sub, command.options)
        if name == "study":
            studies = sub.add_subparsers(dest="study", required=True, metavar="STUDY")
    for name, study in STUDIES.items():
        sub = studies.add_parser(
            name, help=study.help, description=study.help, parents=[common]
        )
        declare(sub, (*study.options, "--out DIR"))
    return top


def examples_of(command: str) -> str:
    """The lines of ``EXAMPLES`` with a command, below a heading."""
    lines = [f"  {line}" for line in EXAMPLES.splitlines() if command in line]
    return "\n".join(["examples:", *lines])


def declare(parser: argparse.ArgumentParser, options: Sequence[str]) -> None:
    """Add options by their usage in ``OPTIONS``, such as '--nodes N'."""
    for usage in options:
        kind, text, default = (*OPTIONS[usage], None)[:3]
        name, _, value = usage.partition(" ")
        how: dict = {"type": kind, "metavar": value or None}
        if kind is None or isinstance(kind, tuple):
            how = {"action": "store_true"} if kind is None else {"choices": kind}
        if name.startswith("["):
            how["nargs"] = "?"
        parser.add_argument(name.strip("[]"), help=text, default=default, **how)


def given(args: argparse.Namespace, options: Sequence[str]) -> dict[str, object]:
    """What Python calls these options -> their values, where there are any."""
    names = (usage.split()[0].lstrip("-").replace("-", "_") for usage in options)
    return {
        name: getattr(args, name) for name in names if getattr(args, name) is not None
    }
