"""``ngepc study balanced``: Newton steps of the balanced regularisation on both examples."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=3, help="meshes, 1 to 6, default 3")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.geometries import lshape
    from ngepc.storage.files import check_folder
    from ngepc.studies.balanced import count_balanced, write_balanced

    if args.levels > len(lshape.PAPER_NODES):
        raise ValueError(f"--levels {args.levels}: 1 to {len(lshape.PAPER_NODES)} are available")
    check_folder(args.out)
    table = count_balanced(args.levels, say)
    sys.stdout.write("".join(f"wrote {path}\n" for path in write_balanced(args.out, table)))
    return 0 if all(record["status"] == "converged" for record in table) else 1
