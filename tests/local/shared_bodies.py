"""What the processes of ``mpiexec -n P python -m mpi4py shared_bodies.py FOLDER`` find.

Process 0 prints it as JSON; the tests compare it with what one process finds.
"""

import json
import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

from mpi4py import MPI
from ngsolve import Mesh, x

from ngepc import (
    Coulomb,
    NewtonOptions,
    PETSc,
    Problem,
    PyAMG,
    evolve,
    lshape_problem,
    parts,
    semismooth_newton,
)
from ngepc.geometries import block, lshape
from ngepc.local.indicators import error_indicators
from ngepc.pictures.export import export_vtu
from ngepc.primal.solver import primal_newton
from ngepc.studies.large import pressed

OPTIONS = NewtonOptions(inverse=PETSc(), tolerance=1e-9)


def shared(mesh, comm, refinements):
    part = parts.distribute(mesh if comm.rank == 0 else None, comm)
    for _ in range(refinements):
        part = part.refined()
    return part


def standing(mesh):
    """The block on elastic foundations, one across and one in all components."""
    springs = {"clamped": 2e3, "left": (10.0, 20.0, 30.0)}
    return replace(pressed(mesh, 100.0), clamped=None, springs=springs)


def bodies(comm):
    """A sphere on a block, clamped, on springs or rough; the L-shape with traction and a ceiling.

    The fine block has several levels, which each tangent fills anew.  Contact rows of order two
    reach across the border of two parts.
    """
    yield "block", pressed(shared(block.mesh(maxh=0.4), comm, 1), 100.0)
    yield "fine block", pressed(shared(block.mesh(maxh=0.4), comm, 2), 100.0)
    yield "springs", standing(shared(block.mesh(maxh=0.4), comm, 1))
    rough = pressed(shared(block.mesh(maxh=0.4), comm, 1), 100.0)
    yield "Tresca", replace(rough, friction=1.0 + x)
    yield "Coulomb", replace(rough, friction=Coulomb(0.3))
    quadratic = replace(rough, order=2)
    yield "quadratic", quadratic
    yield "quadratic Coulomb", replace(quadratic, friction=Coulomb(0.3))
    plane = lshape_problem(lshape.mesh(maxh=0.15))
    part = shared(plane.mesh, comm, 1)
    loaded = {"kinematics": "plane strain", "body_force": (0.3, 0.2)}
    flat = replace(lshape_problem(part), **loaded)
    yield "lshape", flat
    yield "quadratic lshape", replace(flat, order=2)


def numbers(result):
    """Numbers of a result that do not depend on who has what."""
    processes, own = result.problem.processes, error_indicators(result).vec.FV().NumPy()
    return {
        "status": result.status.label,
        "steps": result.iterations,
        "energies": result.history.energies,
        "iterations": result.history.column("linear_iterations"),
        "plastic": result.history.records[-1].plastic_active,
        "contact force": result.contact_force,
        "slipping": result.history.records[-1].friction_active,
        "contact area": result.contact_area,
        "pressure": processes.maximum(result.contact_pressure.vec.FV().NumPy()),
        "penetration": result.penetration,
        "facets": result.contact_facets,
        "message": result.message,
        "strain": result.largest_strain,
        "reactions": {k: v.tolist() for k, v in result.equilibrium.reactions.items()},
        "moment": result.equilibrium.moment(result.equilibrium.applied).tolist(),
        "error": processes.total(float(own.sum())),
        "nodes": processes.node_count,
        "own": processes.all(result.problem.mesh.nv),
    }


def refusals(problem):
    """What several processes refuse, with the words of the last one."""
    options = NewtonOptions(inverse=PETSc())
    works = {
        "direct": lambda: semismooth_newton(
            problem, options=NewtonOptions(inverse="sparsecholesky")
        ),
        "pyamg": lambda: semismooth_newton(
            problem, options=replace(options, inverse=PyAMG())
        ),
        "gamma": lambda: semismooth_newton(problem, gamma=1.0),
        "primal": lambda: primal_newton(problem),
        "loose": lambda: replace(problem, clamped=None),
        "name": lambda: replace(problem, clamped="nowhere"),
    }
    return {name: said(work) for name, work in works.items()}


def faults(comm):
    """What one of two processes cannot see: a vertex held twice where they meet, a flat element."""
    material = lshape_problem(lshape.mesh(maxh=0.5)).material
    flat = block.structured_mesh(4, 1, simplices=True)
    for point in flat.ngmesh.Points():
        if tuple(point.p)[:2] == (0.0, 0.0):
            point[0], point[1] = 0.125, 0.5  # on the diagonal of the cell
    apart = shared(block.structured_mesh(1, 1, simplices=True), comm, 0)
    supports = {"contact": (0.0, 0.1), "left": (0.0, 0.0)}
    works = {
        "held twice": lambda: Problem(apart, material, None, prescribed=supports),
        "flat": lambda: Problem(shared(Mesh(flat.ngmesh), comm, 0), material),
    }
    return {name: comm.allgather(said(work)) for name, work in works.items()}


def history(problem, folder):
    """Pressed in and pulled back; stopped after two steps, and taken up from the files."""
    steps = [(1.0, {"gap": 0.1}), (2.0, {"gap": 0.08}), (3.0, {"gap": 0.2})]
    solver = partial(semismooth_newton, options=OPTIONS)
    seen = []

    def stop(step):
        seen.append(step.record.time)
        if len(seen) == 2:
            raise StopIteration
        if problem.processes.size > 1 and problem.processes.rank == 0:
            shutil.copy(folder / "history_0000.npz", folder / "first.npz")

    kept = evolve(
        problem, steps, solver, checkpoint=folder / "history.npz", monitor=stop
    )
    own = folder / "history_0000.npz"
    if (
        problem.processes.size > 1 and problem.processes.rank == 0
    ):  # it died before its last file
        shutil.move(folder / "first.npz", own)
    run = evolve(problem, steps, solver, checkpoint=folder / "history.npz")
    return {
        "stopped": kept.status.label,
        "rows": run.as_rows(),
        "status": run.status.label,
    }


def said(work):
    try:
        work()
    except (ImportError, TypeError, ValueError) as error:
        return str(error)
    return ""


def softer(result):
    """A tenth of the hardening, from the state in contact: its first tangent has closed rows."""
    problem = pressed(result.problem.mesh, 10.0)
    return semismooth_newton(problem, start=result, options=OPTIONS)


def found(comm, folder):
    """All that the tests look at."""
    results = {}
    for name, problem in bodies(comm):
        result = semismooth_newton(problem, options=OPTIONS)
        results[name] = numbers(result)
        if name == "fine block":
            results["softer"] = numbers(softer(result))
        results[name]["file"] = str(export_vtu(result, Path(folder) / f"{name}.vtu"))
        if comm.size > 1:
            results[name]["refusals"] = problem.processes.all(refusals(problem))
    results["history"] = history(problem, Path(folder))
    if comm.size == 2:
        results["faults"] = faults(comm)
    return results


if __name__ == "__main__":
    told = found(MPI.COMM_WORLD, sys.argv[1])
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(told))
