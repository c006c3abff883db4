"""``ngepc study NAME``: a table, figure or check of the registry ``ngepc.cli.commands.STUDIES``."""

import argparse
import importlib

from ngepc.cli import output
from ngepc.cli.commands import STUDIES, Command, given
from ngepc.studies.work import Work


def study_class(study: Command) -> type[Work]:
    """The class that does the work of a study."""
    module, _, name = study.work.partition(":")
    return getattr(importlib.import_module(f"ngepc.studies.{module}"), name)


def run(args: argparse.Namespace) -> int:
    """Measure, write, name what was written; the exit status."""
    study = STUDIES[args.study]
    output.check_targets((), args.out)
    options = given(args, study.options)
    work = study_class(study)(args.out, progress=output.teller(args.quiet), **options)
    records = work.run()
    output.name_written(work.write(records))
    return 0 if work.succeeded(records) else 1
