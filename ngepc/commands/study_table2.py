"""``ngepc study table2``: Newton steps over meshes and gamma for Example (b)."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=3, help="meshes, 1 to 6, default 3")
    parser.add_argument("--rows", help="rows of the table, such as 1e1,1e4; default all")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")
    parser.add_argument("--tolerance", type=positive, default=1e-10, help="default 1e-10")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import wrench
    from ngepc.newton import NewtonOptions
    from ngepc.studies.table2 import ROWS, Table2

    if args.levels > len(wrench.PAPER_NODES):
        raise ValueError(f"--levels {args.levels}: 1 to {len(wrench.PAPER_NODES)} are available")
    options = NewtonOptions(tolerance=args.tolerance, max_iterations=2000)
    rows = ROWS if args.rows is None else tuple(args.rows.split(","))
    study = Table2(args.out, wrench.PAPER_NODES[: args.levels], rows, options, progress=say)
    table = study.run()
    sys.stdout.write("".join(f"wrote {path}\n" for path in study.write(table)))
    return 0 if all(record["status"] == "converged" for record in table) else 1
