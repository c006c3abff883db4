"""Kinematics against closed forms: slabs, cylinders, spheres, patches, Hill, NAFEMS, Prandtl."""

import dataclasses
import math

import numpy as np
import pytest
from bodies import STEEL, curved
from closed_forms import Sphere
from ngsolve import CF, Integrate, Norm, x, y, z
from ngsolve.meshes import MakeStructured2DMesh

from ngepc import (
    Material,
    NewtonOptions,
    Problem,
    Status,
    outward_normal,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block, punch, ring
from ngepc.model.tensile import lame_parameters

both_methods = pytest.mark.parametrize("method", [semismooth_newton, primal_newton])
both_orders = pytest.mark.parametrize("order", [1, 2])


def solved(method, problem):
    """The result for a tolerance of 1e-12, or what rounding allows."""
    options = (
        {"options": NewtonOptions(tolerance=1e-12)}
        if method is semismooth_newton
        else {}
    )
    result = method(problem, **options)
    assert result.residual_norm < max(1e-10, 2 * result.residual_rounding)
    return result


def tube(inner, outer, radial, axial=1, height=1.0, simplices=False):
    """The section inner < r < outer, 0 < z < height of a tube; sides left, right, bottom, top."""
    mesh = MakeStructured2DMesh(
        quads=not simplices,
        nx=radial,
        ny=axial,
        mapping=lambda s, t: (inner + (outer - inner) * s, height * t),
    )
    return mesh


# Plane strain


@both_methods
@both_orders
def test_plane_strain_is_a_slab_between_smooth_walls(method, order):
    """A slab of hexahedra with u_y = 0 on both faces, x-z in 3D being x-y in 2D."""
    gap = 3e-4 + 2e-3 * (x - 0.3) ** 2
    shared = {"material": STEEL, "contact": "contact", "gap": gap, "order": order}
    plane = Problem(
        block.structured_mesh(4, 3),
        traction={"right": (2.0, 1.5)},
        kinematics="plane strain",
        **shared,
    )
    slab = Problem(
        block.structured_mesh(4, 1, 3, size=(1.0, 0.5, 1.0)),
        traction={"right": (2.0, 0.0, 1.5)},
        prescribed={"front|back": (None, 0, None)},
        **shared,
    )
    flat, thick = solved(method, plane), solved(method, slab)
    assert flat.contact_force > 0.01
    assert thick.contact_force == pytest.approx(0.5 * flat.contact_force, rel=1e-9)
    for a, b in ((0.2, 0.7), (0.9, 1.0), (1.0, 0.3), (0.55, 0.5)):
        here, there = plane.mesh(a, b), slab.mesh(a, 0.2, b)
        u, v = flat.displacement(here), thick.displacement(there)
        assert u == pytest.approx((v[0], v[2]), rel=1e-9)
        p = np.reshape(flat.plastic_strain(here), (3, 3))[np.ix_([0, 2, 1], [0, 2, 1])]
        assert np.reshape(thick.plastic_strain(there), (3, 3)) == pytest.approx(
            p, abs=1e-12
        )
        assert flat.von_mises(here) == pytest.approx(thick.von_mises(there), rel=1e-9)


# Axisymmetric bodies


@both_methods
@both_orders
@pytest.mark.parametrize("simplices", [True, False])
@pytest.mark.parametrize("pressure", [1.0, 4.0])
def test_solid_cylinder_under_lateral_pressure(method, order, simplices, pressure):
    """sigma = diag(-P, 0, -P) on (r, z, hoop) with the axis at r = 0: homogeneous, also plastic."""
    mesh = block.structured_mesh(3, 2, simplices=simplices)
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        traction={"right": (-pressure, 0.0)},
        prescribed={"clamped": (None, 0)},
        kinematics="axisymmetric",
        order=order,
    )
    result = solved(method, problem)
    deviator = -pressure * np.array([1, -2, 1]) / 3  # (r, z, hoop)
    size = np.linalg.norm(deviator)
    p = max(size - 1.25, 0.0) / 100.0 * deviator / size
    mean = -2 * pressure / 3 / (3 * 1e3 + 2e3)
    radial, axial, _ = mean + deviator / 2e3 + p
    for r, height in ((0.0, 0.5), (0.1, 0.2), (1.0, 1.0), (0.6, 0.9)):
        expected = (radial * r, axial * height)
        assert result.displacement(mesh(r, height)) == pytest.approx(
            expected, rel=1e-10, abs=1e-16
        )
    stress = np.reshape(result.stress(mesh(0.45, 0.55)), (3, 3))
    assert stress == pytest.approx(np.diag([-pressure, 0.0, -pressure]), abs=1e-10)


