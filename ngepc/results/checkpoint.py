"""Checkpoints: arrays and a record in one file, written whole or not at all.

A checkpoint carries a fingerprint of the work it belongs to.  A file that cannot be read, or that
belongs to other work or to another version, is refused with a message and never overwritten.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ngepc.results.files import replace_contents

FORMAT = 1


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a checkpoint file holds: numbers, texts, lists and dictionaries, and arrays by name."""

    record: dict
    arrays: dict[str, np.ndarray]


def save(path: Path, fingerprint: Mapping, record: Mapping, arrays: Mapping) -> None:
    """Write a checkpoint atomically: until it is complete the old file stays.

    OSError if the folder is missing or full.
    """
    header = {"format": FORMAT, "fingerprint": dict(fingerprint), "record": record}
    text = json.dumps({**header, "contents": contents_digest(arrays)})
    stream = io.BytesIO()
    np.savez(stream, header=np.array(text), **arrays)
    replace_contents(path, stream.getvalue())


def contents_digest(arrays: Mapping) -> str:
    """A digest of names, types, shapes and values of arrays."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape};".encode() + array.tobytes())
    return digest.hexdigest()


def load(path: Path, fingerprint: Mapping) -> Checkpoint | None:
    """Read a checkpoint of the work that ``fingerprint`` describes; None if there is no file.

    ValueError if the file is damaged, or belongs to other work or to another version.
    """
    if not path.exists():
        return None
    header, arrays = _read(path)
    if header.get("format") != FORMAT:
        raise ValueError(
            f"checkpoint {path} has format {header.get('format')}, this version of ngepc reads "
            f"{FORMAT}: move it away"
        )
    theirs, ours = header["fingerprint"], json.loads(json.dumps(dict(fingerprint)))
    different = sorted(k for k in {*theirs, *ours} if theirs.get(k) != ours.get(k))
    if different:
        raise ValueError(
            f"checkpoint {path} belongs to other work: {', '.join(different)} differ; move it away"
        )
    return Checkpoint(header["record"], arrays)


def _read(path: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Header and arrays of a file whose digest agrees.

    Damaged archives make NumPy and zipfile raise almost any exception.
    """
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError("it is no .npz file")
        with np.load(path, allow_pickle=False) as data:
            header = json.loads(str(data["header"]))
            arrays = {name: data[name] for name in data.files if name != "header"}
        if header["format"] == FORMAT:
            digest = contents_digest(arrays)
            if header.get("contents", digest) != digest:
                raise ValueError("its digest is wrong")
            if not isinstance(header["fingerprint"], dict) or "record" not in header:
                raise ValueError("it is incomplete")
    except Exception as error:  # see above: damage shows as almost anything
        raise ValueError(
            f"checkpoint {path} is damaged or no checkpoint ({error}): move it away"
        ) from error
    return header, arrays
