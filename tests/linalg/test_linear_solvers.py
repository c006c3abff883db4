"""Krylov solvers: the same answers as the direct one, bounded counts, failures with a name."""

import json
from functools import cache

import numpy as np
import pytest
from ngepc.geometries import block, lshape
from ngsolve import GridFunction, IfPos, InnerProduct, sin, sqrt, x, y, z

from ngepc import (
    Balanced,
    Coupled,
    Krylov,
    Material,
    NewtonOptions,
    PenaltyContact,
    PointwisePlasticStrain,
    Problem,
    lshape_problem,
    semismooth_newton,
)
from ngepc.__main__ import main
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional
from ngepc.krylov.hierarchy import Level, levels, prolongations
from ngepc.krylov.iterative import KrylovError, conjugate_gradients
from ngepc.krylov.matrices import Mirrored
from ngepc.krylov.matrices import block as block_of
from ngepc.krylov.multigrid import VCycle
from ngepc.krylov.surface import schur_complement
from ngepc.krylov.tangent import TangentElasticity
from ngepc.linalg.assembly import diagonal_block
from ngepc.linalg.direct import Direct, linear_solver
from ngepc.results.outcome import Status
from ngepc.studies import krylov
from ngepc.theory.lambda_newton import newton_in_lambda

STEEL = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0)


@cache
def refined_block(refinements: int):
    mesh = block.mesh(maxh=1.0)
    for _ in range(refinements):
        mesh.Refine()
    return mesh


def indented(mesh) -> Problem:
    """A sphere of radius 1 pressed 0.03 into the top of a block."""
    gap = 1.0 - sqrt(1.0 - (x - 0.5) ** 2 - (y - 0.5) ** 2) - 0.03
    return Problem(mesh, STEEL, "clamped", contact="contact", gap=gap)


def solved(problem, regularisation, inverse="sparsecholesky"):
    options = NewtonOptions(quadrature_points=60, inverse=inverse)
    return semismooth_newton(problem, regularisation=regularisation, options=options)


@cache
def half_plastic(refinements: int, gamma: float):
    """The functional on a block, and a v whose q exceeds the yield bound in the upper part."""
    problem = indented(refined_block(refinements))
    regularisation = Balanced(
        gamma, contact=PenaltyContact(gamma=1.0), plastic_strain=PointwisePlasticStrain()
    )
    blocks = LinearBlocks(problem, regularisation, Krylov())
    functional = DualFunctional(blocks, regularisation, 60)
    v, q = blocks.H_vector(), GridFunction(blocks.spaces[-1])
    q.components[0].Set(IfPos(z - 0.6, 5.5 + 0.5 * sin(4 * x), sin(4 * x)))
    blocks.part_of(v, 1).data = q.vec
    return functional, v


@pytest.mark.parametrize(
    "regularisation",
    [
        Balanced(),
        Balanced(plastic_strain=PointwisePlasticStrain()),
        Balanced(1e9, contact=PenaltyContact(gamma=1.0)),
        Coupled(10.0),
    ],
    ids=["balanced", "pointwise", "penalty", "coupled"],
)
def test_same_solution_as_the_direct_solver(regularisation):
    problem = indented(refined_block(2))
    direct, iterated = (solved(problem, regularisation, s) for s in ("sparsecholesky", Krylov()))
    assert iterated.status is Status.CONVERGED
    assert iterated.dual_energy == pytest.approx(direct.dual_energy, rel=1e-9)
    assert iterated.contact_force == pytest.approx(direct.contact_force, rel=1e-6)
    v, w = (result.v.FV().NumPy() for result in (iterated, direct))
    assert np.abs(v - w).max() < 1e-5 * np.abs(w).max()
    assert all(iterated.history.column("linear_iterations")[1:])
    assert not any(direct.history.column("linear_iterations"))


def test_mesh_without_family_and_no_contact():
    problem = Problem(block.mesh(maxh=0.5), STEEL, "clamped", {"contact": (4.0, 0.0, 3.0)})
    direct, iterated = (solved(problem, Balanced(), s) for s in ("sparsecholesky", Krylov()))
    assert iterated.status is Status.CONVERGED
    assert iterated.dual_energy == pytest.approx(direct.dual_energy, rel=1e-9)


