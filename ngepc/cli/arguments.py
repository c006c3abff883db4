"""Arguments that several commands share, and types that check as they parse."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ngepc.cli.interrupt import raise_if_pressed

if TYPE_CHECKING:
    from ngepc.model.problem import Problem
    from ngepc.studies.count_table import CountTable

PROBLEMS = ("lshape", "wrench")


def positive(text: str) -> float:
    """A finite number > 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: a finite number > 0 is needed")
    return value


def count(text: str) -> int:
    """An integer > 0."""
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r}: an integer > 0 is needed")
    return value


def file_name(text: str) -> str:
    """The name of a file or folder, not empty; '-' may stand for standard output."""
    if not text:
        raise argparse.ArgumentTypeError(f"{text!r}: the name of a file or folder is needed")
    return text


def location(text: str) -> Path:
    """The same as a Path."""
    return Path(file_name(text))


def add_body(parser: argparse.ArgumentParser) -> None:
    """PROBLEM, --nodes and --maxh."""
    parser.add_argument("problem", choices=PROBLEMS, help="Example (a) or (b) of the paper")
    mesh = parser.add_mutually_exclusive_group()
    mesh.add_argument("--nodes", type=count, help="mesh of the paper's family with so many nodes")
    mesh.add_argument("--maxh", type=positive, help="CSG mesh of this width instead")


def build_problem(name: str, nodes: int | None, maxh: float | None) -> Problem:
    """The example's problem on the mesh asked for; by default the first of the paper's table.

    Raises
    ------
    ValueError
        If the family has no mesh with so many nodes.
    """
    from ngepc import lshape_problem, wrench_problem
    from ngepc.geometries import lshape, wrench

    body, make = {"lshape": (lshape, lshape_problem), "wrench": (wrench, wrench_problem)}[name]
    mesh = body.mesh(maxh) if maxh else body.paper_mesh(nodes or body.PAPER_NODES[0])
    return make(mesh)


def say(line: str) -> None:
    """One line of progress on standard error.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C has been pressed and was lost on its way.
    """
    sys.stderr.write(line + "\n")
    sys.stderr.flush()
    raise_if_pressed()


def add_levels(parser: argparse.ArgumentParser, most: int = 6) -> None:
    """--levels, the number of meshes."""
    text = f"meshes, 1 to {most}, default 3"
    parser.add_argument("--levels", type=count, default=3, help=text)


def check_levels(levels: int, most: int) -> None:
    """Raise ValueError if there are fewer meshes than asked for."""
    if levels > most:
        raise ValueError(f"--levels {levels}: 1 to {most} are available")


def add_out(parser: argparse.ArgumentParser) -> None:
    """--out, the folder of the results."""
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def add_count_table(parser: argparse.ArgumentParser, example: str) -> None:
    """Arguments of a table of Newton steps; ``example`` shows what rows are called."""
    add_levels(parser)
    parser.add_argument("--rows", help=f"rows of the table, such as {example}; default all")
    add_out(parser)
    parser.add_argument("--tolerance", type=positive, default=1e-10, help="default 1e-10")


def count_table(kind: type[CountTable], args: argparse.Namespace) -> CountTable:
    """The study that the arguments of ``add_count_table`` ask for."""
    from ngepc.dual.newton import NewtonOptions

    check_levels(args.levels, len(kind.family))
    options = NewtonOptions(tolerance=args.tolerance, max_iterations=2000)
    rows = None if args.rows is None else args.rows.split(",")
    return kind(args.out, kind.family[: args.levels], rows, options, progress=say)


def name_written(paths: Iterable[Path]) -> None:
    """One line on standard output for each file that was written."""
    sys.stdout.write("".join(f"wrote {path}\n" for path in paths))


def report(record: dict, keys: Sequence[str], target: str | None) -> None:
    """Some entries of a record and its message on standard output, all of it as JSON in a file.

    Parameters
    ----------
    record
        The whole record.
    keys
        Those to be printed.
    target
        The file; '-' puts the JSON on standard output instead, None leaves it out.
    """
    from ngepc.results import records

    if target == "-":
        sys.stdout.write(records.to_json(record))
        return
    width = max(map(len, keys))
    lines = [f"{key:{width}s} {record[key]}" for key in keys]
    if record["message"]:
        lines.append(record["message"])
    if target is not None:
        records.write_text(Path(target), records.to_json(record))
        lines.append(f"wrote {target}")
    sys.stdout.write("".join(f"{line}\n" for line in lines))


def exit_status(table: Iterable[dict]) -> int:
    """0 if every record of a study has converged, else 1."""
    return 0 if all(record["status"] == "converged" for record in table) else 1


def run_on_levels(
    args: argparse.Namespace,
    most: int,
    measure: Callable[[], list[dict]],
    write: Callable[[Path, list[dict]], list[Path]],
) -> int:
    """Check --levels, measure, write; the exit status of a study of solvers."""
    check_levels(args.levels, most)
    table = measure()
    name_written(write(args.out, table))
    return exit_status(table)
