"""``ngepc study robustness``: data at their extremes, iterations and statuses."""

import argparse

from ngepc.cli.arguments import add_out, count, name_written, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--rows", help="rows of the table separated by commas; default all")
    parser.add_argument("--limit", type=count, default=200, help="most Newton steps, default 200")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study; exit status 0: every run has ended in a named status."""
    from ngepc.studies.robustness import Robustness

    rows = None if args.rows is None else [row.strip() for row in args.rows.split(",")]
    study = Robustness(args.out, rows, args.limit, progress=say)
    table = study.run()
    name_written(study.write(table))
    return 0
