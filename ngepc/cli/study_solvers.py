"""``ngepc study solvers``: coupled, exact and primal side by side."""

import argparse

from ngepc.cli.arguments import add_levels, add_out, run_on_levels, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser)
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.studies.solvers import compare_solvers, write_solvers

    nodes = lshape.PAPER_NODES
    return run_on_levels(
        args, len(nodes), lambda: compare_solvers(nodes[: args.levels], say), write_solvers
    )
