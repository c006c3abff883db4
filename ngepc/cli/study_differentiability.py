"""``ngepc study differentiability``: the norm gap, and counts without the Tichonov term."""

import argparse

from ngepc.cli.arguments import add_out, count, name_written, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=7, help="radii of the discs, default 7")
    parser.add_argument(
        "--nodes", type=count, default=1601, help="finest mesh of the counts, default 1601"
    )
    parser.add_argument("--gamma", type=positive, default=1e4, help="of the counts, default 1e4")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.model.examples import lshape_problem
    from ngepc.studies.differentiability import write_differentiability
    from ngepc.theory.differentiability import counts_without_tichonov, difference_quotients

    lshape.paper_mesh(args.nodes)
    family = [n for n in (113, 225, 417, *lshape.PAPER_NODES) if n <= args.nodes]
    quotients = difference_quotients(args.levels)
    say("quotients done")
    problems = [lshape_problem(lshape.paper_mesh(n)) for n in family]
    counts = counts_without_tichonov(problems, args.gamma)
    written = write_differentiability(args.out, quotients, counts)
    name_written(written)
    return 0
