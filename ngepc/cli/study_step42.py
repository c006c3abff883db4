"""``ngepc study step42``: the dual method against the primal one on the body of step-42."""

import argparse

from ngepc.cli.arguments import add_levels, add_out, check_levels, name_written, say


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_levels(parser, 5)
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.step42 import CELLS, Step42

    most = max(map(len, CELLS.values()))
    check_levels(args.levels, most)
    study = Step42(args.out, args.levels, say)
    table = study.run()
    name_written(study.write(table))
    runs = [record[name] for record in table for name in ("primal", "dual")]
    return 0 if all(run["status"] == "converged" for run in runs) else 1
