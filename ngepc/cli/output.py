"""What all commands write: progress, summaries, the names of files; and their exit status."""

import importlib
import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType

from ngepc.checks.sentences import counted
from ngepc.results import records
from ngepc.results.files import check_writable


def drawing() -> ModuleType:
    """``ngepc.cli.figures``; to load matplotlib takes as long as a small solve and its bound."""
    return importlib.import_module("ngepc.cli.figures")


def reporter(quiet: bool) -> Callable[[str], None]:
    """A function that writes lines of progress to standard error, and raises a lost Ctrl-C."""

    def report(line: str) -> None:
        """Write a line to standard error; Ctrl-C that was pressed meanwhile interrupts."""
        if not quiet:
            sys.stderr.write(line + "\n")
            sys.stderr.flush()
        if getattr(signal.getsignal(signal.SIGINT), "pressed", False):
            raise KeyboardInterrupt

    return report


def check_targets(*files: Path | None) -> None:
    """Raise OSError now, not after the work, if results cannot be written."""
    for file in files:
        if file is not None and str(file) != "-":
            check_writable(file)


def name_written(paths: Iterable[Path]) -> None:
    """One line on standard output for each file that was written."""
    sys.stdout.write("".join(f"wrote {path}\n" for path in paths))


def summarise(
    record: dict,
    error: str,
    target: Path | None,
    quiet: bool,
    interval: str = "",
    **other: object,
) -> None:
    """Write a summary of a solve to standard output, and the record into ``target``.

    A ``target`` '-' puts the JSON on standard output instead; ``quiet`` leaves out the rest;
    ``error`` says how far the bound goes, ``interval`` what is known of a goal; ``other`` entries
    stand in place of those of the record.
    """
    if str(target) == "-":
        sys.stdout.write(records.to_json(record))
        return
    if target is not None:
        records.write_text(target, records.to_json(record))
    if quiet:
        return
    record = record | other
    elements = counted(record["elements"], "element")
    lines = {
        "mesh": f"{record['problem']}, {record['nodes']} nodes, {elements}",
        "unknowns": record["unknowns"],
        "method": ", ".join(filter(None, (record["method"], record["label"]))),
        "status": record["status"],
        "steps": record["iterations"],
        "residual": f"{record['residual_norm']:.3g}",
        "energy J": f"{record['primal_energy']:.10g}",
        "-J*": f"{-record['dual_energy']:.10g}",
        "contact force": f"{record['contact_force']:.7g}",
        "energy error": error,
        "goal": interval,
        "time": f"{record['wall_time_s']:.2f} s",
    }
    sys.stdout.write(
        "".join(
            f"{label:13s}  {value}\n" for label, value in lines.items() if value != ""
        )
    )
    sys.stdout.write(f"{record['message']}\n" if record["message"] else "")
    name_written([] if target is None else [target])


def exit_status(command: str, status: str, done: str, how: str) -> int:
    """The exit status of a run; after Ctrl-C it writes a line on how to resume."""
    if status != "stopped":
        return 0 if status in ("converged", "bounded") else 1
    sys.stderr.write(f"ngepc {command}: interrupted after {done}; {how}\n")
    return 130
