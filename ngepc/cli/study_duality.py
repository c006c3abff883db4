"""``ngepc study duality``: the duality gap and its parts along the paths of both examples."""

import argparse

from ngepc.cli.arguments import add_out, count, exit_status, name_written, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--lshape-nodes", type=count, default=833, help="default 833")
    parser.add_argument("--wrench-nodes", type=count, default=873, help="default 873")
    parser.add_argument("--gamma-end", type=positive, default=1e6, help="default 1e6")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape, wrench
    from ngepc.path.options import PathOptions
    from ngepc.studies.duality import duality_along_path, write_duality

    options = PathOptions(gamma_start=10.0, growth=10.0, gamma_end=args.gamma_end, inner_scale=1e-8)
    for body, nodes in ((lshape, args.lshape_nodes), (wrench, args.wrench_nodes)):
        body.paper_mesh(nodes)  # a mesh that does not exist is an error before the work
    table = duality_along_path("lshape", args.lshape_nodes, options, say)
    table += duality_along_path("wrench", args.wrench_nodes, options, say)
    name_written(write_duality(args.out, table))
    return exit_status(table)
