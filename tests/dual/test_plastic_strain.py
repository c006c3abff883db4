"""Plastic strains at every point: the same method as p of order one, without checkerboards."""

import netgen.geom2d
import numpy as np
import pytest
from ngepc.geometries import block, lshape, wrench
from ngsolve import L2, GridFunction, IfPos, InnerProduct, Integrate, Mesh, sqrt, x, y
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

import ngepc.discretisation.spaces
from ngepc import (
    Balanced,
    Coupled,
    ElementwisePlasticStrain,
    Krylov,
    Material,
    NewtonOptions,
    PenaltyContact,
    PointwisePlasticStrain,
    Problem,
    Status,
    duality_report,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.fractional import to_dense
from ngepc.krylov.matrices import Mirrored
from ngepc.model.tensors import coordinates

POINTWISE = Balanced(1e9, plastic_strain=PointwisePlasticStrain())
STEEL = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0)


def pressed_block():
    mesh = block.mesh(maxh=1.0)
    for _ in range(2):
        mesh.Refine()
    gap = 1.0 - sqrt(1.0 - (x - 0.5) ** 2 - (y - 0.5) ** 2) - 0.03
    return Problem(mesh, STEEL, "clamped", contact="contact", gap=gap)


PROBLEMS = {
    "(a)": lambda: lshape_problem(lshape.paper_mesh(417)),
    "(b)": lambda: wrench_problem(wrench.paper_mesh(873)),
    "block": pressed_block,
}


def square(field, problem):
    return Integrate(InnerProduct(field, field), problem.mesh)


def solved(problem, regularisation, **options):
    options = NewtonOptions(quadrature_points=100, **options)
    return semismooth_newton(problem, regularisation=regularisation, options=options)


@pytest.mark.parametrize("name", PROBLEMS)
def test_same_solution_as_with_p_discontinuous_of_order_one(name, monkeypatch):
    """There p has room for (q - Pi q) / c; it is only a larger space for the same minimiser."""
    problem = PROBLEMS[name]()
    result = solved(problem, POINTWISE)
    monkeypatch.setattr(ngepc.discretisation.spaces, "plastic_order", lambda mesh: 1)
    larger = solved(problem, Balanced(1e9))
    assert result.status is larger.status is Status.CONVERGED
    assert result.y.FV().NumPy().size < larger.y.FV().NumPy().size
    assert result.dual_energy == pytest.approx(larger.dual_energy, rel=1e-9)
    assert result.primal_energy == pytest.approx(larger.primal_energy, rel=1e-6)
    p, p_larger = result.balanced_increment, larger.balanced_increment
    assert square(p - p_larger, problem) < 1e-10 * square(p_larger, problem)


@pytest.mark.parametrize(
    "regularisation",
    [POINTWISE, Coupled(1e2, plastic_strain=PointwisePlasticStrain())],
    ids=["balanced", "coupled"],
)
def test_parts_add_up_to_the_duality_gap(regularisation):
    report = duality_report(solved(PROBLEMS["(a)"](), regularisation))
    assert sum(report.parts.values()) == pytest.approx(report.gap, rel=1e-7)


def test_pointwise_law():
    """h_F p - dev sigma = q at every point, (3.8): F is at its minimum over p."""
    problem = PROBLEMS["block"]()
    result = solved(problem, POINTWISE)
    h_F, p = problem.effective_hardening / 2, result.balanced_increment
    stress, q = coordinates(result.fields.deviatoric_stress, 3), result.state.components[-1]
    assert square(h_F * p - stress - q, problem) < 1e-16 * square(q, problem)


def smallest_ratio(plastic_strain, problem):
    """The smallest eigenvalue of the block of q in (7.1) without active terms, over the largest."""
    regularisation = Balanced(1e12, contact=PenaltyContact(), plastic_strain=plastic_strain)
    blocks = LinearBlocks(problem, regularisation, "sparsecholesky")
    first = blocks.Y.ndof + int(blocks.firsts[-2])
    saddle = to_dense(Mirrored(blocks.saddle.mat).matrix)[first:, first:]
    n = problem.mesh.nv
    eigenvalues = np.linalg.eigvalsh(saddle[:n, :n])
    return eigenvalues[0] / eigenvalues[-1]


@pytest.mark.parametrize("dim", [2, 3])
def test_no_checkerboard(dim):
    """Structured meshes have vertex colours: a q of the colours with mean zero on each element."""
    make = {2: lambda: MakeStructured2DMesh(False, 6, 6), 3: lambda: MakeStructured3DMesh(False, 3)}
    problem = Problem(make[dim](), STEEL, "left" if dim == 2 else "back")
    assert abs(smallest_ratio(ElementwisePlasticStrain(), problem)) < 1e-14
    assert smallest_ratio(PointwisePlasticStrain(), problem) > 1e-2


def test_both_choices_have_the_same_limit():
    energies = []
    for nodes in (113, 417, 1601):
        problem = lshape_problem(lshape.paper_mesh(nodes))
        pair = [solved(problem, r).dual_energy for r in (Balanced(1e9), POINTWISE)]
        energies.append(abs(pair[0] - pair[1]) / pair[0])
    assert energies[0] > 2 * energies[1] > 4 * energies[2]


@pytest.mark.parametrize(("name", "most"), [("a", 6), ("b", 7)])
def test_nested_steps(name, most):
    body, make = {"a": (lshape, lshape_problem), "b": (wrench, wrench_problem)}[name]
    result, counts = None, []
    for nodes in body.PAPER_NODES[:3]:
        problem = make(body.paper_mesh(nodes))
        result = semismooth_newton(problem, start=result, regularisation=POINTWISE)
        assert result.status is Status.CONVERGED
        counts.append(result.iterations)
    assert max(counts[1:]) <= most


def test_moduli_that_jump_between_elements():
    mesh = lshape.paper_mesh(113)
    soft = GridFunction(L2(mesh, order=0))
    soft.Set(IfPos(x - 0.5, 500.0, 1000.0))
    material = Material.kinematic(lame_lambda=1e3, lame_mu=soft, yield_stress=1.25, hardening=100.0)
    problem = Problem(mesh, material, "clamped", {"load": (0.0, 5.0)}, contact="contact", gap=0.1)
    result = solved(problem, POINTWISE)
    report = duality_report(result)
    assert result.status is Status.CONVERGED
    assert sum(report.parts.values()) == pytest.approx(report.gap, rel=1e-7)


def quadrilaterals():
    return MakeStructured2DMesh(True, 3, 3)


def curved():
    geometry = netgen.geom2d.SplineGeometry()
    geometry.AddCircle((0, 0), 1, bc="left")
    return Mesh(geometry.GenerateMesh(maxh=0.5)).Curve(2)


@pytest.mark.parametrize("make", [quadrilaterals, curved])
def test_other_elements_are_refused(make):
    problem = Problem(make(), STEEL, "left")
    with pytest.raises(ValueError, match=r"plastic_strain=.*straight triangles or tetrahedra"):
        semismooth_newton(problem, regularisation=POINTWISE)


@pytest.mark.parametrize("kind", [Balanced, lambda **more: Coupled(1.0, **more)])
def test_other_choices_are_refused(kind):
    with pytest.raises(TypeError, match="plastic_strain=3"):
        kind(plastic_strain=3)


def test_krylov_solver_too():
    problem = pressed_block()
    direct, iterated = (solved(problem, POINTWISE, inverse=s) for s in ("sparsecholesky", Krylov()))
    assert iterated.dual_energy == pytest.approx(direct.dual_energy, rel=1e-9)
