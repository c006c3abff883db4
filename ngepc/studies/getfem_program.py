"""A case of the study ``accuracy`` by GetFEM: a program of its own, for a Python that has it.

``python getfem_program.py DATA.npz ANSWER.json INCREMENTS LINE_SEARCH`` solves a body without
contact: quadratic simplices, isotropic linear hardening, the displacement as the only unknown.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

try:
    import getfem
except ImportError:  # the study says so
    getfem = None

GEOMETRY = {2: "GT_PK(2,1)", 3: "GT_PK(3,1)"}
ELEMENT = {2: "FEM_PK(2,2)", 3: "FEM_PK(3,2)"}
RULE = {2: "IM_TRIANGLE(2)", 3: "IM_TETRAHEDRON(2)"}
LAW = {
    2: "plane strain Prandtl Reuss linear hardening",
    3: "Prandtl Reuss linear hardening",
}
NAMES = (
    *("u", "xi", "Previous_Ep", "Previous_alpha"),
    *("clambda", "cmu", "sigma_y", "H_k", "H_i"),
)
PENALTY = 1e4
"""Stiffness of supports over Young's modulus; GetFEM's residual is relative to their forces."""

TOLERANCE = 1e-11

MOST = 100
"""Largest number of Newton steps of an increment."""

STRESS = "(clambda*Trace(Sym(Grad_u))*Id(meshdim)+2*cmu*(Sym(Grad_u)-Previous_Ep)):Grad_asked"


def regions(mesh: object, middles: np.ndarray, numbers: np.ndarray) -> None:
    """Give the faces of the boundary the numbers of the facets with these middles."""
    points = mesh.pts()
    of_place = {
        tuple(np.round(middle, 9)): int(number)
        for middle, number in zip(middles, numbers, strict=True)
    }
    found: dict[int, list] = {}
    for face in mesh.outer_faces().T:
        corners = mesh.pid_in_faces(face[:, None])
        middle = points[:, np.ravel(corners)].mean(axis=1)
        found.setdefault(of_place[tuple(np.round(middle, 9))], []).append(face)
    for number, faces in found.items():
        mesh.set_region(number + 1, np.array(faces).T)


def elastoplastic_model(data: Mapping, mesh: object) -> tuple[object, object, object]:
    """The model without loads, the functions of displacements, and the integration."""
    N = mesh.dim()
    functions = getfem.MeshFem(mesh, N)
    functions.set_fem(getfem.Fem(ELEMENT[N]))
    rule = getfem.MeshIm(mesh, getfem.Integ(RULE[N]))
    model = getfem.Model("real")
    model.set_time_step(1.0)
    model.add_fem_variable("u", functions)
    model.add_fem_data("Previous_u", functions)
    scalars = getfem.MeshImData(rule)
    for name in ("xi", "Previous_xi", "Previous_alpha"):
        model.add_im_data(name, scalars)
    model.add_im_data("Previous_Ep", getfem.MeshImData(rule, -1, [N, N]))
    young, poisson, stress, modulus = data["metal"]
    mu = young / (2 * (1 + poisson))
    known = {
        "clambda": young * poisson / ((1 + poisson) * (1 - 2 * poisson)),
        "cmu": mu,
        "sigma_y": stress,
        "H_k": 0.0,
        "H_i": modulus,
    }
    for name, value in known.items():
        model.add_initialized_data(name, [value])
    how = (rule, LAW[N], "displacement only", *NAMES)
    model.add_small_strain_elastoplasticity_brick(*how)
    return model, functions, how


def solved_case(data: Mapping, increments: int, search: str) -> dict:
    """The number that is asked for, the Newton steps, and the processor time without the mesh."""
    corners = data["points"][data["elements"]]
    N = corners.shape[2]
    mesh = getfem.Mesh("empty", N)
    mesh.add_convex(getfem.GeoTrans(GEOMETRY[N]), corners.transpose(2, 1, 0))
    regions(mesh, data["middles"], data["numbers"])
    begin = time.process_time()
    model, functions, how = elastoplastic_model(data, mesh)
    loads = {}
    for number, (fixed, values) in enumerate(
        zip(data["fixed"], data["values"], strict=True)
    ):
        loads[f"moved{number}"] = values
        model.add_initialized_data(f"moved{number}", np.zeros(N))
        model.add_initialized_data(f"fixed{number}", np.diag(fixed).ravel(), [N, N])
        for region in data["held"][number]:
            if region >= 0:
                names = f"moved{number}", f"fixed{number}"
                stiffness = PENALTY * data["metal"][0]
                model.add_generalized_Dirichlet_condition_with_penalization(
                    how[0], "u", stiffness, int(region) + 1, *names
                )
    if data["loaded"] >= 0:
        loads["traction"] = data["traction"]
        model.add_initialized_data("traction", np.zeros(N))
        region = int(data["loaded"]) + 1
        model.add_source_term_brick(how[0], "u", "traction", region)
    steps = 0
    for k in range(1, increments + 1):
        for name, value in loads.items():
            model.set_variable(name, value * k / increments)
        options = ("max_iter", MOST, "max_res", TOLERANCE, "lsearch", search)
        taken, good = model.solve(*options)
        if not good:
            return {"good": False}
        steps += taken
        model.small_strain_elastoplasticity_next_iter(*how)
    number = asked(data, model, functions, how[0])
    spent = time.process_time() - begin
    return {"good": True, "value": number, "iterations": steps, "cpu": spent}


def asked(data: Mapping, model: object, functions: object, rule: object) -> float:
    """The displacement of a point, or the force on a boundary by the work of the stresses."""
    component = int(data["component"])
    N = functions.mesh().dim()
    if data["asked"] < 0:
        nodes = functions.basic_dof_nodes()[:, component::N]
        away = np.linalg.norm(nodes.T - data["where"], axis=1)
        return float(model.variable("u")[N * away.argmin() + component])
    dofs = functions.basic_dof_on_region(int(data["asked"]) + 1)
    v = np.zeros(functions.nbdof())
    v[dofs[dofs % N == component]] = 1.0
    model.add_initialized_fem_data("asked", functions, v)
    return float(np.ravel(getfem.asm_generic(rule, 0, STRESS, -1, model))[0])


if __name__ == "__main__":
    source, target, pieces, line_search = sys.argv[1:]
    getfem.util_trace_level(0)
    getfem.util_warning_level(0)
    answer = solved_case(dict(np.load(source)), int(pieces), line_search)
    Path(target).write_text(json.dumps(answer), encoding="utf-8")
