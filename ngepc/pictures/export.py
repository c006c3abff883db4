"""VTU files for ParaView, and PVD collections of load histories and of the parts of processes.

NGSolve's VTKOutput says nothing when it cannot write; here the file is checked before its name is
returned.  All fields are point data on each element's own corners, so that jumps stay.  Vectors
have three and tensors nine components, as ParaView expects, also in two dimensions.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

from ngsolve import CF, CoefficientFunction, VTKOutput

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_path
from ngepc.model.processes import Team
from ngepc.pictures.drawable import KINDS, field_of, fields_of
from ngepc.results.records import write_text

FIELDS = (
    "displacement",
    "plastic_strain",
    "equivalent_plastic_strain",
    "accumulated_plastic_strain",
    "stress",
    "von_mises",
    "yield_function",
)


def export_vtu(source: object, path: str | os.PathLike, fields: Sequence[str] = FIELDS) -> Path:
    """Write the fields of a result to a VTU file; returns its path.

    Where processes share the mesh each writes its part, '<stem>_0000.vtu', ..., and the path is
    that of '<stem>.pvd', which lists them.

    Parameters
    ----------
    source
        Result of a solver, or ``Fields``.
    path
        The file, ending in '.vtu'; its folder is made.
    fields
        Names of fields, see ``drawable.KINDS``.

    Returns
    -------
    Path
        What ParaView opens.

    Raises
    ------
    TypeError, ValueError
        If the source, the path or a field is none.
    OSError
        If NGSolve, which does not say so, wrote no file.
    """
    path = require_path("path", path, ".vtu")
    check_names(fields)
    parts = _write(source, path, fields)
    if len(parts) == 1:
        return path
    return _collect(path.with_suffix(".pvd"), {0: parts}, fields_of(source).problem.processes)


def export_series(
    sources: Sequence[object] | Mapping[float, object],
    path: str | os.PathLike,
    fields: Sequence[str] = FIELDS,
) -> Path:
    """Write a load history: a PVD file that lists the VTU file of each step; returns its path.

    The sources are results in order, at times 0, 1, 2, ..., or time -> result; the steps stand
    beside the collection as '<stem>_0000.vtu', ...
    """
    path = require_path("path", path, ".pvd")
    check_names(fields)
    if not isinstance(sources, Mapping | Sequence) or isinstance(sources, str | bytes):
        raise TypeError(f"sources={sources!r}: a sequence or mapping of results is needed")
    if not sources:
        raise ValueError(f"sources={sources!r}: at least one result is needed")
    steps = dict(sources) if isinstance(sources, Mapping) else dict(enumerate(sources))
    for time, source in steps.items():
        require_number("times in sources", time)
        fields_of(source, f"sources[{time!r}]")
    written = {
        time: _write(source, path.with_name(f"{path.stem}_{number:04d}.vtu"), fields)
        for number, (time, source) in enumerate(steps.items())
    }
    return _collect(path, written, fields_of(source).problem.processes)


def _write(source: object, path: Path, fields: Sequence[str]) -> list[Path]:
    """Write the fields, each process those of its part; the paths of all parts."""
    processes, parts = fields_of(source).problem.processes, [path]
    if processes.size > 1:
        parts = [path.with_name(f"{path.stem}_{r:04d}.vtu") for r in range(processes.size)]
    processes.together(partial(_write_part, source, parts[processes.rank], fields))
    return parts


def _write_part(source: object, path: Path, fields: Sequence[str]) -> None:
    """Write the fields on the mesh of this process."""
    mesh = fields_of(source).problem.mesh
    coefficients = [in_space(field_of(source, name)) for name in fields]
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        stem = Path(folder) / "out"
        VTKOutput(mesh, coefs=coefficients, names=list(fields), filename=str(stem)).Do()
        written = stem.with_suffix(".vtu")
        if not written.is_file():
            raise OSError(f"{path}: NGSolve wrote no file")
        written.replace(path)


def _collect(path: Path, written: Mapping[float, Sequence[Path]], processes: Team) -> Path:
    """Write a PVD file that lists the parts of each time; no process goes on before it is there."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for time, parts in written.items():
        for number, part in enumerate(parts):
            place = {"timestep": repr(float(time)), "part": str(number), "file": part.name}
            ElementTree.SubElement(collection, "DataSet", place)
    if processes.rank == 0:
        write_text(path, f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}')
    processes.all(None)
    return path


def in_space(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A scalar as it is, a vector with 3 and a matrix with 9 components, filled up with zeros."""
    if coefficient.dim == 1:
        return coefficient
    n, rank = coefficient.dims[0], len(coefficient.dims)
    return CF(tuple(coefficient[i] if max(i) < n else 0.0 for i in product(range(3), repeat=rank)))


def check_names(fields: object) -> None:
    """Refuse anything but a sequence of at least one name of a field."""
    texts = isinstance(fields, Sequence) and not isinstance(fields, str | bytes)
    if not texts or not all(isinstance(name, str) for name in fields):
        raise TypeError(f"fields={fields!r}: a sequence of names of fields is needed")
    if not fields or not set(fields) <= set(KINDS):
        raise ValueError(f"fields={fields!r}: at least one, of {', '.join(KINDS)}, is needed")
