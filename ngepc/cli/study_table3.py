"""``ngepc study table3``: path-following for Example (b), and direct solves beside it."""

import argparse

from ngepc.cli.arguments import (
    add_levels,
    add_out,
    check_levels,
    name_written,
    positive,
    say,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser)
    parser.add_argument("--inner-scale", type=positive, default=0.1, help="c, default 0.1")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import wrench
    from ngepc.path.options import PathOptions
    from ngepc.studies.table3 import Table3

    check_levels(args.levels, len(wrench.PAPER_NODES))
    options = PathOptions(inner_scale=args.inner_scale)
    study = Table3(args.out, wrench.PAPER_NODES[: args.levels], options, progress=say)
    table = study.run()
    name_written(study.write(table))
    statuses = {record[key] for record in table for key in ("status", "direct_status")}
    return 0 if statuses == {"converged"} else 1
