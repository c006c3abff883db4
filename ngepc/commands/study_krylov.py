"""``ngepc study krylov``: counts of the Krylov solvers in three dimensions."""

import argparse

from ngepc.commands.arguments import (
    add_out,
    check_levels,
    count,
    exit_status,
    name_written,
    say,
)

MESHES = 4


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    text = f"meshes: 281, 1745, 12193, ... nodes; 1 to {MESHES}, default 1"
    parser.add_argument("--levels", type=count, default=1, help=text)
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.storage.files import check_folder
    from ngepc.studies.krylov import count_iterations, write_krylov

    check_levels(args.levels, MESHES)
    check_folder(args.out)
    table = count_iterations(args.levels, say)
    name_written(write_krylov(args.out, table))
    return exit_status(table)
