"""``ngepc study duality``: the duality gap and its parts along the paths of both examples."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--lshape-nodes", type=count, default=833, help="default 833")
    parser.add_argument("--wrench-nodes", type=count, default=873, help="default 873")
    parser.add_argument("--gamma-end", type=positive, default=1e6, help="default 1e6")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


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
    sys.stdout.write("".join(f"wrote {path}\n" for path in write_duality(args.out, table)))
    return 0 if all(record["status"] == "converged" for record in table) else 1
