"""``ngepc study table2``: Newton steps over meshes and gamma for Example (b)."""

import argparse

from ngepc.commands.arguments import (
    add_levels,
    add_out,
    check_levels,
    exit_status,
    name_written,
    positive,
    say,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser)
    parser.add_argument("--rows", help="rows of the table, such as 1e1,1e4; default all")
    add_out(parser)
    parser.add_argument("--tolerance", type=positive, default=1e-10, help="default 1e-10")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import wrench
    from ngepc.newton import NewtonOptions
    from ngepc.studies.table2 import ROWS, Table2

    check_levels(args.levels, len(wrench.PAPER_NODES))
    options = NewtonOptions(tolerance=args.tolerance, max_iterations=2000)
    rows = ROWS if args.rows is None else tuple(args.rows.split(","))
    study = Table2(args.out, wrench.PAPER_NODES[: args.levels], rows, options, progress=say)
    table = study.run()
    name_written(study.write(table))
    return exit_status(table)
