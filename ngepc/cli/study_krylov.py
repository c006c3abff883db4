"""``ngepc study krylov``: counts of the Krylov solvers in three dimensions."""

import argparse

from ngepc.cli.arguments import add_out, count, run_on_levels, say

MESHES = 4


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    text = f"meshes: 281, 1745, 12193, ... nodes; 1 to {MESHES}, default 1"
    parser.add_argument("--levels", type=count, default=1, help=text)
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.krylov import count_iterations, write_krylov

    return run_on_levels(args, MESHES, lambda: count_iterations(args.levels, say), write_krylov)
