"""Arguments that several commands share, types that check as they parse, and what commands say."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from ngepc.cli.interrupt import raise_if_pressed

PROBLEMS = ("lshape", "wrench")


def _above_zero(kind: type, text: str, needed: str) -> float:
    with suppress(ValueError):
        if 0 < (value := kind(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"{text!r}: {needed} > 0 is needed")


def positive(text: str) -> float:
    """A finite number > 0."""
    return _above_zero(float, text, "a finite number")


def count(text: str) -> int:
    """An integer > 0."""
    return _above_zero(int, text, "an integer")


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas, such as 1e0,1e3,default."""
    parts = tuple(word.strip() for word in text.split(","))
    if not all(parts):
        raise argparse.ArgumentTypeError(f"{text!r}: words separated by commas are needed")
    return parts


def counts(text: str) -> tuple[int, ...]:
    """Integers > 0 separated by commas, such as 2,3."""
    return tuple(count(word) for word in words(text))


def location(text: str) -> Path:
    """The name of a file or folder, not empty; '-' may stand for standard output."""
    if not text:
        raise argparse.ArgumentTypeError(f"{text!r}: the name of a file or folder is needed")
    return Path(text)


def add_body(parser: argparse.ArgumentParser) -> None:
    """PROBLEM, --nodes and --maxh."""
    parser.add_argument("problem", choices=PROBLEMS, help="Example (a) or (b) of the paper")
    mesh = parser.add_mutually_exclusive_group()
    text = "mesh of the paper's family with so many nodes, default the first of the paper's tables"
    mesh.add_argument("--nodes", type=count, help=text)
    mesh.add_argument("--maxh", type=positive, help="CSG mesh of this width instead")


def add_json(parser: argparse.ArgumentParser) -> None:
    """--json."""
    text = "write the result there, - for standard output; ngepc.results.records lists the fields"
    parser.add_argument("--json", metavar="FILE", type=location, help=text)


def teller(quiet: bool) -> Callable[[str], None]:
    """What puts lines of progress on standard error, and raises a Ctrl-C that was lost."""

    def tell(line: str) -> None:
        if not quiet:
            sys.stderr.write(line + "\n")
            sys.stderr.flush()
        raise_if_pressed()

    return tell


def exit_status(command: str, status: str, done: str, how: str) -> int:
    """The exit status of a run; after Ctrl-C with a line that says how to go on."""
    if status != "stopped":
        return 0 if status in ("converged", "bounded") else 1
    sys.stderr.write(f"ngepc {command}: stopped by you after {done}; {how}\n")
    return 130


def name_written(paths: Iterable[Path]) -> None:
    """One line on standard output for each file that was written."""
    sys.stdout.write("".join(f"wrote {path}\n" for path in paths))


def summary(record: dict, error: str) -> dict[str, object]:
    """What people are told of a solve: label -> value; ``error`` says how far the bound goes."""
    return {
        "mesh": f"{record['problem']}, {record['nodes']} nodes, {record['elements']} elements",
        "unknowns": record["unknowns"],
        "method": ", ".join(filter(None, (record["method"], record["label"]))),
        "status": record["status"],
        "steps": record["iterations"],
        "residual": f"{record['residual_norm']:.3g}",
        "energy J": f"{record['primal_energy']:.10g}",
        "-J*": f"{-record['dual_energy']:.10g}",
        "contact force": f"{record['contact_force']:.10g}",
        "energy error": error,
        "time": f"{record['wall_time_s']:.2f} s",
    }


def report(record: dict, lines: dict[str, object], target: Path | None, quiet: bool) -> None:
    """Some lines and the message of a record on standard output, all of it as JSON in a file.

    ``lines`` maps labels to what is printed after them; ``target`` '-' puts the JSON on standard
    output instead, None leaves it out; ``quiet`` leaves out the lines.
    """
    from ngepc.results import records

    if str(target) == "-":
        sys.stdout.write(records.to_json(record))
        return
    if target is not None:
        records.write_text(target, records.to_json(record))
    if quiet:
        return
    width = max(map(len, lines))
    printed = [f"{label:{width}s}  {value}" for label, value in lines.items()]
    printed += [record["message"]] if record["message"] else []
    printed += [f"wrote {target}"] if target is not None else []
    sys.stdout.write("".join(f"{line}\n" for line in printed))


def check_targets(files: Iterable[Path | None], folder: Path | None = None) -> None:
    """Raise OSError now, not after the work, if results cannot be written."""
    from ngepc.results.files import check_folder, check_writable

    for path in files:
        if path is not None and str(path) != "-":
            check_writable(path)
    if folder is not None:
        check_folder(folder)
