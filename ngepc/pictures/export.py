"""VTU files for ParaView, and PVD collections of load histories and of the parts of processes.

A file is written atomically.  All fields are point data on each element's own points, so
that jumps stay.  Vectors have three and tensors nine components, as ParaView expects, also in two
dimensions.
"""

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ngsolve import GridFunction

from ngepc._deprecated import old_names
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance, require_mapping, require_path
from ngepc.evolution.result import Evolution
from ngepc.model.features import (
    BASIC_FEATURES,
    CONTACT_FEATURES,
    ELEMENT_FEATURES,
    HISTORY_FEATURES,
    KINEMATICS_FEATURES,
    LAW_FEATURES,
    SUPPORT_FEATURES,
    require_covered,
)
from ngepc.pictures.drawable import KINDS, field_of, fields_of
from ngepc.pictures.sampling import is_curved
from ngepc.pictures.vtu import vtu_text
from ngepc.results.records import write_text

FIELDS = ("displacement", "plastic_strain", "equivalent_plastic_strain",
          "accumulated_plastic_strain", "stress", "von_mises", "yield_function")  # fmt: skip


COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | KINEMATICS_FEATURES
    | ELEMENT_FEATURES
    | LAW_FEATURES
    | CONTACT_FEATURES
    | SUPPORT_FEATURES
    | {"anisotropic yield", "cyclic hardening", "shared mesh"}
)
"""Features that VTU files cover."""


def export_vtu(
    source: object | Mapping[float, object] | Evolution,
    path: str | os.PathLike,
    fields: Sequence[str] | None = None,
) -> Path:
    """Write the fields of a result to a VTU file, or a load history to one for each step.

    The steps of a history stand beside the PVD file that lists them, as '<stem>_0000.vtu', ...
    Elements of order two, and curved ones, are quadratic cells.  The cell data 'body' is the number
    of the material, in the order of ``mesh.GetMaterials()``.  Where processes share the mesh each
    writes its part, '<stem>_0000.vtu', ..., and a PVD file
    lists the parts.

    Parameters
    ----------
    source
        Result of a solver, or ``Fields``; or a history: an ``Evolution``, or time -> one of these.
    path
        The file, ending in '.vtu', that of a history in '.pvd'; its folder is made.
    fields
        Names of fields, see ``drawable.KINDS``, and 'contact_pressure' of the exact methods, whose
        values are right on the contact boundary; None for the usual ones.

    Returns
    -------
    Path
        What ParaView opens: ``path``, of shared meshes '<stem>.pvd'.

    Raises
    ------
    TypeError, ValueError
        If the source, the path or a field is none.
    OSError
        If the file cannot be written; an older one is then as it was.
    """
    if isinstance(source, Evolution):
        source = dict(zip(source.times, source.steps, strict=True))
    history = isinstance(source, Mapping)
    steps = source if history else {0: source}
    require_mapping("source", steps, "time -> result")
    for time, state in steps.items():
        require_number("times in source", time)
        fields_of(state, f"source[{time!r}]" if history else "source")
    path = require_path("path", path, ".pvd" if history else ".vtu")
    wanted = usual_fields(state) if fields is None else fields
    needed = "a list or tuple of names of fields"
    require_instance("fields", wanted, (list, tuple), needed)
    known = [*KINDS, "contact_pressure"]
    if not wanted or not all(name in known for name in wanted):
        raise ValueError(
            f"fields={fields!r}: at least one, of {', '.join(known)}, is needed"
        )
    for state in steps.values():
        require_covered(fields_of(state).problem, "export_vtu", COVERS)
    processes = fields_of(state).problem.processes
    listed = []
    for number, (time, state) in enumerate(steps.items()):
        stem = f"{path.stem}_{number:04d}" if history else path.stem
        parts = [f"{stem}_{rank:04d}.vtu" for rank in range(processes.size)]
        parts = parts if processes.size > 1 else [f"{stem}.vtu"]
        own = path.with_name(parts[processes.rank])
        processes.together(partial(_write_part, state, own, wanted))
        listed += [
            f'<DataSet timestep="{float(time)!r}" part="{rank}" file={quoteattr(part)}/>'
            for rank, part in enumerate(parts)
        ]
    if not history and processes.size == 1:
        return path
    path = path.with_suffix(".pvd")
    text = f"<Collection>{''.join(listed)}</Collection>"
    if processes.rank == 0:
        head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">'
        write_text(path, f"{head}{text}</VTKFile>\n")
    processes.all(None)  # all processes wait until the list is written
    return path


def usual_fields(source: object) -> list[str]:
    """The names of the fields that are written unless others are asked for."""
    pressure = getattr(source, "contact_pressure", None)
    touches = fields_of(source).problem.touching_names
    has = isinstance(pressure, GridFunction) and touches
    return [*FIELDS, *(["contact_pressure"] if has else [])]


def _write_part(source: object, path: Path, names: Sequence[str]) -> None:
    """Write the fields on the mesh of this process."""
    fields = fields_of(source)
    coefficients = {name: field_of(source, name) for name in names}
    mesh = fields.problem.mesh
    write_text(path, vtu_text(mesh, coefficients, is_curved(fields)))


__getattr__ = old_names(__name__)
