"""``ngepc study table1``: Newton steps over meshes and gamma for Example (a)."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=3, help="meshes, 1 to 6, default 3")
    parser.add_argument("--rows", help="rows of the table, such as 1e0,1e3,1e5*; default all")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")
    parser.add_argument("--tolerance", type=positive, default=1e-10, help="default 1e-10")
    parser.add_argument("--figures", action="store_true", help="figures and the HTML page too")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.newton import NewtonOptions
    from ngepc.studies.table1 import ROWS, Table1

    if args.levels > len(lshape.PAPER_NODES):
        raise ValueError(f"--levels {args.levels}: 1 to {len(lshape.PAPER_NODES)} are available")
    options = NewtonOptions(tolerance=args.tolerance, max_iterations=2000)
    rows = ROWS if args.rows is None else tuple(args.rows.split(","))
    nodes = lshape.PAPER_NODES[: args.levels]
    study = Table1(args.out, nodes, rows, options, progress=say)
    table = study.run()
    written = study.write(table)
    if args.figures:
        from ngepc.studies.pictures import table1_pictures

        written += table1_pictures(study, table)
    sys.stdout.write("".join(f"wrote {path}\n" for path in written))
    return 0 if all(record["status"] == "converged" for record in table) else 1
