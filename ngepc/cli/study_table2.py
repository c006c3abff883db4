"""``ngepc study table2``: Newton steps over meshes and gamma for Example (b)."""

import argparse

from ngepc.cli.arguments import add_count_table, count_table, exit_status, name_written


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_count_table(parser, example="1e1,1e4")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.table2 import Table2

    study = count_table(Table2, args)
    table = study.run()
    name_written(study.write(table))
    return exit_status(table)
