"""What does not work on meshes distributed over MPI processes, refused before any work."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ngsolve import Mesh

from ngepc.dual.tichonov import ContactSlobodeckij
from ngepc.linalg.direct import Direct, linear_solver
from ngepc.parallel import is_distributed

if TYPE_CHECKING:
    from ngepc.dual.regularisation import Regularisation
    from ngepc.dual.result import DualResult
    from ngepc.linalg.direct import LinearSolver
    from ngepc.model.problem import Problem


def require_one_process(argument: str, mesh: Mesh, legal: str) -> None:
    """Accept an argument on a mesh of one process; ``legal`` says what others allow.

    Raises
    ------
    ValueError
        If the mesh is distributed.
    """
    if is_distributed(mesh):
        processes = f"a mesh that is distributed over {mesh.comm.size} processes"
        raise ValueError(f"{argument}: not on {processes}; {legal}")


def check_supported(
    problem: Problem,
    regularisation: Regularisation,
    inverse: str | LinearSolver,
    start: DualResult | None,
) -> None:
    """Arguments of the dual method that a distributed mesh allows.

    Raises
    ------
    ValueError
        If an argument is none of them.
    """
    if not is_distributed(problem.mesh):
        return
    mesh, product = problem.mesh, regularisation.tichonov.contact
    if not isinstance(linear_solver(inverse), Direct):
        require_one_process(f"inverse={inverse!r}", mesh, "a direct solver is needed")
    if problem.contact_names and isinstance(product, ContactSlobodeckij):
        legal = "SurfaceGradient() or FullProduct() is needed"
        require_one_process(f"tichonov={regularisation.tichonov!r}", mesh, legal)
    if start is not None and start.problem.mesh is not mesh:
        require_one_process("start on another mesh", mesh, "a result on the same mesh is needed")
