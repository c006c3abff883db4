"""The two examples of section 7 as problems on any mesh of their bodies."""

from ngsolve import Mesh

from ngepc.checks.kinds import require_mesh
from ngepc.model.material import Material
from ngepc.model.normals import outward_normal
from ngepc.model.problem import Problem


def lshape_problem(mesh: Mesh) -> Problem:
    """Example (a): L-shape, kinematic hardening, pressure 10 from below, gap 0.1 at the top.

    Parameters
    ----------
    mesh
        A mesh of ``ngepc.geometries.lshape``; TypeError or ValueError for others.
    """
    metal = {"lame_lambda": 1.0e3, "lame_mu": 1.0e3, "yield_stress": 1.25, "hardening": 100.0}
    return _paper_problem(mesh, Material.kinematic(**metal), 10.0, 0.1)


def wrench_problem(mesh: Mesh) -> Problem:
    """Example (b): screw wrench, isotropic hardening, pressure 6e-3 on the handle, gap 1.

    Parameters
    ----------
    mesh
        A mesh of ``ngepc.geometries.wrench``; TypeError or ValueError for others.
    """
    material = Material.isotropic(
        lame_lambda=1.15e1,
        lame_mu=7.69,
        yield_stress=0.2,
        hardening_modulus=1.0e-3,
        hardening_stiffness=1.0e7,
    )
    return _paper_problem(mesh, material, 6.0e-3, 1.0)


def _paper_problem(mesh: Mesh, material: Material, pressure: float, gap: float) -> Problem:
    """A body of section 7, with the 2 x 2 tensors and the elements of order one of the paper."""
    require_mesh("mesh", mesh, (2,))
    load = {"load": -pressure * outward_normal(mesh)}
    flat = {"kinematics": "two-dimensional", "order": 1}
    return Problem(mesh, material, "clamped", load, contact="contact", gap=gap, **flat)
