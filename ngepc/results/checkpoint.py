"""Checkpoints: arrays and a record in one file, written atomically.

A checkpoint carries a fingerprint of the work it belongs to.  A file that cannot be read, or that
belongs to other work or to another version, is refused with a message and never overwritten.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngepc._version import __version__
from ngepc.checks.arguments import is_number, sample
from ngepc.model.data import ACTING, Components
from ngepc.model.places import Place, values_at
from ngepc.model.problem import Problem
from ngepc.results.files import replace_contents

FORMAT = 3


class Checkpoint(NamedTuple):
    """The contents of a checkpoint: a record (numbers, texts, lists, dictionaries) and arrays."""

    record: dict
    arrays: dict[str, np.ndarray]


class OtherWork(ValueError):
    """A checkpoint belongs to other work: the entries ``different`` of its fingerprint differ."""

    def __init__(self, path: Path, different: list[str]) -> None:
        self.different = different
        names = ", ".join(different)
        verb = "differ" if len(different) > 1 else "differs"
        super().__init__(
            f"checkpoint {path} belongs to other work: {names} {verb}; move it away"
        )


def save(path: Path, fingerprint: Mapping, record: Mapping, arrays: Mapping) -> None:
    """Write a checkpoint atomically: until it is complete the old file stays.

    OSError if the folder is missing or full.
    """
    header = {"format": FORMAT, "fingerprint": dict(fingerprint), "record": record}
    header["contents"] = contents_of(record, arrays)
    stream = io.BytesIO()
    np.savez(stream, header=np.array(json.dumps(header)), **arrays)
    replace_contents(path, stream.getvalue())


def load(path: Path, fingerprint: Mapping) -> Checkpoint | None:
    """Read a checkpoint of the work that ``fingerprint`` describes; None if there is no file.

    ValueError if the file is damaged, ``OtherWork`` if it belongs to other work or to another
    version.
    """
    if not path.exists():
        return None
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise ValueError("it is no .npz file")
        # the archive has a checksum of each array
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
        header = json.loads(str(arrays.pop("header")))
        form = header["format"]
        theirs = dict(header["fingerprint"])
        record = header["record"]
        if form == FORMAT and header["contents"] != contents_of(record, arrays):
            raise ValueError("its contents are not those that were written")
    except (MemoryError, PermissionError):
        raise  # the file may be in order
    except Exception as error:
        # NumPy and zipfile raise errors of many kinds for damaged archives
        raise ValueError(
            f"checkpoint {path} is damaged or no checkpoint ({error}): move it away"
        ) from error
    if form != FORMAT:
        raise ValueError(
            f"checkpoint {path} has format {form}, this version of ngepc reads {FORMAT}: "
            "move it away"
        )
    ours = json.loads(json.dumps(dict(fingerprint)))
    different = sorted(k for k in {*theirs, *ours} if theirs.get(k) != ours.get(k))
    if different:
        raise OtherWork(path, different)
    return Checkpoint(record, arrays)


def contents_of(record: object, arrays: Mapping[str, np.ndarray]) -> str:
    """A digest of a record and of the names, types, shapes and numbers of arrays."""
    parts = [json.dumps(record, sort_keys=True)]
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        parts += [f"{name} {array.dtype.str} {array.shape}", array]
    return digest_of(parts)


def work_fingerprint(kind: str, problem: Problem, **more: object) -> dict:
    """The fingerprint of a work: the version, the mesh, the data, and ``more``."""
    mesh = problem.mesh.ngmesh
    elements = mesh.Elements2D() if problem.N == 2 else mesh.Elements3D()
    return {
        "kind": kind,
        "version": __version__,
        "mesh": digest_of([mesh.Coordinates(), elements.NumPy()["nodes"]]),
        "problem": problem_fingerprint(problem),
        **more,
    }


def digest_of(parts: Iterable[str | np.ndarray]) -> str:
    """A digest of texts and arrays in their order."""
    digest = hashlib.sha256()
    for part in parts:
        text = isinstance(part, str)
        digest.update(f"{part}\n".encode() if text else np.ascontiguousarray(part))
    return digest.hexdigest()


def problem_fingerprint(problem: Problem) -> str:
    """A digest of all data of a problem but its mesh, sampled on the mesh."""
    given = problem.given
    given |= {name: problem.single(name) for name in ACTING}
    given |= {"mesh": None, "clamped": problem.clamped_names, "gap": problem.gaps}
    given["contact"] = problem.contact_names, problem.contact_pairs
    given["friction"] = {"|".join(problem.touching_names): problem.friction}
    return digest_of(
        part for name in given for part in (name, *data_of(given[name], problem.mesh))
    )


def data_of(
    value: object, mesh: Mesh, place: Place | None = None
) -> Iterator[str | np.ndarray]:
    """The texts and numbers of a datum, those of a coefficient in the body or at a place."""
    if isinstance(value, CoefficientFunction):
        if place is None or isinstance(place, str):
            yield sample(value, mesh, place and [place])
        else:
            yield values_at(value, mesh, place)[1]
    elif isinstance(value, Mapping):
        for key, one in sorted(value.items(), key=str):
            yield str(key)
            yield from data_of(one, mesh, key)
    elif isinstance(value, Components):
        for one in value:
            yield from data_of(one, mesh, place)
    elif is_dataclass(value):
        yield type(value).__qualname__
        yield from data_of(tuple(vars(value).values()), mesh, place)
    else:
        yield repr(float(value) if is_number(value) else value)