def test_two_dimensions_and_bisected_meshes():
    problem = lshape_problem(lshape.paper_mesh(417))
    direct, iterated = (solved(problem, Balanced(1e9), s) for s in ("sparsecholesky", Krylov()))
    assert iterated.status is Status.CONVERGED
    assert iterated.dual_energy == pytest.approx(direct.dual_energy, rel=1e-9)
    assert iterated.iterations <= direct.iterations + 4


def test_prolongations_carry_linear_functions():
    """The prolongation of the coarse interpolant of a linear function is the fine one."""
    for mesh in (refined_block(2), lshape.paper_mesh(417)):
        points = np.asarray(mesh.ngmesh.Coordinates())[:, : mesh.dim]
        family = prolongations(mesh)
        assert family[-1].fine == mesh.nv
        for P in family:
            matrix = P.matrix(np.ones(2 * P.fine, dtype=bool))
            coarse, fine = matrix.CreateRowVector(), matrix.CreateColVector()
            coarse.FV().NumPy()[:] = points[: P.coarse, :2].T.ravel()
            fine.data = matrix * coarse
            assert np.allclose(fine.FV().NumPy(), points[: P.fine, :2].T.ravel())


def cycles_for_elasticity(refinements: int, plastic: bool) -> int:
    """CG steps to 1e-8 for the tangent elasticity, elastic or with a plastic upper part."""
    functional, v = half_plastic(refinements, 1e7)
    q = functional.blocks.part_of(v, 1) if plastic else None
    (T,) = TangentElasticity(functional).matrices(q, 1)
    b = T.CreateColVector()
    b.FV().NumPy()[:] = np.random.default_rng(0).normal(size=len(b))
    x = b.CreateVector()
    x[:] = 0.0
    cycle = VCycle([T], levels(functional.blocks.Y.components[0]), 2)
    return conjugate_gradients(T, cycle, b, x, 1e-8, 200)


@pytest.mark.parametrize("plastic", [False, True])
def test_cycles_for_elasticity_are_bounded_over_refinements(plastic):
    counts = [cycles_for_elasticity(k, plastic) for k in (1, 2, 3)]
    assert max(counts) <= (35 if plastic else 20)


def minres_iterations(refinements: int, gamma: float) -> int:
    """Iterations of the first solve at a state that is plastic in the upper part."""
    functional, v = half_plastic(refinements, gamma)
    blocks = functional.blocks
    y = blocks.load.CreateVector()
    blocks.primal_of(v, y)
    system = Krylov().newton_system(functional)
    system.step(v, functional.residual(y, v))
    return system.linear_iterations / system.back_substitutions


@pytest.mark.parametrize("gamma", [1e1, 1e5, 1e9])
def test_counts_over_refinements_and_gamma(gamma):
    """Bounded by one number, and growing less with each refinement."""
    counts = [minres_iterations(k, gamma) for k in (1, 2, 3)]
    assert max(counts) <= 60
    assert counts[2] <= 1.45 * counts[1]


@pytest.mark.parametrize("refinements", [1, 2, 3])
def test_multilevel_compliance_of_the_surface(refinements):
    """Spectrally equivalent to L T^(-1) L^T, whatever the mesh and however much is plastic."""
    functional, v = half_plastic(refinements, 1e7)
    blocks = functional.blocks
    (T,) = TangentElasticity(functional).matrices(blocks.part_of(v, 1), 1)
    family, n = blocks.u_inverse.family, blocks.Y.components[0].ndof
    L = block_of(
        blocks.saddle.mat, range(blocks.Y.ndof, blocks.Y.ndof + blocks.spaces[0].ndof), range(n)
    )
    exact = VCycle([T], [Level(family[0].free, None)], 1).compliance(L)
    multilevel = schur_complement(L, VCycle([T], family, 2))
    free = np.array(blocks.spaces[0].FreeDofs())
    chosen = np.ix_(free, free)
    ratios = np.linalg.eigvals(np.linalg.solve(multilevel[chosen], exact[chosen])).real
    assert ratios.min() > 0.4
    assert ratios.max() < 2.5


