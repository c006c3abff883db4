"""The command line: ``ngepc solve``, ``ngepc study``, ...

Exit status 0 when everything converged, 1 when something did not, 2 for bad usage, 130 after
Ctrl-C.  NGSolve's bindings clear an exception that a signal handler raises while they convert an
argument.  Therefore the handler stores the signal, and the next line of progress raises it again.
"""

import argparse
import importlib
import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

import argcomplete

from ngepc.cli.commands import COMMANDS, parser
from ngepc.results.files import no_empty_folders

log = logging.getLogger("ngepc")


@contextmanager
def remembered() -> Iterator[None]:
    """Record SIGINT in ``pressed`` of the handler, if Python's own handler is installed."""

    def handle(number: int, frame: FrameType | None) -> NoReturn:
        """Record that Ctrl-C was pressed, and interrupt."""
        handle.pressed = True
        raise KeyboardInterrupt

    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def parsed(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The arguments; --quiet and --verbose may stand anywhere, so that no parser has defaults."""
    top = parser()
    argcomplete.autocomplete(top)  # does nothing unless a shell asks
    return top.parse_args(arguments, argparse.Namespace(quiet=False, verbose=False))


def function_of(command: str) -> Callable[[argparse.Namespace], int]:
    """What does the work of a command."""
    module, _, name = (COMMANDS[command].work or f"work:{command}").partition(":")
    return getattr(importlib.import_module(f"ngepc.cli.{module}"), name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    args = parsed(arguments)
    level = logging.INFO if args.verbose else logging.WARNING
    logging.basicConfig(stream=sys.stderr, level=level, format="%(name)s: %(message)s")
    places = [value for value in vars(args).values() if isinstance(value, Path)]
    try:
        with remembered(), no_empty_folders(places):
            return function_of(args.command)(args)  # loads NGSolve where it is needed
    except (ValueError, TypeError, OSError, ImportError) as error:
        log.info("where the error arose", exc_info=error)
        sys.stderr.write(f"ngepc {args.command}: error: {error}\n")
        return 2
    except KeyboardInterrupt:
        kept = (
            "; run the same command again to resume" if args.command == "study" else ""
        )
        sys.stderr.write(
            f"ngepc {args.command}: interrupted; files written so far are kept{kept}\n"
        )
        return 130


if __name__ == "__main__":
    sys.exit(main())
