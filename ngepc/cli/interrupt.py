"""Ctrl-C that cannot get lost.

An exception that a signal handler raises while NGSolve's bindings convert an argument is cleared
by them.  The handler of the commands therefore remembers the signal too, and the next line of
progress raises it again.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn


class Interrupt:
    """A handler of SIGINT that raises KeyboardInterrupt and remembers it."""

    def __init__(self) -> None:
        self.pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> NoReturn:
        """Handle the signal."""
        self.pressed = True
        raise KeyboardInterrupt


@contextmanager
def remembered() -> Iterator[None]:
    """Handle SIGINT by ``Interrupt`` where Python's own handler is in charge."""
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, Interrupt())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def raise_if_pressed() -> None:
    """Raise KeyboardInterrupt if SIGINT has come and was lost."""
    handler = signal.getsignal(signal.SIGINT)
    if isinstance(handler, Interrupt) and handler.pressed:
        raise KeyboardInterrupt
