"""PETSc's multigrid against the direct solver, on every kinematics and order."""

import os

import pytest
from ngepc.geometries import lshape

from ngepc import NewtonOptions, PETSc, Problem, lshape_problem, semismooth_newton
from ngepc.local import petsc as module
from ngepc.studies.large import indented_block, solve_large

needed = pytest.mark.skipif(
    module.petsc is None and not os.environ.get("NGEPC_NEEDS_PETSC"), reason="petsc4py is missing"
)


def lshape_with(kinematics):
    paper = lshape_problem(lshape.paper_mesh(417))
    return Problem(
        paper.mesh,
        paper.material,
        "clamped",
        paper.tractions,
        contact="contact",
        gap=0.1,
        kinematics=kinematics,
    )


CASES = {
    "solid": lambda: indented_block(2),
    "solid, order 2": lambda: indented_block(1, order=2),
    "little hardening": lambda: indented_block(1, hardening=1.0),
    "two-dimensional": lambda: lshape_with("two-dimensional"),
    "plane strain": lambda: lshape_with("plane strain"),
}


@needed
@pytest.mark.parametrize("case", CASES)
def test_the_solution_is_that_of_the_direct_solver(case):
    problem = CASES[case]()
    direct = semismooth_newton(problem)
    large = semismooth_newton(problem, options=NewtonOptions(inverse=PETSc()))
    assert large.status.label == direct.status.label == "converged"
    assert large.primal_energy == pytest.approx(direct.primal_energy, rel=1e-10)
    assert large.contact_force == pytest.approx(direct.contact_force, rel=1e-7)
    assert large.iterations <= direct.iterations + 2
    assert sum(large.history.column("linear_iterations")) > 0


@needed
def test_options_are_those_of_petsc():
    problem = indented_block(1)
    counts = {}
    for options in ("", "-pc_type hypre", "-pc_type jacobi", "-pc_type cholesky"):
        result = semismooth_newton(problem, options=NewtonOptions(inverse=PETSc(options=options)))
        assert result.status.label == "converged"
        counts[options] = sum(result.history.column("linear_iterations"))
    assert counts["-pc_type jacobi"] > 3 * counts[""]
    assert counts["-pc_type cholesky"] < counts[""] < 2 * counts["-pc_type hypre"]


@needed
def test_counts_do_not_grow_with_the_mesh():
    records = solve_large(2, PETSc())
    for record in records:
        assert record["status"] == "converged"
        assert record["steps"] <= 10
        assert record["difference"] < 1e-8
        pairs = zip(record["iterations"], record["solves"], strict=True)
        assert max(n / k for n, k in pairs) <= 25


@needed
def test_gamma_wants_a_direct_solver():
    with pytest.raises(ValueError, match="a direct solver is needed with gamma"):
        semismooth_newton(indented_block(0), 1e3, options=NewtonOptions(inverse=PETSc()))


def test_without_petsc_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(module, "petsc", None)
    with pytest.raises(ImportError, match="apt install python3-petsc4py"):
        PETSc()


@needed
@pytest.mark.parametrize(
    ("name", "value"),
    [("options", 3), ("forcing", 0.0), ("patience", 0), ("max_iterations", 0)],
)
def test_options_out_of_range_are_named(name, value):
    with pytest.raises((TypeError, ValueError), match=name):
        PETSc(**{name: value})
