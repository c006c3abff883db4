"""``ngepc study fuzz``: random problems by both methods, judged."""

import argparse
import sys

from ngepc.cli.arguments import add_out, count, name_written, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("--count", type=count, default=200, help="problems, default 200")
    parser.add_argument("--seed", type=count, default=1, help="of the sequence, default 1")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study; exit status 1 if there is a complaint."""
    from ngepc.studies.fuzz import Fuzz

    study = Fuzz(args.out, args.count, args.seed, progress=say)
    verdicts = study.run()
    name_written(study.write(verdicts))
    complaints = sum(bool(verdict.complaints) for verdict in verdicts)
    sys.stdout.write(f"{len(verdicts)} problems, {complaints} with complaints\n")
    return 0 if complaints == 0 else 1
