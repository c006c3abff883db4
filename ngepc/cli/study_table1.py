"""``ngepc study table1``: Newton steps over meshes and gamma for Example (a)."""

import argparse

from ngepc.cli.arguments import add_count_table, count_table, exit_status, name_written


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_count_table(parser, example="1e0,1e3,1e5*")
    parser.add_argument("--figures", action="store_true", help="figures and the HTML page too")


def run(args: argparse.Namespace) -> int:
    """Run the study and name what it wrote."""
    from ngepc.studies.table1 import Table1

    study = count_table(Table1, args)
    table = study.run()
    written = study.write(table)
    if args.figures:
        from ngepc.studies.pictures import table1_pictures

        written += table1_pictures(study, table)
    name_written(written)
    return exit_status(table)
