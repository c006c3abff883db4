"""All pairs of methods and features: each is right beside a witness, or refuses by name."""

import re
from dataclasses import replace
from functools import cache

import meshio
import numpy as np
import pytest
from featured import problem_with, share
from matplotlib.pyplot import close
from ngsolve import Integrate, Mesh, dx
from witness import distance_bound, dual_residual

from ngepc import (
    MeanDisplacement,
    Status,
    displacement_bracket,
    duality_report,
    error_bound,
    error_indicators,
    export_vtu,
    goal_bound,
    gradient,
    limit_load,
    plot_field,
    primal_newton,
    semismooth_newton,
    shakedown_load,
    write_receipt,
)
from ngepc.bounds import coverage as bounds
from ngepc.dual import blocks
from ngepc.geometries import block
from ngepc.goals import brackets, check_receipt, receipt
from ngepc.goals import goal_bound as intervals
from ngepc.limit import reading, shakedown
from ngepc.local import indicators, solver
from ngepc.model.features import FEATURES
from ngepc.pictures import export, sampling
from ngepc.pictures.sampling import corners_of
from ngepc.primal import energy
from ngepc.sensitivity import gradient as derivatives

SHARED = "shared mesh"
"""What runs there is tested by processes that share one, tests/local/test_processes.py."""

STEP = 0.5  # of lame_mu, for a central difference


@cache
def problem_of(feature):
    """The problem with the feature, always the same one."""
    return problem_with(feature)


@cache
def exact(feature):
    """The result of the exact method; from then on the mesh is shared, where that is asked for."""
    result = semismooth_newton(problem_of(feature))
    if feature == SHARED:
        share(result.problem.mesh)
    return result


@cache
def witness(feature):
    """The result of the witness."""
    return primal_newton(problem_of(feature))


def again(problem):
    """The result of the witness, of the exact method where the witness does not cover it."""
    covered = set(problem.features) <= energy.COVERS
    return (primal_newton if covered else semismooth_newton)(problem)


def values(result):
    """The nodal displacements, flat."""
    return result.displacement.vec.FV().NumPy()


def distance(one, other):
    """The largest difference of displacements over the largest displacement."""
    return np.abs(values(one) - values(other)).max() / np.abs(values(other)).max()


@cache
def finer(feature):
    """The result of the witness with the edges of the mesh halved."""
    problem = problem_of(feature)
    if feature == "hexahedra":  # Netgen does not refine them
        return again(replace(problem, mesh=block.structured_mesh(3, 3, 3)))
    return on_a_finer_mesh(problem)


def on_a_finer_mesh(problem):
    """The result of the witness with the edges of the mesh halved."""
    mesh = Mesh(problem.mesh.ngmesh.Copy())
    mesh.Refine()
    return again(replace(problem, mesh=mesh))


# A method: what it does with a feature, and why that is right


def by_exact_method(feature, _):
    """The certificate closes, and the body yields."""
    result = exact(feature)
    gap = result.primal_energy + result.dual_energy
    assert result.status is Status.CONVERGED
    assert abs(gap) < 1e-9 * abs(result.primal_energy)
    assert result.history.records[-1].plastic_active > 0


def by_witness(feature, _):
    """The witness agrees with the exact method."""
    assert witness(feature).status is Status.CONVERGED
    assert distance(witness(feature), exact(feature)) < 1e-8


WITH_LARGE_GAMMA = ("plane strain", "axisymmetric", "isotropic hardening", "obstacle")
"""Features with which gamma is large, too."""


def by_regularisation(feature, _):
    """The residual by plain forms is zero, and the energies bound the distance to the witness.

    The terms of the duality gap add up to it.
    """
    for gamma in (1e3, 1e6) if feature in WITH_LARGE_GAMMA else (1e3,):
        result = semismooth_newton(problem_of(feature), gamma)
        apart, allowed = distance_bound(witness(feature), result)
        assert dual_residual(result).norm < 1e-10
        assert apart <= allowed
        report = duality_report(result)
        size = abs(report.primal_energy) + abs(report.dual_energy)
        assert abs(sum(report.parts.values()) - report.gap) < 1e-8 * size


def by_bound(feature, _):
    """The energy on a finer mesh is lower, but not below what the bound says."""
    bound = error_bound(exact(feature))
    lower = finer(feature).primal_energy
    assert 0 < bound.energy - lower <= bound.total


def moved_on_a_finer_mesh(feature):
    """The integral of u_x over the side 'right', whose measure is one, on a finer mesh."""
    u = finer(feature).displacement
    mesh = u.space.mesh
    side = mesh.Boundaries("right")
    assert Integrate(1, mesh, definedon=side) == pytest.approx(1.0)
    return Integrate(u[0], mesh, definedon=side)


