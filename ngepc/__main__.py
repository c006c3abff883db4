"""The command line: ``ngepc solve``, ``ngepc study``, ...

Exit status 0 when everything converged, 1 when something did not, 2 for bad usage, 130 after
Ctrl-C.
"""

import argparse
import importlib
import logging
import sys
from collections.abc import Sequence
from pathlib import Path

import argcomplete

from ngepc.cli.commands import parser
from ngepc.cli.interrupt import remembered
from ngepc.results.files import no_empty_folders

PLACES = ("out", "figures", "save", "json", "checkpoint")
"""Arguments that name files or folders to be written."""


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
            command = importlib.import_module(f"ngepc.cli.{args.command}")  # now NGSolve is loaded
            return command.run(args)
    except (ValueError, TypeError, OSError, ImportError) as error:
        sys.stderr.write(f"ngepc {args.command}: error: {error}\n")
        return 2
    except KeyboardInterrupt:
        kept = ", and the same command goes on from there" if args.command == "study" else ""
        sys.stderr.write(f"ngepc {args.command}: stopped by you; what was written is kept{kept}\n")
        return 130


if __name__ == "__main__":
    sys.exit(main())
