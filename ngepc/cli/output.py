"""What commands say and write: progress, summaries, JSON, exit statuses."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from ngepc.cli.interrupt import raise_if_pressed
from ngepc.results import records
from ngepc.results.files import check_folder, check_writable


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


def report(record: dict, error: str, target: Path | None, quiet: bool, **other: object) -> None:
    """Put what people want to know of a solve on standard output, the record into ``target``.

    A ``target`` '-' puts the JSON on standard output instead; ``quiet`` leaves out the rest;
    ``error`` says how far the bound goes, ``other`` entries stand in place of those of the record.
    """
    if target is not None and str(target) != "-":
        records.write_text(target, records.to_json(record))
    if quiet or str(target) == "-":
        sys.stdout.write(records.to_json(record) if str(target) == "-" else "")
        return
    told = record | other
    lines = {
        "mesh": f"{told['problem']}, {told['nodes']} nodes, {told['elements']} elements",
        "unknowns": told["unknowns"],
        "method": ", ".join(filter(None, (told["method"], told["label"]))),
        "status": told["status"],
        "steps": told["iterations"],
        "residual": f"{told['residual_norm']:.3g}",
        "energy J": f"{told['primal_energy']:.10g}",
        "-J*": f"{-told['dual_energy']:.10g}",
        "contact force": f"{told['contact_force']:.10g}",
        "energy error": error,
        "time": f"{told['wall_time_s']:.2f} s",
    }
    printed = [f"{label:13s}  {value}" for label, value in lines.items()]
    printed += [record["message"]] if record["message"] else []
    sys.stdout.write("".join(f"{line}\n" for line in printed))
    name_written([] if target is None else [target])


def check_targets(files: Iterable[Path | None], folder: Path | None = None) -> None:
    """Raise OSError now, not after the work, if results cannot be written."""
    for path in files:
        if path is not None and str(path) != "-":
            check_writable(path)
    if folder is not None:
        check_folder(folder)
