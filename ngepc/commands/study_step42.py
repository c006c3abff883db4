"""``ngepc study step42``: the dual method against the primal one on the body of step-42."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--levels", type=count, default=3, help="meshes, 1 to 5, default 3")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.step42 import CELLS, Step42

    most = max(map(len, CELLS.values()))
    if args.levels > most:
        raise ValueError(f"--levels {args.levels}: 1 to {most} are available")
    study = Step42(args.out, args.levels, say)
    table = study.run()
    sys.stdout.write("".join(f"wrote {path}\n" for path in study.write(table)))
    runs = [record[name] for record in table for name in ("primal", "dual", "sharper", "nodal")]
    return 0 if all(run["status"] == "converged" for run in runs) else 1
