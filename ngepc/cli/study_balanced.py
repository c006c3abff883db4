"""``ngepc study balanced``: Newton steps of the balanced regularisation on both examples."""

import argparse

from ngepc.cli.arguments import add_levels, add_out, run_on_levels, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser)
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.studies.balanced import count_balanced, write_balanced

    most = len(lshape.PAPER_NODES)
    return run_on_levels(args, most, lambda: count_balanced(args.levels, say), write_balanced)