@both_methods
def test_forces_are_those_of_the_whole_ring(method):
    """A tube pressed by a flat obstacle: force = stress times pi (b^2 - a^2)."""
    mesh = tube(1.0, 2.0, 3)
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        prescribed={"bottom": (None, 0)},
        contact="top",
        gap=-5e-4,
        kinematics="axisymmetric",
    )
    result = solved(method, problem)
    young = 1e3 * (3e3 + 2e3) / 2e3
    area = math.pi * (4 - 1)
    assert result.contact_force == pytest.approx(young * 5e-4 * area, rel=1e-10)
    assert result.contact_area == pytest.approx(area)
    assert result.reaction[1] == pytest.approx(result.contact_force, rel=1e-10)


def lame_cylinder(r, pressure, a=1.0, b=2.0, lame_lambda=1e3, mu=1e3):
    """u_r of the elastic tube under internal pressure in plane strain."""
    scale = pressure * a**2 / (b**2 - a**2)
    return scale * (r / (2 * (lame_lambda + mu)) + b**2 / (2 * mu * r))


@both_methods
def test_elastic_tube_is_lames(method):
    """Sections through the axis and across it, order two: both close to the closed form."""
    section = Problem(
        tube(1.0, 2.0, 16),
        STEEL,
        clamped=None,
        traction={"left": (0.3, 0.0)},
        prescribed={"bottom|top": (None, 0)},
        kinematics="axisymmetric",
        order=2,
    )
    result = solved(method, section)
    for r in (1.0, 1.5, 2.0):
        found = result.displacement(section.mesh(r, 0.5))[0]
        assert found == pytest.approx(lame_cylinder(r, 0.3), rel=1e-5)


def quarter_tube(maxh, pressure, material, order=2):
    """A quarter of the cross-section, in plane strain, with round edges."""
    mesh = curved(ring.quarter_mesh(maxh))
    return Problem(
        mesh,
        material,
        clamped=None,
        traction={"inner": -pressure * outward_normal(mesh)},
        prescribed={"left": (0, None), "bottom": (None, 0)},
        kinematics="plane strain",
        order=order,
    )


@pytest.mark.parametrize("pressure", [0.3, 1.2])
def test_cross_section_and_section_of_a_tube_agree(pressure):
    """The elastoplastic tube in plane strain and as a body of revolution: the same radial u."""
    across = semismooth_newton(quarter_tube(0.15, pressure, STEEL)).raise_for_status()
    section = Problem(
        tube(1.0, 2.0, 48),
        STEEL,
        clamped=None,
        traction={"left": (pressure, 0.0)},
        prescribed={"bottom|top": (None, 0)},
        kinematics="axisymmetric",
        order=2,
    )
    along = semismooth_newton(section).raise_for_status()
    assert (along.history.records[-1].plastic_active > 0) == (pressure > 1)
    for r in (1.0, 1.5, 2.0):
        found = across.displacement(across.problem.mesh(r, 0.0))[0]
        assert found == pytest.approx(
            along.displacement(section.mesh(r, 0.5))[0], rel=2e-3
        )


SPHERE = Sphere(1e3, 1e3, 1.25, 100.0)


@both_methods
@pytest.mark.parametrize("radius", [1.0, 1.4, 1.8])
def test_thick_sphere(method, radius):
    """A shell that yields up to ``radius``, as a quarter of its meridian section, order two."""
    mesh = curved(ring.quarter_mesh(0.15))
    pressure = SPHERE.pressure(radius)
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        traction={"inner": -pressure * outward_normal(mesh)},
        prescribed={"left": (0, None), "bottom": (None, 0)},
        kinematics="axisymmetric",
        order=2,
    )
    result = solved(method, problem)
    for r in (1.0, 2.0):
        expected = SPHERE.end_displacement(radius, r)
        assert result.displacement(mesh(r, 0.0))[0] == pytest.approx(expected, rel=3e-3)
        assert result.displacement(mesh(0.0, r))[1] == pytest.approx(expected, rel=3e-3)
    shell = 2 * math.pi / 3 * (radius**3 - 1)  # half of it
    assert result.history.records[-1].plastic_active == pytest.approx(
        shell, rel=0.05, abs=1e-3
    )


# Published numbers


