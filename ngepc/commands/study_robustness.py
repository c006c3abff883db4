"""``ngepc study robustness``: data at their extremes, iterations and statuses."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--rows", help="rows of the table separated by commas; default all")
    parser.add_argument("--limit", type=count, default=200, help="most Newton steps, default 200")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study; exit status 0: every run has ended in a named status."""
    from ngepc.studies.robustness import Robustness

    rows = None if args.rows is None else [row.strip() for row in args.rows.split(",")]
    study = Robustness(args.out, rows, args.limit, progress=say)
    table = study.run()
    sys.stdout.write("".join(f"wrote {path}\n" for path in study.write(table)))
    return 0
