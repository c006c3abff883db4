"""``ngepc study solvers``: coupled, balanced and primal side by side."""

import argparse

from ngepc.commands.arguments import (
    add_levels,
    add_out,
    check_levels,
    exit_status,
    name_written,
    say,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser)
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.storage.files import check_folder
    from ngepc.studies.solvers import compare_solvers, write_solvers

    check_levels(args.levels, len(lshape.PAPER_NODES))
    check_folder(args.out)
    table = compare_solvers(lshape.PAPER_NODES[: args.levels], say)
    name_written(write_solvers(args.out, table))
    return exit_status(table)
