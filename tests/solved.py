"""Small solved problems that several test files look at, each solved once."""

from functools import cache

from netgen.occ import Box, Compound, OCCGeometry, Pnt, Z
from ngsolve import CF, Mesh

from ngepc import Contact, Material, Problem, lshape_problem, semismooth_newton
from ngepc.geometries import block, lshape
from ngepc.primal.solver import primal_newton


@cache
def lshape_dual(nodes: int = 417, gamma: float = 1e3):
    """Example (a) by the dual method."""
    return semismooth_newton(lshape_problem(lshape.paper_mesh(nodes)), gamma)


@cache
def lshape_primal(nodes: int = 417):
    """Example (a) by the primal method, with a plastic zone."""
    return primal_newton(lshape_problem(lshape.paper_mesh(nodes)))


@cache
def block_primal():
    """A coarse block that yields under shear and touches a flat obstacle."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
    )
    problem = Problem(
        block.mesh(maxh=0.5),
        material,
        traction={"right": CF((0.0, 0.0, -4.0)), "left": CF((0.0, 0.0, 4.0))},
        contact="contact",
        gap=0.001,
        order=1,
    )
    return primal_newton(problem)


@cache
def two_blocks():
    """A block on another one, pressed by 0.5: bodies that share no nodes."""
    lower = Box(Pnt(0, 0, 0), Pnt(1, 1, 1)).mat("lower")
    upper = Box(Pnt(0, 0, 1), Pnt(1, 1, 2)).mat("upper")
    lower.faces.name = "side"
    upper.faces.name = "side"
    lower.faces.Max(Z).name = "under"
    lower.faces.Min(Z).name = "floor"
    upper.faces.Min(Z).name = "over"
    upper.faces.Max(Z).name = "top"
    mesh = Mesh(OCCGeometry(Compound([lower, upper])).GenerateMesh(maxh=0.6))
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
    )
    problem = Problem(
        mesh,
        steel,
        "floor",
        pressure={"top": 0.5},
        contact=Contact("over", "under"),
        prescribed={"side": (0.0, 0.0, None)},
        order=1,
    )
    return semismooth_newton(problem)
