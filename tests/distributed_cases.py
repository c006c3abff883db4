"""Problems that one process and several processes solve: run by mpiexec, imported by a test.

As a script it prints what process 0 found as JSON, after all processes have found the same.
"""

import dataclasses
import json

import numpy as np
from ngepc.geometries import block, lshape, wrench
from ngsolve import CF, Integrate, log, x

from ngepc import (
    Balanced,
    Coupled,
    Fractional,
    Krylov,
    NewtonOptions,
    NodalContact,
    PathOptions,
    PenaltyContact,
    PointwisePlasticStrain,
    cold_start,
    duality_report,
    evolve,
    export_vtu,
    follow_path,
    lshape_problem,
    primal_newton,
    semismooth_newton,
    solve_automatically,
    wrench_problem,
)
from ngepc.dual.friction import pressed_block_problem


def example_a(on):
    return lshape_problem(on(lambda: lshape.paper_mesh(225)))


def example_b(on):
    return wrench_problem(on(lambda: wrench.paper_mesh(437)))


def quadrilaterals(on):
    """With a roller, a load in the body, a gap and a yield stress that vary."""
    mesh = on(lambda: block.structured_mesh(6, 5))
    problem = pressed_block_problem(mesh, None)
    material = dataclasses.replace(problem.material, yield_stress=10.0 + 5 * x)
    prescribed = {"clamped": (None, 0.0), "left": (0.005, None)}
    changed = {"gap": -0.02 + 0.01 * x, "body_force": (3.0 * x, CF(-2.0)), "material": material}
    return dataclasses.replace(problem, clamped=None, prescribed=prescribed, **changed)


def friction(on):
    return pressed_block_problem(on(lambda: block.mesh(0.2, (1.0, 1.0))))


def tetrahedra(on):
    return pressed_block_problem(on(lambda: block.structured_mesh(3, 3, 3, simplices=True)), None)


SOLVED = {
    "a, coupled": (example_a, Coupled(1e3)),
    "a, penalty contact": (example_a, Balanced(1e9, contact=PenaltyContact())),
    "a, exact contact": (example_a, Balanced()),
    "a, nodal contact": (example_a, Balanced(contact=NodalContact())),
    "b, coupled": (example_b, Coupled(1e3)),
    "b, penalty contact": (example_b, Balanced(contact=PenaltyContact())),
    "b, exact contact": (example_b, Balanced()),
    "quadrilaterals": (quadrilaterals, Balanced()),
    "friction": (friction, Balanced()),
    "tetrahedra": (tetrahedra, Balanced(1e8)),
    "pointwise": (example_a, Balanced(plastic_strain=PointwisePlasticStrain())),
}


def numbers(result):
    """What one process and several must agree about."""
    plastic = Integrate(result.equivalent_plastic_strain, result.problem.mesh)
    scalars = (result.dual_energy, result.primal_energy, result.contact_force, plastic)
    forces = (result.applied_force, result.contact_resultant, result.reaction)
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "residuals": result.history.residual_norms,
        "values": [*map(float, scalars), *np.concatenate(forces).tolist()],
    }


def solved(on):
    """Case -> its numbers; ``on`` makes the mesh that a function returns, distributed or not."""
    return {
        name: numbers(semismooth_newton(make(on), regularisation=regularisation))
        for name, (make, regularisation) in SOLVED.items()
    }


def more(on):
    """Numbers of a start, a path, a load history and the duality gap on Example (a)."""
    problem = example_a(on)
    first = semismooth_newton(problem, 1e2)
    second = semismooth_newton(problem, 1e3, first)
    path = follow_path(problem, PathOptions(gamma_end=700.0))
    steps = [(1.0, {"gap": 0.2}), (2.0, {"gap": 0.05})]
    history = evolve(problem, steps, cold_start(semismooth_newton))
    report = duality_report(semismooth_newton(problem)).as_dict()
    names = ("primal_energy", "dissipation", "max_plastic_strain", "contact_force")
    return {
        "iterations": [second.iterations, sum(s.iterations for s in path.steps)],
        "path": path.steps[-1].path_value,
        "history": [history.column(name) for name in names],
        "duality": [report[name] for name in ("gap", "plastic_penalty", "overshoot", "shear")],
    }


def outcome(work):
    try:
        work()
    except ValueError as error:
        return str(error)
    return "accepted"


def refused(on):
    """What a distributed mesh does not allow, and what each mesh must refuse: the messages."""
    problem = example_a(on)
    result = semismooth_newton(problem)
    krylov = NewtonOptions(inverse=Krylov())
    fractional = Coupled(1e2, tichonov=Fractional())
    other = example_a(on)
    return {
        "primal": outcome(lambda: primal_newton(problem)),
        "automatic": outcome(lambda: solve_automatically(problem)),
        "inverse": outcome(lambda: semismooth_newton(problem, options=krylov)),
        "tichonov": outcome(lambda: semismooth_newton(problem, regularisation=fractional)),
        "start": outcome(lambda: semismooth_newton(other, start=result)),
        "checkpoint": outcome(lambda: follow_path(problem, checkpoint="path.npz")),
        "source": outcome(lambda: export_vtu(result, "fields.vtu")),
    }


def illegal(on):
    """What every mesh must refuse, with the same words."""
    problem = example_a(on)
    bad = log(0.3 - x)
    changes = (
        {"clamped": "clampd"},
        {"clamped": None},
        {"body_force": (bad, 0.0)},
        {"gap": bad},
        {"prescribed": {"free": (0.1, None)}},
    )
    return [outcome(lambda c=c: dataclasses.replace(problem, **c)) for c in changes]


def main():
    from mpi4py import MPI
    from netgen.meshing import Mesh as NetgenMesh
    from ngsolve import Mesh, SetNumThreads

    world = MPI.COMM_WORLD
    SetNumThreads(1)

    def on(make):
        whole = make().ngmesh if world.rank == 0 else None
        return Mesh(whole.Distribute(world) if world.rank == 0 else NetgenMesh.Receive(world))

    found = {f.__name__: f(on) for f in (solved, more, refused, illegal)}
    everywhere = world.allgather(json.dumps(found))
    if world.rank == 0:
        print(json.dumps({"agree": len(set(everywhere)) == 1, **found}), flush=True)


if __name__ == "__main__":
    main()
