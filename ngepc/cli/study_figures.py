"""``ngepc study figures``: Figures 2, 3, 5 and 6."""

import argparse

from ngepc.cli.arguments import add_out, count, exit_status, name_written, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--only", help="numbers of the figures, such as 2,3; default 2,3,5,6")
    parser.add_argument("--lshape-nodes", type=count, default=3201, help="default 3201")
    parser.add_argument("--wrench-nodes", type=count, default=6353, help="default 6353")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Follow the paths, draw, and name what was written."""
    from ngepc.studies.figures import CAPTIONS, Figures

    numbers = tuple(CAPTIONS)
    if args.only is not None:
        words = [word.strip() for word in args.only.split(",")]
        if not all(word.isdigit() for word in words):
            raise ValueError(f"--only {args.only}: numbers such as 2,3 are needed")
        numbers = tuple(map(int, words))
    nodes = {"lshape": args.lshape_nodes, "wrench": args.wrench_nodes}
    study = Figures(args.out, nodes, numbers, say)
    table = study.run()
    name_written(study.write(table))
    return exit_status(table)
