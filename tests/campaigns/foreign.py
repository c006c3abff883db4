"""Mesh files of other programs: read, refused by name, and solved."""

import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ngsolve import Integrate

from ngepc.geometries import imported
from ngepc.geometries.cells import SHAPES
from ngepc.methods.newton import semismooth_newton
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.studies.work import Work

TEXTS = {".md", ".sh", ".py", ""}
"""Suffixes of files in the folders that are no meshes."""

ENDS = (0.02, 0.1, 0.3, 0.6)
"""Parts of the length in which facets of an end are looked for."""

METAL = {"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": 1.25, "hardening": 100.0}
PRESSED = 0.01  # part of the length by which the obstacle pushes in


def read(path):
    """The contents of a file, or the message that refuses it."""
    try:
        deck = path.suffix.lower() == ".inp"
        return imported._deck(path) if deck else imported._by_meshio(path)
    except ValueError as error:
        return str(error)


def has_body(source):
    """Whether there are solids, or plane cells in a plane of constant z."""
    blocks = [
        (SHAPES.get(b.type.rstrip("0123456789"), (0,))[0], b) for b in source.cells
    ]
    N = max((dimension for dimension, _ in blocks), default=0)
    if N != 2:
        return N == 3
    points = np.asarray(source.points, dtype=float)
    used = np.concatenate([np.ravel(b.data) for d, b in blocks if d == 2])
    flat = points.shape[1] == 2
    return flat or np.ptp(points[used, 2]) <= 1e-9 * np.ptp(points[used])


def pressed(mesh):
    """The body held at one end of its longest side, with an obstacle that pushes the other in."""
    x = np.asarray(mesh.ngmesh.Coordinates())[:, : mesh.dim]
    axis = int(np.ptp(x, axis=0).argmax())
    low, length = x[:, axis].min(), np.ptp(x[:, axis])

    def place(*coordinates):
        return (coordinates[axis] - low) / length

    mesh = at_end(mesh, "held end", lambda part: lambda *c: place(*c) <= part)
    mesh = at_end(mesh, "pressed end", lambda part: lambda *c: place(*c) >= 1 - part)
    material = Material.kinematic(**METAL)
    contact = {"contact": "pressed end", "gap": -PRESSED * length}
    return Problem(mesh, material, "held end", order=1, **contact)


def at_end(mesh, name, where):
    """The mesh with a name for the facets of one end, within the shortest part that has any."""
    for part in ENDS:
        try:
            return imported.name(mesh, name, where(part))
        except ValueError as error:
            last = error
    raise last


@dataclass(eq=False)
class Foreign(Work):
    """The files of the folders in ``beds``; bodies of at most ``nodes`` nodes are solved."""

    beds: Path = Path("out/beds")
    nodes: int = 4000

    name, title = "foreign", "Mesh files of other projects"
    columns = """ = {bed} | files = {files} | not read = {unread} | without a body = {other}
        | bodies = {bodies} | read = {accepted} | refused = {refused} | raw errors = {raw}
        | solved = {solved}"""
    note = (
        "Not read: by meshio, or a damaged deck, refused with the file's name. Without a body: "
        "beams, shells and networks, refused as well. Bodies: solids, or plane meshes; each is "
        "read, or refused with a message. Solved: of those with at most {study.nodes} nodes, "
        "held at one end and pressed at the other by 1 percent of the length until it yields, "
        "order 1, converged. campaigns/beds.py says where the files are from."
    )

    def cells(self):
        paths = sorted(p for p in self.beds.glob("*/**/*") if p.suffix not in TEXTS)
        files = [p for p in paths if p.is_file()]
        if not files:
            raise ValueError(
                f"beds={str(self.beds)!r}: a folder with mesh files is needed; "
                "python -m campaigns.beds FOLDER makes one"
            )
        return [{"file": str(p.relative_to(self.beds))} for p in files]

    def solve(self, file):
        path = self.beds / file
        kind = {"bed": Path(file).parts[0]}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                found = self.judged(path)
            except Exception as error:  # what this campaign looks for
                found = {"outcome": "raw", "sentence": repr(error)}
        if "sentence" in found:
            found["sentence"] = found["sentence"].replace(f"{self.beds}/", "")
        return kind | found

    def judged(self, path):
        """The record of one file."""
        source = read(path)
        if isinstance(source, str):
            return {"outcome": "unread", "sentence": source}
        body = has_body(source)
        try:
            mesh = imported.mesh(source)
        except (TypeError, ValueError) as error:
            return {"outcome": "refused" if body else "other", "sentence": str(error)}
        found = {"outcome": "accepted", "nodes": mesh.nv, "elements": mesh.ne}
        if mesh.nv > self.nodes:
            return found
        try:
            result = semismooth_newton(pressed(mesh))
        except ValueError as error:
            return found | {"sentence": str(error)}
        yields = Integrate(result.equivalent_plastic_strain, result.problem.mesh) > 0
        return found | {"ended": str(result.status), "yields": bool(yields)}

    def table_rows(self, records):
        beds = sorted({record["bed"] for record in records})
        rows = [
            self.counted(bed, [r for r in records if r["bed"] == bed]) for bed in beds
        ]
        return [*rows, self.counted("all", records)]

    def counted(self, bed, records):
        """One row of the table."""
        count = Counter(record["outcome"] for record in records)
        solved = sum(r.get("ended") == "converged" and r["yields"] for r in records)
        bodies = count["accepted"] + count["refused"]
        names = ("unread", "other", "accepted", "refused", "raw")
        row = {name: count[name] for name in names}
        return {
            "bed": bed,
            "files": len(records),
            "bodies": bodies,
            "solved": solved,
        } | row
