"""``ngepc report RUN``: one HTML file about a saved run or a finished study."""

import argparse
import sys

from ngepc.cli.arguments import location


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        "run_file",
        metavar="RUN",
        type=location,
        help="file of ngepc solve --save, or folder of table1",
    )
    parser.add_argument("--out", type=location, help="the HTML file; default beside RUN")


def run(args: argparse.Namespace) -> int:
    """Write the report and name it."""
    if args.run_file.is_dir():
        from ngepc.studies.pictures import folder_report

        path = folder_report(args.run_file, args.out or args.run_file / "report.html")
    else:
        from ngepc.pictures.run_report import run_report
        from ngepc.results.runs import load_run

        record, result = load_run(args.run_file)
        path = run_report(record, result, args.out or args.run_file.with_suffix(".html"))
    sys.stdout.write(f"wrote {path}\n")
    return 0
