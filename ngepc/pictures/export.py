"""VTU files for ParaView, and PVD collections of load histories and of the parts of processes.

NGSolve's VTKOutput says nothing when it cannot write; here the file is checked before its name is
returned.  All fields are point data on each element's own corners, so that jumps stay.  Vectors
have three and tensors nine components, as ParaView expects, also in two dimensions.
"""

import os
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ngsolve import CF, CoefficientFunction, VTKOutput

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance, require_mapping, require_path
from ngepc.model.features import require_covered
from ngepc.pictures.drawable import KINDS, field_of, fields_of
from ngepc.results.records import write_text

FIELDS = ("displacement", "plastic_strain", "equivalent_plastic_strain",
          "accumulated_plastic_strain", "stress", "von_mises", "yield_function")  # fmt: skip


COVERS = frozenset(
    {
        "plane strain",
        "two-dimensional",
        "axisymmetric",
        "solid",
        "other kinematics",
        "order 2",
        "other shapes",
        "curved elements",
        "shared mesh",
        "kinematic hardening",
        "isotropic hardening",
        "hardening law",
        "initial plastic strain",
        "initial hardening",
        "initial strain",
        "obstacle",
        "two bodies",
        "held by contact",
        "friction",
        "Coulomb friction",
        "contact at a clamp",
        "rollers",
        "edges and points",
        "springs",
    }
)
"""Features that VTU files cover."""


def export_vtu(
    source: object | Mapping[float, object],
    path: str | os.PathLike,
    fields: Sequence[str] = FIELDS,
) -> Path:
    """Write the fields of a result to a VTU file, or a load history to one for each step.

    The steps of a history stand beside the PVD file that lists them, as '<stem>_0000.vtu', ...
    Where processes share the mesh each writes its part, '<stem>_0000.vtu', ..., and a PVD file
    lists the parts.

    Parameters
    ----------
    source
        Result of a solver, or ``Fields``; or time -> one of these.
    path
        The file, ending in '.vtu', that of a history in '.pvd'; its folder is made.
    fields
        Names of fields, see ``drawable.KINDS``.

    Returns
    -------
    Path
        What ParaView opens: ``path``, of shared meshes '<stem>.pvd'.

    Raises
    ------
    TypeError, ValueError
        If the source, the path or a field is none.
    OSError
        If NGSolve, which does not say so, wrote no file.
    """
    history = isinstance(source, Mapping)
    steps = source if history else {0: source}
    require_mapping("source", steps, "time -> result")
    for time, state in steps.items():
        require_number("times in source", time)
        fields_of(state, f"source[{time!r}]" if history else "source")
    path = require_path("path", path, ".pvd" if history else ".vtu")
    require_instance(
        "fields", fields, (list, tuple), "a list or tuple of names of fields"
    )
    if not fields or not all(name in [*KINDS] for name in fields):
        raise ValueError(
            f"fields={fields!r}: at least one, of {', '.join(KINDS)}, is needed"
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
        processes.together(partial(_write_part, state, own, fields))
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
    processes.all(None)  # no process goes on before the list is there
    return path


def _write_part(source: object, path: Path, fields: Sequence[str]) -> None:
    """Write the fields on the mesh of this process."""
    coefficients = [in_space(field_of(source, name)) for name in fields]
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        mesh = fields_of(source).problem.mesh
        stem = Path(folder) / "out"
        VTKOutput(mesh, coefs=coefficients, names=list(fields), filename=str(stem)).Do()
        written = stem.with_suffix(".vtu")
        if not written.is_file():
            raise OSError(f"{path}: NGSolve wrote no file")
        written.replace(path)


def in_space(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A scalar as it is, a vector with 3 and a matrix with 9 components, filled up with zeros."""
    if coefficient.dim == 1:
        return coefficient
    n = coefficient.dims[0]
    rank = len(coefficient.dims)
    return CF(
        tuple(
            coefficient[i] if max(i) < n else 0.0
            for i in product(range(3), repeat=rank)
        )
    )
