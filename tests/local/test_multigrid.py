"""Multigrid of PETSc and of PyAMG against the direct solver, on every kinematics and order."""

import os
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import STEEL, pressed_body

from ngepc import (
    Contact,
    Coulomb,
    NewtonOptions,
    PETSc,
    PrimalOptions,
    Problem,
    PyAMG,
    Roller,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block, lshape
from ngepc.local import petsc, pyamg
from ngepc.studies.contact_problems import roller
from ngepc.studies.large import indented_block, solve_large

needed = pytest.mark.skipif(
    petsc.petsc is None and not os.environ.get("NGEPC_NEEDS_PETSC"),
    reason="petsc4py is missing",
)
wheel = pytest.mark.skipif(pyamg.pyamg is None, reason="pyamg is missing")
both = pytest.mark.parametrize(
    "solver", [pytest.param(PETSc, marks=needed), pytest.param(PyAMG, marks=wheel)]
)


def lshape_with(kinematics):
    paper = lshape_problem(lshape.paper_mesh(113))
    load, gap = paper.tractions, 0.1
    data = (paper.mesh, paper.material, "clamped", load, "contact", gap)
    return Problem(*data, kinematics=kinematics)


def on_springs():
    """A block on rollers and springs, pushed aside under a press."""
    return Problem(
        *(
            block.structured_mesh(5, 5),
            STEEL,
            None,
            {"right": (-3.0, 0.5)},
            "contact",
            -1e-3,
        ),
        prescribed={"clamped": Roller()},
        springs={"left": (50.0, 20.0)},
        friction=1.0,
    )


CASES = {
    "solid, order 2": lambda: indented_block(1, order=2),
    "hexahedra": lambda: pressed_body("hexahedra", order=2),
    "little hardening": lambda: indented_block(1, hardening=1.0),
    "two-dimensional": lambda: lshape_with("two-dimensional"),
    "plane strain": lambda: lshape_with("plane strain"),
    "axisymmetric": lambda: pressed_body("quadrilaterals", "axisymmetric", 2),
    "Tresca, cycling sets": lambda: replace(indented_block(1), friction=5.0),
    "Coulomb": lambda: replace(indented_block(1), friction=Coulomb(0.4)),
    "Coulomb, order 2": lambda: replace(
        pressed_body("tetrahedra", order=2), friction=Coulomb(0.4)
    ),
    "Tresca, flat": lambda: replace(lshape_with("plane strain"), friction=0.05),
    "rollers, springs": on_springs,
    "nothing to touch": lambda: replace(
        pressed_body("triangles"), contact=None, gap=None
    ),
    "floating": lambda: roller(2.0, 2),
    "floating, Tresca": lambda: replace(roller(2.0, 1), friction=50.0),
    "tied": lambda: replace(roller(2.0, 1), contact=Contact("flat", "arc", tied=True)),
}


@cache
def solved(case, solver=None):
    """A case by the direct solver, or with multigrid of one of the libraries."""
    options = None if solver is None else NewtonOptions(inverse=solver())
    return semismooth_newton(CASES[case](), options=options)


@both
@pytest.mark.parametrize("case", CASES)
def test_the_solution_is_that_of_the_direct_solver(case, solver):
    direct, large = solved(case), solved(case, solver)
    assert large.status.label == direct.status.label == "converged"
    assert large.primal_energy == pytest.approx(direct.primal_energy, rel=1e-10)
    assert large.contact_force == pytest.approx(direct.contact_force, rel=1e-7)
    assert large.iterations <= direct.iterations + 2
    assert sum(large.history.column("linear_iterations")) > 0
    assert large.friction_force == pytest.approx(
        direct.friction_force, rel=1e-6, abs=1e-9
    )


@both
def test_friction_costs_little_more_than_contact(solver):
    """Tresca's law acts on rows far from the obstacle, too: there is more to be found."""
    options = NewtonOptions(inverse=solver())
    smooth = indented_block(2)
    counts = [
        sum(
            semismooth_newton(body, options=options).history.column("linear_iterations")
        )
        for body in (smooth, replace(smooth, friction=5.0))
    ]
    assert counts[1] <= 4 * counts[0]


@both
@pytest.mark.parametrize("case", ["Tresca, cycling sets", "Tresca, flat"])
def test_forces_of_all_rows_are_those_of_the_direct_solver(case, solver):
    direct, large = solved(case), solved(case, solver)
    size = direct.contact_force
    assert np.abs(large.state.contact - direct.state.contact).max() < 1e-8 * size


PRIMAL = ("Coulomb", "axisymmetric", "floating, Tresca", "rollers, springs", "tied")
"""Cases of the primal method: each kind of row and of support, with friction and without."""


@both
@pytest.mark.parametrize("case", PRIMAL)
def test_the_primal_method_takes_the_same_steps(case, solver):
    problem = CASES[case]()
    direct = primal_newton(problem)
    large = primal_newton(problem, options=PrimalOptions(inverse=solver()))
    assert large.status.label == direct.status.label == "converged"
    assert large.primal_energy == pytest.approx(direct.primal_energy, rel=1e-10)
    saved = large.iterations - direct.iterations  # factors give a step more at the end
    assert saved in (0, 1)


@needed
def test_options_are_those_of_petsc():
    problem = indented_block(1)
    counts = {}
    for options in ("", "-pc_type hypre", "-pc_type jacobi", "-pc_type cholesky"):
        result = semismooth_newton(
            problem, options=NewtonOptions(inverse=PETSc(options=options))
        )
        assert result.status.label == "converged"
        counts[options] = sum(result.history.column("linear_iterations"))
    assert counts["-pc_type jacobi"] > 3 * counts[""]
    assert counts["-pc_type cholesky"] < counts[""] < 2 * counts["-pc_type hypre"]


@needed
def test_solves_one_after_the_other_leave_nothing_in_the_options_of_petsc():
    """PETSc has room for 512 options: a history of many steps must not fill it."""
    problem, sizes = indented_block(0), []
    for _ in range(3):
        semismooth_newton(problem, options=NewtonOptions(inverse=PETSc()))
        sizes.append(len(petsc.petsc.Options().getAll()))
    assert sizes[0] > 0
    assert len(set(sizes)) == 1


@both
def test_counts_do_not_grow_with_the_mesh_or_without_hardening(solver):
    records = solve_large(2, solver(), 1e-3)
    for record in records:
        assert record["status"] == "converged"
        assert record["iterations"] <= 10
        assert record["difference"] < 1e-8
        pairs = zip(record["linear_iterations"], record["solves"], strict=True)
        assert max(n / k for n, k in pairs) <= 25


@both
def test_gamma_wants_a_direct_solver(solver):
    with pytest.raises(ValueError, match="a direct solver is needed with gamma"):
        semismooth_newton(
            indented_block(0), 1e3, options=NewtonOptions(inverse=solver())
        )


def test_without_the_library_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(petsc, "petsc", None)
    with pytest.raises(ImportError, match="apt install python3-petsc4py"):
        PETSc()
    monkeypatch.setattr(pyamg, "pyamg", None)
    with pytest.raises(ImportError, match="pip install pyamg"):
        PyAMG()


@both
@pytest.mark.parametrize("name", ["forcing", "max_iterations"])
def test_options_out_of_range_are_named(solver, name):
    with pytest.raises(ValueError, match=name):
        solver(**{name: -1})


@needed
def test_options_of_petsc_are_a_text():
    with pytest.raises(TypeError, match="options=3"):
        PETSc(options=3)
