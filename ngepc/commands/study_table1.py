"""``ngepc study table1``: Newton steps over meshes and gamma for Example (a)."""

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
    parser.add_argument("--rows", help="rows of the table, such as 1e0,1e3,1e5*; default all")
    add_out(parser)
    parser.add_argument("--tolerance", type=positive, default=1e-10, help="default 1e-10")
    parser.add_argument("--figures", action="store_true", help="figures and the HTML page too")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.newton import NewtonOptions
    from ngepc.studies.table1 import ROWS, Table1

    check_levels(args.levels, len(lshape.PAPER_NODES))
    options = NewtonOptions(tolerance=args.tolerance, max_iterations=2000)
    rows = ROWS if args.rows is None else tuple(args.rows.split(","))
    nodes = lshape.PAPER_NODES[: args.levels]
    study = Table1(args.out, nodes, rows, options, progress=say)
    table = study.run()
    written = study.write(table)
    if args.figures:
        from ngepc.studies.pictures import table1_pictures

        written += table1_pictures(study, table)
    name_written(written)
    return exit_status(table)
