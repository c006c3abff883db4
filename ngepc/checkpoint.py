"""Checkpoints: arrays and a record in one file, written whole or not at all.

A checkpoint carries a fingerprint of the work it belongs to.  A file that cannot be read, or that
belongs to other work or to another version, is refused with a message and never overwritten.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ngsolve import Mesh

FORMAT = 1


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a checkpoint file holds.

    Parameters
    ----------
    record
        Numbers, strings, lists and dictionaries (JSON).
    arrays
        Name -> array.
    """

    record: dict
    arrays: dict[str, np.ndarray]


def mesh_fingerprint(mesh: Mesh) -> str:
    """A digest of the vertices and elements of a mesh."""
    netgen_mesh = mesh.ngmesh
    elements = netgen_mesh.Elements2D() if mesh.dim == 2 else netgen_mesh.Elements3D()
    digest = hashlib.sha256(np.ascontiguousarray(netgen_mesh.Coordinates()).tobytes())
    digest.update(np.ascontiguousarray(elements.NumPy()["nodes"]).tobytes())
    return digest.hexdigest()


def save(path: Path, fingerprint: Mapping, record: Mapping, arrays: Mapping) -> None:
    """Write a checkpoint atomically: until it is complete the old file stays.

    Raises
    ------
    OSError
        If the folder is missing or full.
    """
    header = json.dumps({"format": FORMAT, "fingerprint": dict(fingerprint), "record": record})
    stream = io.BytesIO()
    np.savez(stream, header=np.array(header), **arrays)
    write_bytes(path, stream.getvalue())


def write_bytes(path: Path, content: bytes) -> None:
    """Replace the contents of ``path`` in one step."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def load(path: Path, fingerprint: Mapping) -> Checkpoint | None:
    """Read a checkpoint of the work that ``fingerprint`` describes; None if there is no file.

    Raises
    ------
    ValueError
        If the file is damaged, or belongs to other work or to another version.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            header = json.loads(str(data["header"]))
            arrays = {name: data[name] for name in data.files if name != "header"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"checkpoint {path} is damaged or no checkpoint ({error}): move it away"
        ) from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ValueError(f"checkpoint {path} has another format: move it away")
    theirs, ours = header["fingerprint"], json.loads(json.dumps(dict(fingerprint)))
    different = sorted(k for k in {*theirs, *ours} if theirs.get(k) != ours.get(k))
    if different:
        raise ValueError(
            f"checkpoint {path} belongs to other work: {', '.join(different)} differ; move it away"
        )
    return Checkpoint(header["record"], arrays)