def by_bracket(feature, _):
    """The displacement on a finer mesh lies in the bracket of any chords: the first ones do."""
    problem = problem_of(feature)
    load = {"right": (1.0,) + (0.0,) * (problem.N - 1)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(brackets, "PASSES", 1)
        found = displacement_bracket(exact(feature), load)
    assert found.lower <= moved_on_a_finer_mesh(feature) <= found.upper


def by_goal(feature, _):
    """The mean displacement on a finer mesh lies in the interval."""
    sides = problem_of(feature).mesh.GetBoundaries()
    side = "right" if "right" in sides else "outer"
    found = goal_bound(exact(feature), MeanDisplacement(side, 0))
    assert found.lower <= moved_on_a_finer_mesh(feature) <= found.upper


def by_receipt(feature, folder):
    """The checker accepts the file, and the energy on a finer mesh is in the interval."""
    path = folder / "receipt.npz"
    problem = problem_of(feature)
    result = exact(feature)
    if feature == "solid":  # its obstacle is not affine on facets
        problem = replace(problem, gap=3e-4)
        result = semismooth_newton(problem)
    lower, upper = write_receipt(result, path)
    assert f"({lower}, {upper})" in check_receipt.check(path)
    assert lower < on_a_finer_mesh(problem).primal_energy < upper


def by_limit_load(feature, _):
    """The bracket closes, where obstacles touch."""
    problem = problem_of(feature)
    if problem.contact_names and not problem.contact_pairs:
        problem = replace(problem, gap=0.0)
    width = 0.4 if feature == "solid" else 0.2
    found = limit_load(problem, width, max_cells=1000)
    assert 0 < found.lower <= found.upper < (1 + width) * found.lower


IGNORED = (
    "kinematic hardening",
    "isotropic hardening",
    "hardening law",
    "order 2",
    "initial strain",
)
"""Features that shakedown ignores but for the yield stress."""


@cache
def shakedown_of(feature, max_cells):
    """The factor of a load that comes and goes."""
    ranges = {"right": (0, 1)}
    return shakedown_load(problem_of(feature), ranges, 0.2, max_cells=max_cells)


def by_shakedown(feature, _):
    """The bracket closes; what shakedown ignores leaves that of the plain body, mesh by mesh."""
    if feature in IGNORED:
        plain = shakedown_of("plane strain", 1000)
        found = shakedown_of(feature, 1).records[0]
        stronger = yield_stress_of(feature) / yield_stress_of("plane strain")
        assert found.lower == pytest.approx(stronger * plain.records[0].lower)
        assert found.upper == pytest.approx(stronger * plain.records[0].upper)
        return
    found = shakedown_of(feature, 1000)
    assert 0 < found.lower <= found.upper < 1.2 * found.lower


def yield_stress_of(feature):
    """The bound of the deviator at first yield."""
    return problem_of(feature).material.yield_stress


def by_derivative(feature, _):
    """A derivative by a modulus, beside a central difference of the witness."""
    problem = problem_of(feature)

    def form(u, p, sigma):
        return (u[0] + 100 * u[1] * u[1]) * dx

    def value(mu):
        material = replace(problem.material, lame_mu=mu)
        u = again(replace(problem, material=material)).displacement
        return Integrate(u[0] + 100 * u[1] * u[1], problem.mesh)

    found = gradient(exact(feature), form, "lame_mu")
    mu = problem.material.lame_mu
    difference = (value(mu + STEP) - value(mu - STEP)) / (2 * STEP)
    assert found["lame_mu"] == pytest.approx(difference, rel=1e-4)


def by_estimate(feature, _):
    """The estimate is of the size of what a finer mesh gains."""
    result = exact(feature)
    estimate = np.array(error_indicators(result).vec).sum()
    gained = result.primal_energy - finer(feature).primal_energy
    assert 0.3 * gained < estimate < 10 * gained


def by_picture(feature, _):
    """What is drawn are the displacements of the nodes."""
    state = exact(feature)
    drawn = corners_of(state).displacement
    figure = plot_field(state, "von_mises")
    close(figure)
    assert np.abs(drawn).max() == pytest.approx(np.abs(values(state)).max(), rel=0.1)


def by_export(feature, folder):
    """The file has the largest displacement."""
    state = exact(feature)
    path = export_vtu(state, folder / "state.vtu", ["displacement"])
    read = meshio.read(path).point_data["displacement"]
    assert np.abs(read).max() == pytest.approx(np.abs(values(state)).max(), rel=0.1)


METHODS = {
    "exact": (by_exact_method, solver.COVERS),
    "witness": (by_witness, energy.COVERS),
    "gamma": (by_regularisation, blocks.COVERS),
    "bound": (by_bound, bounds.COVERS),
    "goal": (by_goal, intervals.COVERS),
    "receipt": (by_receipt, receipt.COVERS),
    "bracket": (by_bracket, brackets.COVERS),
    "limit load": (by_limit_load, reading.COVERS),
    "shakedown": (by_shakedown, shakedown.SHAKEDOWN_COVERS),
    "derivative": (by_derivative, derivatives.COVERS),
    "estimate": (by_estimate, indicators.COVERS),
    "picture": (by_picture, sampling.COVERS),
    "VTU": (by_export, export.COVERS),
}
"""Column of docs/features.md -> the check, and what the method covers."""


@pytest.mark.usefixtures("quickly_drawn")
@pytest.mark.parametrize("feature", FEATURES)
@pytest.mark.parametrize("method", METHODS)
def test_a_method_is_right_with_a_feature_or_refuses_it(method, feature, tmp_path):
    check, covers = METHODS[method]
    exact(feature)
    assert feature in problem_of(feature).features
    if feature in covers:
        if feature == SHARED:
            pytest.skip("needs processes")
        check(feature, tmp_path)
        return
    refused = [
        re.escape("mesh has" if argument == "mesh" else f"{argument}=")
        for name, (argument, _) in problem_of(feature).features.items()
        if name not in covers
    ]
    message = f"({'|'.join(refused)}).* needs |not on a mesh that 2 processes share"
    with pytest.raises(ValueError, match=message):
        check(feature, tmp_path)
