"""``ngepc study figure4``: convergence quotients of the last Newton steps."""

import argparse

from ngepc.cli.arguments import (
    add_levels,
    add_out,
    exit_status,
    name_written,
    positive,
    say,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser)
    parser.add_argument("--gamma", type=positive, default=1e4, help="default 1e4")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.figure4 import Figure4

    study = Figure4(args.out, args.levels, args.gamma, say)
    table = study.run()
    name_written(study.write(table))
    return exit_status(table)
