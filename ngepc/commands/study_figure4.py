"""``ngepc study figure4``: convergence quotients of the last Newton steps."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, positive, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=3, help="meshes, 1 to 6, default 3")
    parser.add_argument("--gamma", type=positive, default=1e4, help="default 1e4")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.figure4 import Figure4

    study = Figure4(args.out, args.levels, args.gamma, say)
    table = study.run()
    sys.stdout.write("".join(f"wrote {path}\n" for path in study.write(table)))
    return 0 if all(record["status"] == "converged" for record in table) else 1
