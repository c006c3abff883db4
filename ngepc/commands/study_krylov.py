"""``ngepc study krylov``: counts of the Krylov solvers in three dimensions."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "--levels", type=count, default=1, help="meshes: 281, 1745, 12193, ... nodes, default 1"
    )
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.storage.files import check_folder
    from ngepc.studies.krylov import count_iterations, write_krylov

    if args.levels > 4:
        raise ValueError(f"--levels {args.levels}: 1 to 4 are available")
    check_folder(args.out)
    table = count_iterations(args.levels, say)
    sys.stdout.write("".join(f"wrote {path}\n" for path in write_krylov(args.out, table)))
    return 0 if all(cell["status"] == "converged" for cell in table) else 1