HILL = Material.kinematic(
    lame_lambda=lame_parameters(210.0, 0.3)[0],
    lame_mu=lame_parameters(210.0, 0.3)[1],
    yield_stress=math.sqrt(2 / 3) * 0.24,
    hardening=1e-3,
)


def hill_pressure(c, a=100.0, b=200.0, sigma=0.24):
    """The pressure with plastic radius c, Hill (1950)."""
    return sigma / math.sqrt(3) * (2 * math.log(c / a) + 1 - c**2 / b**2)


@pytest.mark.parametrize("c", [120.0, 150.0, 180.0])
def test_hills_cylinder_with_little_hardening(c):
    """h = 1e-3 GPa = mu/8e4: the plastic zone reaches to c, stresses are those of Hill."""
    section = Problem(
        tube(100.0, 200.0, 60, height=10.0),
        HILL,
        clamped=None,
        traction={"left": (hill_pressure(c), 0.0)},
        prescribed={"bottom|top": (None, 0)},
        kinematics="axisymmetric",
        order=2,
    )
    result = semismooth_newton(section).raise_for_status()
    area = result.history.records[-1].plastic_active / (10.0 * math.pi)
    assert math.sqrt(100.0**2 + area) == pytest.approx(c, rel=0.02)


def test_hills_limit_pressure():
    """Beyond 0.19209 GPa only the hardening holds the tube: displacements grow like 1/h."""
    ends = []
    for hardening in (1e-2, 1e-3):
        section = Problem(
            tube(100.0, 200.0, 20, height=10.0),
            dataclasses.replace(HILL, hardening=hardening),
            clamped=None,
            traction={"left": (1.02 * 0.19209, 0.0)},
            prescribed={"bottom|top": (None, 0)},
            kinematics="axisymmetric",
            order=2,
        )
        result = semismooth_newton(section, options=NewtonOptions(tolerance=1e-8))
        assert result.status is Status.CONVERGED
        ends.append(result.displacement(section.mesh(100.0, 5.0))[0])
    assert ends[1] == pytest.approx(10 * ends[0], rel=0.1)


def mean_pressure(order):
    """Mean pressure / k of a rigid rough punch of width 1 pushed deep, k the shear yield stress."""
    material = Material.kinematic(
        lame_lambda=4000.0, lame_mu=1000.0, yield_stress=math.sqrt(2), hardening=0.1
    )
    problem = Problem(
        punch.mesh(maxh=0.8, fine=0.1),
        material,
        prescribed={"contact": (0, -0.02)},
        kinematics="plane strain",
        order=order,
    )
    result = semismooth_newton(
        problem, options=NewtonOptions(tolerance=1e-7)
    ).raise_for_status()
    return -result.equilibrium.reactions["contact"][1]


def test_linear_triangles_lock_under_prandtls_punch():
    """The mean pressure is (2 + pi) k: far above it for order one, near it for order two."""
    locked, free = (mean_pressure(order) / (2 + math.pi) for order in (1, 2))
    assert locked > 1.4
    assert 0.98 < free < 1.15


# Patch tests


@both_methods
@pytest.mark.parametrize("shape", ["plane", "solid"])
def test_linear_displacements_on_curved_elements_of_order_two(method, shape):
    """u = A x on the boundary: constant strain and plastic strain everywhere."""
    if shape == "plane":
        mesh, kinematics = curved(ring.quarter_mesh(0.6)), "plane strain"
        A = 1e-3 * np.array([[1.0, 0.4], [0.2, -1.5]])
        u = CF(tuple(float(row[0]) * x + float(row[1]) * y for row in A))
    else:
        mesh, kinematics = curved(ring.shell_octant_mesh(1.0)), "solid"
        A = 1e-3 * np.array([[1.0, 0.4, 0.0], [0.2, -1.5, 0.3], [0.0, 0.1, 0.8]])
        u = CF(
            tuple(
                sum(float(a) * c for a, c in zip(row, (x, y, z), strict=True))
                for row in A
            )
        )
    sides = "|".join(set(mesh.GetBoundaries()))
    values = tuple(u[i] for i in range(mesh.dim))
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        prescribed={sides: values},
        kinematics=kinematics,
        order=2,
    )
    result = solved(method, problem)
    error = Integrate(Norm(result.displacement - u), mesh) / Integrate(Norm(u), mesh)
    assert error < 1e-11
    p = result.plastic_increment
    mean = [Integrate(p[i], mesh) / Integrate(CF(1), mesh) for i in range(p.dim)]
    assert np.linalg.norm(mean) > 1e-4
    assert Integrate(Norm(p - CF(tuple(mean))), mesh) < 1e-11
