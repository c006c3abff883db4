"""The command line: ``ngepc solve``, ``ngepc study``, ...

Exit status 0 when everything converged, 1 when something did not, 2 for bad usage, 130 after
Ctrl-C.
"""

import argparse
import logging
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import argcomplete

from ngepc._version import __version__
from ngepc.cli import notebooks, path, report, solve, study
from ngepc.cli.interrupt import remembered
from ngepc.results.files import no_empty_folders

PLACES = ("out", "figures", "save", "json", "checkpoint")
"""Arguments that name files or folders to be written."""

EXAMPLES = """examples:
  ngepc solve lshape --figures out                 one solve, with pictures
  ngepc study table1 --levels 3                    a table of the paper
  ngepc notebooks lectures                         lectures and exercises
  eval "$(register-python-argcomplete ngepc)"      the Tab key completes, in this shell
"""

COMMANDS = {
    "solve": (solve, "solve one problem on one mesh"),
    "path": (path, "follow the path in gamma on one mesh"),
    "study": (study, "remake a table or figure of the paper, count, compare, measure"),
    "report": (report, "write one HTML file about a saved run"),
    "notebooks": (notebooks, "copy the notebooks to a folder"),
}


class OneLineParser(argparse.ArgumentParser):
    """A parser that says what is wrong in one line, without the usage in front."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """The argument parser with all subcommands."""
    common = argparse.ArgumentParser(add_help=False, argument_default=argparse.SUPPRESS)
    common.add_argument("--verbose", action="store_true", help="log every Newton step")
    common.add_argument("--quiet", action="store_true", help="no progress, no summary")
    text = "Elasto-plastic contact by semismooth Newton methods."
    pages = {"formatter_class": argparse.RawDescriptionHelpFormatter, "parents": [common]}
    top = OneLineParser(prog="ngepc", description=text, epilog=EXAMPLES, **pages)
    top.add_argument("--version", action="version", version=f"ngepc {__version__}")
    subparsers = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (module, text) in COMMANDS.items():
        words = {"help": text, "description": f"{text.capitalize()}.", "epilog": module.EXAMPLES}
        sub = subparsers.add_parser(name, **words, **pages)
        module.configure(*((sub, common) if module is study else (sub,)))
        sub.set_defaults(run=module.run)
    return top


def parsed(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The arguments; --quiet and --verbose may stand anywhere, so that no parser has defaults."""
    top = parser()
    argcomplete.autocomplete(top)  # does nothing unless a shell asks
    return top.parse_args(arguments, argparse.Namespace(quiet=False, verbose=False))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    args = parsed(arguments)
    level = logging.INFO if args.verbose else logging.WARNING
    logging.basicConfig(stream=sys.stderr, level=level, format="%(name)s: %(message)s")
    named = (vars(args).get(name) for name in PLACES)
    places = [place for place in named if isinstance(place, Path)]
    try:
        with remembered(), no_empty_folders(places):
            return args.run(args)
    except (ValueError, TypeError, OSError, ImportError) as error:
        sys.stderr.write(f"ngepc {args.command}: error: {error}\n")
        return 2
    except KeyboardInterrupt:
        kept = ", and the same command goes on from there" if args.command == "study" else ""
        sys.stderr.write(f"ngepc {args.command}: stopped by you; what was written is kept{kept}\n")
        return 130


if __name__ == "__main__":
    sys.exit(main())
