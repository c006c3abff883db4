"""Recovered stresses: no error where they are the true ones, about the right one elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import (
    CF,
    H1,
    Grad,
    GridFunction,
    Id,
    InnerProduct,
    Integrate,
    LinearForm,
    Sym,
    Trace,
    dx,
)
from ngsolve.meshes import MakeStructured3DMesh
from pairs import in_turn

from ngepc import Material, Problem, Tabulated, lshape_problem, semismooth_newton
from ngepc.geometries import block, lshape
from ngepc.local.indicators import error_indicators
from ngepc.studies.large import indented_block


def estimate(result):
    return error_indicators(result).vec.FV().NumPy().sum()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("pull", [0.0005, 0.05])
def test_uniform_stress_has_no_error(pull, order):
    """A bar on rollers, elastic and plastic: linear displacements are the solution."""
    bar, steel = block.structured_mesh(3, 3, simplices=True), indented_block(0).material
    rollers = {"left": (0, None), "clamped": (None, 0), "right": (pull, None)}
    result = semismooth_newton(
        Problem(bar, steel, clamped=None, prescribed=rollers, order=order)
    )
    assert (result.history.records[-1].plastic_active > 0.99) == (pull > 0.01)
    assert estimate(result) < 1e-20 * result.primal_energy


@pytest.mark.parametrize("order", [1, 2])
def test_the_estimate_is_about_the_error(order):
    """Example (a): the energies on 113, 417 nodes against the one on 1601."""
    results = [
        semismooth_newton(replace(lshape_problem(lshape.paper_mesh(n)), order=order))
        for n in (113, 417, 1601)
    ]
    finest = results[-1].primal_energy
    for result in results[:-1]:
        error = result.primal_energy - finest
        assert 0.2 * error < estimate(result) < 2 * error


def test_the_estimate_by_forms():
    """1/2 int (s - sigma) : C^-1 (s - sigma) by NGSolve, s the mean at each vertex."""
    base = lshape_problem(lshape.paper_mesh(113))
    elastic = replace(base, material=replace(base.material, yield_stress=1e6), order=1)
    elastic = replace(elastic, kinematics="plane strain")
    result = semismooth_newton(elastic)
    mesh = elastic.mesh
    lame_lambda = elastic.material.lame_lambda
    mu = elastic.material.lame_mu
    u = result.displacement
    strain = CF((*Sym(Grad(u))[0, :], 0, *Sym(Grad(u))[1, :], 0, 0, 0, 0), dims=(3, 3))
    stress = 2 * mu * strain + lame_lambda * Trace(strain) * Id(3)
    space = H1(mesh, order=1)
    test = space.TestFunction()
    volume = LinearForm(test * dx).Assemble().vec.FV().NumPy()
    components = []
    for i, j in np.ndindex(3, 3):
        mean = GridFunction(space)
        moments = LinearForm(stress[i, j] * test * dx).Assemble().vec.FV().NumPy()
        mean.vec.FV().NumPy()[:] = moments / volume
        components.append(mean)
    rest = CF(tuple(components), dims=(3, 3)) - stress
    soft = lame_lambda / (3 * lame_lambda + 2 * mu)
    answer = (rest - soft * Trace(rest) * Id(3)) / (2 * mu)
    expected = Integrate(InnerProduct(rest, answer) / 2, mesh, order=4)
    assert estimate(result) == pytest.approx(expected, rel=1e-9)


def test_indicators_are_where_the_mesh_is_coarse():
    result = semismooth_newton(indented_block(1))
    indicators = error_indicators(result)
    x = np.asarray(result.problem.mesh.ngmesh.Coordinates())
    top = [
        max(x[v.nr, 2] for v in el.vertices) > 0.6
        for el in result.problem.mesh.Elements()
    ]
    values = indicators.vec.FV().NumPy()
    assert values.min() >= 0
    assert values[top].mean() > 2 * values[~np.array(top)].mean()


def test_a_linear_law_in_a_table_has_the_estimate_of_the_linear_one():
    base, start, slope = (
        lshape_problem(lshape.paper_mesh(113)),
        1.25 / np.sqrt(2 / 3),
        15.0,
    )
    table = Tabulated([0, 9.0], [start, start + 9 * slope])
    materials = (
        replace(base.material, hardening=slope / 1.5),
        Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=table),
    )
    linear, tabulated = (
        semismooth_newton(replace(base, material=m)) for m in materials
    )
    assert estimate(tabulated) == pytest.approx(estimate(linear), rel=1e-9)


def prisms(n):
    mesh = MakeStructured3DMesh(nx=n, ny=n, nz=n, prism=True)
    for number, name in enumerate(mesh.GetBoundaries()):
        mesh.ngmesh.SetBCName(
            number, {"bottom": "clamped", "top": "contact"}.get(name, name)
        )
    return mesh


SHAPES = {
    "quadrilaterals": lambda n: block.structured_mesh(n, n),
    "hexahedra": lambda n: block.structured_mesh(n, n, n),
    "prisms": prisms,
}


@pytest.mark.parametrize(("order", "shape"), in_turn([1, 2], SHAPES))
def test_other_shapes_have_an_estimate(shape, order):
    """Against the energy of two thirds of the mesh width, which has about half of the error."""
    steel = indented_block(0).material
    n = 8 if shape == "quadrilaterals" else 4
    load = (4.0, 1.0) if shape == "quadrilaterals" else (4.0, 1.0, 0.0)
    coarse, fine = (
        semismooth_newton(
            Problem(SHAPES[shape](k), steel, traction={"contact": load}, order=order)
        )
        for k in (n, 3 * n // 2)
    )
    error = 2 * (coarse.primal_energy - fine.primal_energy)
    assert coarse.state.at.yields.any()
    assert 0.3 * error < estimate(coarse) < 2 * error
    assert error_indicators(coarse).vec.FV().NumPy().min() >= 0
