"""``ngepc study balanced``: Newton steps of the balanced regularisation on both examples."""

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
    from ngepc.studies.balanced import count_balanced, write_balanced

    check_levels(args.levels, len(lshape.PAPER_NODES))
    check_folder(args.out)
    table = count_balanced(args.levels, say)
    name_written(write_balanced(args.out, table))
    return exit_status(table)