def test_mirrored_is_symmetric_and_follows_its_lower_triangle():
    lower, _ = condensed_elasticity()
    mirrored = Mirrored(lower)
    u, v = (mirrored.matrix.CreateColVector() for _ in range(2))
    for k, w in enumerate((u, v)):
        w.FV().NumPy()[:] = np.random.default_rng(k).normal(size=len(w))
    Au, Av = (mirrored.matrix * w for w in (u, v))
    assert InnerProduct(v, Au.Evaluate()) == pytest.approx(InnerProduct(u, Av.Evaluate()))
    before = (mirrored.matrix * u).Evaluate().Norm()
    lower.AsVector().data *= 2.0
    mirrored.update(lower)
    assert (mirrored.matrix * u).Evaluate().Norm() == pytest.approx(2 * before)


def test_too_few_iterations_end_the_run_with_a_name():
    result = solved(indented(refined_block(2)), Balanced(), Krylov(max_iterations=3))
    assert result.status is Status.LINEAR_SOLVER_FAILED
    assert "did not converge" in result.message
    assert "max_iterations" in result.message


def test_too_few_iterations_for_the_start_are_an_error():
    problem = Problem(refined_block(2), STEEL, "clamped", {"contact": (1.0, 0.0, 0.0)})
    with pytest.raises(KrylovError, match="CG did not converge"):
        solved(problem, Balanced(), Krylov(max_iterations=2))


def condensed_elasticity():
    """The lower triangle of D on a block, its rows and columns of u, and their space."""
    blocks = half_plastic(2, 1e5)[0].blocks
    V = blocks.Y.components[0]
    return diagonal_block(blocks.D, 0, V.ndof), V


def test_an_inaccurate_solve_is_an_error():
    lower, V = condensed_elasticity()
    b, x = (lower.CreateColVector() for _ in range(2))
    b.FV().NumPy()[:] = 1.0
    inverse = Krylov(max_iterations=2).primal_inverse(lower, V)
    with pytest.raises(KrylovError, match="CG did not converge"):
        inverse.Mult(b, x)
    b[0] = np.nan
    with pytest.raises(KrylovError):
        inverse.Mult(b, x)


@pytest.mark.parametrize(
    "options",
    [{"forcing": 0.0}, {"forcing": 1.0}, {"accuracy": 2}, {"max_iterations": 0}, {"sweeps": 0}],
)
def test_options_out_of_range_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Krylov(**options)


def test_what_the_option_inverse_takes():
    assert linear_solver("umfpack") == Direct("umfpack")
    assert linear_solver(Krylov()) == Krylov()
    with pytest.raises(ValueError, match="inverse"):
        NewtonOptions(inverse=3)
    options = NewtonOptions(inverse=Krylov(), linesearch=None)
    with pytest.raises(ValueError, match="inverse"):
        newton_in_lambda(indented(refined_block(0)), Coupled(10.0), options=options)


def test_study_compares_with_the_direct_solver(tmp_path, monkeypatch):
    """281 nodes: the energies agree, and few more Newton steps are taken."""
    some = {case: krylov.CASES[case] for case in ("1e5", "1e7")}
    monkeypatch.setattr(krylov, "CASES", some)
    assert main(["study", "krylov", "--out", str(tmp_path)]) == 0
    for cell in json.loads((tmp_path / "krylov.json").read_text())["cells"]:
        assert cell["nodes"] == 281
        assert cell["difference"] < 1e-9
        assert cell["steps"] <= cell["steps_direct"] + 3
        assert sum(cell["iterations"]) <= 45 * sum(cell["solves"])
    assert "281 nodes" in (tmp_path / "krylov.md").read_text()


def test_study_refuses_more_meshes_than_memory_holds(tmp_path, capsys):
    assert main(["study", "krylov", "--levels", "5", "--out", str(tmp_path)]) == 2
    assert "1 to 4" in capsys.readouterr().err
