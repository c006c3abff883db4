"""The command line: ``ngepc solve``, ``ngepc study``, ...

Exit status 0 when everything converged, 1 when something did not, 2 for bad usage.
"""

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from ngepc._version import __version__
from ngepc.cli.interrupt import remembered
from ngepc.results.files import no_empty_folders

PLACES = ("out", "figures", "save", "json", "checkpoint")
"""Arguments that name files or folders to be written."""

COMMANDS = {
    "solve": "solve one regularised problem on one mesh",
    "path": "follow the path in gamma on one mesh",
    "study": "remake a table or figure of the paper",
    "benchmark": "measure steps against elastic solves: counts, ratios, scaling, memory",
    "notebooks": "copy the notebooks to a folder",
    "report": "write one HTML file about a saved run or a finished study",
}


class OneLineParser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line, without the usage in front."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The argument parser with all subcommands."""
    top = OneLineParser(
        prog="ngepc", description="Elasto-plastic contact by semismooth Newton methods."
    )
    top.add_argument("--version", action="version", version=f"ngepc {__version__}")
    top.add_argument("--verbose", action="store_true", help="log every Newton step")
    subparsers = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in COMMANDS.items():
        sub = subparsers.add_parser(name, help=text, description=text.capitalize() + ".")
        module = importlib.import_module(f"ngepc.cli.{name}")
        module.configure(sub)
        sub.set_defaults(run=module.run)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    args = parser().parse_args(arguments)
    level = logging.INFO if args.verbose else logging.WARNING
    logging.basicConfig(stream=sys.stderr, level=level, format="%(name)s: %(message)s")
    named = (vars(args).get(name) for name in PLACES)
    places = [Path(name) for name in named if isinstance(name, str | Path)]
    try:
        with remembered(), no_empty_folders(places):
            return args.run(args)
    except (ValueError, TypeError, OSError) as error:
        sys.stderr.write(f"ngepc {args.command}: error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write(f"ngepc {args.command}: interrupted\n")
        return 1


if __name__ == "__main__":
    sys.exit(main())
