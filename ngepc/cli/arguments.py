"""Types that check the texts of arguments as they are parsed."""

import argparse
import math
from contextlib import suppress
from pathlib import Path


def _above_zero(kind: type, text: str, needed: str) -> float:
    with suppress(ValueError):
        if 0 < (value := kind(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"{text!r}: {needed} > 0 is needed")


def positive(text: str) -> float:
    """A finite number > 0."""
    return _above_zero(float, text, "a finite number")


def count(text: str) -> int:
    """An integer > 0."""
    return _above_zero(int, text, "an integer")


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas, such as 1e0,1e3,default."""
    parts = tuple(word.strip() for word in text.split(","))
    if not all(parts):
        raise argparse.ArgumentTypeError(f"{text!r}: words separated by commas are needed")
    return parts


def counts(text: str) -> tuple[int, ...]:
    """Integers > 0 separated by commas, such as 2,3."""
    return tuple(count(word) for word in words(text))


def location(text: str) -> Path:
    """The name of a file or folder, not empty; '-' may stand for standard output."""
    if not text:
        raise argparse.ArgumentTypeError(f"{text!r}: the name of a file or folder is needed")
    return Path(text)
