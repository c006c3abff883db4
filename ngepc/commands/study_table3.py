"""``ngepc study table3``: path-following for Example (b), and direct solves beside it."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=3, help="meshes, 1 to 6, default 3")
    parser.add_argument("--inner-scale", type=positive, default=0.1, help="c, default 0.1")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import wrench
    from ngepc.path.options import PathOptions
    from ngepc.studies.table3 import Table3

    if args.levels > len(wrench.PAPER_NODES):
        raise ValueError(f"--levels {args.levels}: 1 to {len(wrench.PAPER_NODES)} are available")
    options = PathOptions(inner_scale=args.inner_scale)
    study = Table3(args.out, wrench.PAPER_NODES[: args.levels], options, progress=say)
    table = study.run()
    sys.stdout.write("".join(f"wrote {path}\n" for path in study.write(table)))
    statuses = {record[key] for record in table for key in ("status", "direct_status")}
    return 0 if statuses == {"converged"} else 1
