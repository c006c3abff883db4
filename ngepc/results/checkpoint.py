"""Checkpoints: arrays and a record in one file, written whole or not at all.

A checkpoint carries a fingerprint of the work it belongs to.  A file that cannot be read, or that
belongs to other work or to another version, is refused with a message and never overwritten.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ngepc._version import __version__
from ngepc.checks.arguments import sample
from ngepc.model.places import Coulomb, values_at
from ngepc.model.problem import Problem
from ngepc.results.files import replace_contents

FORMAT = 2


class Checkpoint(NamedTuple):
    """What a checkpoint file holds: numbers, texts, lists and dictionaries, and arrays by name."""

    record: dict
    arrays: dict[str, np.ndarray]


def save(path: Path, fingerprint: Mapping, record: Mapping, arrays: Mapping) -> None:
    """Write a checkpoint atomically: until it is complete the old file stays.

    OSError if the folder is missing or full.
    """
    header = {"format": FORMAT, "fingerprint": dict(fingerprint), "record": record}
    header["arrays"] = sorted(arrays)
    stream = io.BytesIO()
    np.savez(stream, header=np.array(json.dumps(header)), **arrays)
    replace_contents(path, stream.getvalue())


def load(path: Path, fingerprint: Mapping) -> Checkpoint | None:
    """Read a checkpoint of the work that ``fingerprint`` describes; None if there is no file.

    ValueError if the file is damaged, or belongs to other work or to another version.
    """
    if not path.exists():
        return None
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError("it is no .npz file")
        with np.load(path, allow_pickle=False) as data:  # the archive has a checksum of each array
            arrays = {name: data[name] for name in data.files}
        header = json.loads(str(arrays.pop("header")))
        form, theirs, record = header["format"], dict(header["fingerprint"]), header["record"]
        if form == FORMAT and header["arrays"] != sorted(arrays):
            raise ValueError("it is incomplete")
    except Exception as error:  # damaged archives make NumPy and zipfile raise almost anything
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
        raise ValueError(
            f"checkpoint {path} belongs to other work: {', '.join(different)} differ; move it away"
        )
    return Checkpoint(record, arrays)


def work_fingerprint(kind: str, problem: Problem, **more: object) -> dict:
    """What stored work belongs to: the version, the mesh, the data, and ``more``."""
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
        digest.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part))
    return digest.hexdigest()


def problem_fingerprint(problem: Problem) -> str:
    """A digest of all data of a problem but its mesh, sampled on the mesh."""
    mesh, material, law = problem.mesh, problem.material, problem.material.law
    names = (problem.clamped_names, problem.contact_names, *problem.contact_pairs)
    told = [repr((*names, problem.kinematics.name, problem.order)), type(law).__qualname__]
    body = [material.lame_lambda, material.lame_mu, material.effective_hardening]
    body += [material.hardening, problem.beta, problem.p_0, *problem.alpha_0, problem.eps_0]
    body += [problem.accumulated_0, problem.u_0, problem.f, *(() if law is None else law.data)]
    told += ["none" if value is None else sample(value, mesh) for value in body]
    for kind in (problem.tractions, problem.gaps):
        for name, value in sorted(kind.items()):
            told += [name, sample(value, mesh, [name])]
    if problem.friction is not None:
        law = problem.friction
        value = law.coefficient if isinstance(law, Coulomb) else law
        told.append("Tresca" if value is law else "Coulomb")
        told.append(sample(value, mesh, list(problem.touching_names)))
    given = problem.single("prescribed").items()
    placed = [("held", p, values) for p, values in given if p not in problem.rollers]
    placed += [(f"roller {r.direction}", p, [r.value]) for p, r in problem.rollers.items()]
    placed += [("spring", p, [k for _, k in s]) for p, s in problem.spring_constants.items()]
    placed += [("load", p, [g]) for p, g in problem.loads.items() if not isinstance(p, str)]
    for kind, place, values in sorted(placed, key=lambda entry: (entry[0], str(entry[1]))):
        told.append(f"{kind} {place}")
        told += ["free" if v is None else values_at(v, mesh, place)[1] for v in values]
    return digest_of(told)
