"""What commands say and write: progress, summaries, exit statuses."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from ngepc.results import records
from ngepc.results.files import check_folder, check_writable


def teller(quiet: bool) -> Callable[[str], None]:
    """What puts lines of progress on standard error, and raises a Ctrl-C that was lost."""

    def tell(line: str) -> None:
        if not quiet:
            sys.stderr.write(line + "\n")
            sys.stderr.flush()
        if getattr(signal.getsignal(signal.SIGINT), "pressed", False):
            raise KeyboardInterrupt

    return tell


def check_targets(files: Iterable[Path | None], folder: Path | None = None) -> None:
    """Raise OSError now, not after the work, if results cannot be written."""
    for path in files:
        if path is not None and str(path) != "-":
            check_writable(path)
    if folder is not None:
        check_folder(folder)


def name_written(paths: Iterable[Path]) -> None:
    """One line on standard output for each file that was written."""
    sys.stdout.write("".join(f"wrote {path}\n" for path in paths))


def summarise(record: dict, error: str, target: Path | None, quiet: bool, **other: object) -> None:
    """Put what people want to know of a solve on standard output, the record into ``target``.

    A ``target`` '-' puts the JSON on standard output instead; ``quiet`` leaves out the rest;
    ``error`` says how far the bound goes, ``other`` entries stand in place of those of the record.
    """
    if str(target) == "-":
        sys.stdout.write(records.to_json(record))
        return
    if target is not None:
        records.write_text(target, records.to_json(record))
    if quiet:
        return
    record = record | other
    lines = {
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
    sys.stdout.write("".join(f"{label:13s}  {value}\n" for label, value in lines.items()))
    sys.stdout.write(f"{record['message']}\n" if record["message"] else "")
    name_written([] if target is None else [target])


def exit_status(command: str, status: str, done: str, how: str) -> int:
    """The exit status of a run; after Ctrl-C with a line that says how to go on."""
    if status != "stopped":
        return 0 if status in ("converged", "bounded") else 1
    sys.stderr.write(f"ngepc {command}: stopped by you after {done}; {how}\n")
    return 130
