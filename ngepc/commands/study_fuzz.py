"""``ngepc study fuzz``: random problems by both methods, judged."""

import argparse
import sys
from pathlib import Path

from ngepc.commands.arguments import count, location, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--count", type=count, default=200, help="problems, default 200")
    parser.add_argument("--seed", type=count, default=1, help="of the sequence, default 1")
    parser.add_argument("--out", type=location, default=Path("out"), help="folder, default out")


def run(args: argparse.Namespace) -> int:
    """Run the study; exit status 1 if there is a complaint."""
    from ngepc.studies.fuzz import Fuzz

    study = Fuzz(args.out, args.count, args.seed, progress=say)
    verdicts = study.run()
    sys.stdout.write("".join(f"wrote {path}\n" for path in study.write(verdicts)))
    complaints = sum(bool(verdict.complaints) for verdict in verdicts)
    sys.stdout.write(f"{len(verdicts)} problems, {complaints} with complaints\n")
    return 0 if complaints == 0 else 1
