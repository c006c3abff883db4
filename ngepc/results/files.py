"""Files that are written atomically, and a check before the work that they can be written."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ROOM = 1 << 20
"""Free bytes that must be available where results are written; checked before the work."""


def check_writable(path: Path) -> None:
    """Raise OSError now, not after the work, if ``path`` cannot be written.

    A missing folder is made.  Of a device or a pipe only the permissions are checked.
    """
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: name a file")
    if is_special(path):
        if not os.access(path, os.W_OK):
            raise PermissionError(f"{path} cannot be written")
        return
    check_folder(path.parent, str(path))


def check_folder(folder: Path, place: str = "") -> None:
    """Make ``folder`` if it is missing, write and remove ``ROOM`` bytes there, or raise OSError.

    The error names ``place``, the folder by default.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".room.") as probe:
            probe.write(bytes(ROOM))
            probe.flush()
            os.fsync(probe.fileno())
    except OSError as error:
        raise _named(error, place or f"folder {folder}") from error


def _named(error: OSError, place: str) -> OSError:
    """The same error with the name of the file in place of the temporary name."""
    return type(error)(
        error.errno, f"{place} cannot be written: {error.strerror or error}"
    )


@contextmanager
def no_empty_folders(paths: Iterable[Path]) -> Iterator[None]:
    """At the end, folders that were made for ``paths`` are removed if they are empty."""
    new = [p for path in paths for p in (path, *path.parents) if not p.exists()]
    try:
        yield
    finally:
        for folder in new:
            with suppress(OSError):  # it is not empty, or a file, or was never made
                folder.rmdir()


def is_special(path: Path) -> bool:
    """Whether ``path`` exists and is neither a file nor a folder: a device, a pipe, a socket."""
    return path.exists() and not path.is_file() and not path.is_dir()


def replace_contents(path: Path, content: bytes) -> None:
    """Write a file atomically: the old contents stay until the new ones are on disk.

    Devices and pipes are written directly.

    OSError, with the name of the file, if the disk is full or the folder cannot be written; the old
    file is then as it was.
    """
    if is_special(path):
        try:
            path.write_bytes(content)
        except OSError as error:
            raise _named(error, str(path)) from error
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise _named(error, str(path)) from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException as error:  # the unfinished file is removed, after Ctrl-C too
        Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _named(error, str(path)) from error
        raise
