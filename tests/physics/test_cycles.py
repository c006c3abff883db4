"""Sub-elements that yield one after the other: Masing's loops by closed forms, and what else."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF

from ngepc import (
    Contact,
    Coulomb,
    Material,
    Overlay,
    Problem,
    evolve,
    load_cycle,
    material_point,
    semismooth_newton,
)
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.geometries import block
from ngepc.geometries.published import stacked_blocks

YOUNG = 200e3
CURVE = [(0.001, 200.0), (0.002, 300.0), (0.005, 380.0), (0.01, 420.0)]
STEEL = Material.cyclic(young=YOUNG, poisson=0.3, curve=CURVE)
ELASTIC = {"lame_lambda": 1e3, "lame_mu": 1e3}


def stress_on_the_curve(strain):
    """The straight lines between the points, the last one continued, odd in the strain."""
    strains, stresses = np.array([(0.0, 0.0), *CURVE]).T
    size = np.abs(strain)
    inside = np.interp(size, strains, stresses)
    slope = (stresses[-1] - stresses[-2]) / (strains[-1] - strains[-2])
    beyond = stresses[-1] + slope * (size - strains[-1])
    return np.sign(strain) * np.where(size > strains[-1], beyond, inside)


def bar(corners, steps=1, material=STEEL):
    return material_point(material, strain={"xx": corners}, steps=steps)


def test_a_first_loading_follows_the_curve():
    strains = np.linspace(0, 0.02, 41)[1:]
    point = bar(strains.tolist())
    expected = stress_on_the_curve(strains)
    assert point.stress[:, 0, 0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("amplitude", [0.0015, 0.004, 0.013])
def test_branches_of_a_loop_are_the_curve_twice_as_large(amplitude):
    """Masing: beyond a reversal the stress changes by twice the curve of half the strain."""
    point = bar([amplitude, -amplitude, amplitude], steps=37)
    strain, stress = point.strain[:, 0, 0], point.stress[:, 0, 0]
    for turn in (36, 73):
        branch = slice(turn + 1, turn + 38)
        expected = 2 * stress_on_the_curve((strain[branch] - strain[turn]) / 2)
        assert stress[branch] - stress[turn] == pytest.approx(expected, rel=1e-11)


def test_reversed_yield_begins_early_and_loops_are_closed():
    """Bauschinger: after a pull to sigma the bar yields again at sigma - 2 R, far before -sigma."""
    point = bar([0.01, 0.01 - 2 * CURVE[0][0]])
    assert point.stress[-1, 0, 0] == pytest.approx(420.0 - 2 * 200.0, rel=1e-12)
    assert point.accumulated_plastic_strain[0] == point.accumulated_plastic_strain[1]
    more = bar([0.01, 0.01 - 2.001 * CURVE[0][0]])
    assert np.diff(more.accumulated_plastic_strain)[0] > 0

    cycles = bar([0.01, -0.004, 0.006] + 3 * [-0.004, 0.006])
    stress = cycles.stress[:, 0, 0]
    assert stress[3::2] == pytest.approx(stress[1], rel=1e-12)
    assert stress[4::2] == pytest.approx(stress[2], rel=1e-12)


def test_a_small_loop_is_forgotten():
    """Memory: beyond a closed inner loop the branch goes on as if the loop had not been there."""
    with_loop = bar([0.01, 0.0, 0.004, 0.0, -0.008])
    without = bar([0.01, 0.0, -0.008])
    assert with_loop.stress[-1, 0, 0] == pytest.approx(
        without.stress[-1, 0, 0], rel=1e-12
    )


def test_what_it_cannot_do():
    """No ratcheting between two stresses, and no mean stress that relaxes between two strains."""
    between_stresses = material_point(
        STEEL, stress={"xx": [400.0, *4 * [-100.0, 400.0]]}
    )
    strain = between_stresses.strain[:, 0, 0]
    assert strain[2::2] == pytest.approx(strain[0], rel=1e-10)
    between_strains = bar([0.01, *4 * [0.006, 0.01]])
    stress = between_strains.stress[:, 0, 0]
    assert stress[1] + stress[2] > 100
    assert stress[3:5] == pytest.approx(stress[1:3], rel=1e-12)


def strip(material, **data):
    """A bar that is pulled between rollers: its state is uniform."""
    held = {"left": (0, None), "clamped": (None, 0)}
    given = {"clamped": None, "prescribed": held, "traction": {"right": (400.0, 0.0)}}
    mesh = block.structured_mesh(2, 1, size=(2.0, 1.0), simplices=True)
    return Problem(mesh, material, **given | {"kinematics": "plane stress"} | data)


def test_the_dissipation_of_a_loop():
    """Sub-elements slide by 4 (|G dev e| - k)/G in a loop; the work of the bar is the same."""
    problem = strip(STEEL)
    run = evolve(problem, load_cycle(problem, [1, -1, 1], steps=2)).raise_for_status()
    loop = sum(run.column("dissipation")[2:])
    energies = run.column("elastic_energy")
    assert energies[-1] == pytest.approx(energies[1], rel=1e-9)

    strains, stresses = np.array([(0.0, 0.0), *CURVE]).T
    strain = np.interp(400.0, stresses, strains)
    stretched = np.sqrt(2 / 3) * (400.0 + 3 * STEEL.lame_mu * (strain - 400.0 / YOUNG))
    slid = 4 * np.maximum(stretched - np.array(STEEL.overlay.bounds), 0)
    lost = slid * STEEL.overlay.shares @ STEEL.overlay.bounds / (2 * STEEL.lame_mu)
    area = problem.mesh.ne / 4 * 2.0
    assert loop == pytest.approx(area * lost, rel=1e-9)
    branch = np.linspace(0, strain, 2001)
    below = np.trapezoid(stress_on_the_curve(branch), branch)
    masing = 8 * below - 4 * strain * 400.0  # area of a loop of two branches
    assert lost == pytest.approx(masing, rel=1e-5)


def kinematic_twins():
    """One sub-element and one that never yields harden as a linear kinematic material does."""
    hardening = 150.0
    two_mu = 2 * ELASTIC["lame_mu"]
    overlay = Overlay([two_mu / (two_mu + hardening)], [1.25])
    layered = Material(**ELASTIC, yield_stress=1.25, overlay=overlay)
    plain = Material.kinematic(**ELASTIC, yield_stress=1.25, hardening=hardening)
    return layered, plain


P_0 = CF((2e-4, 1e-4, 0, 1e-4, -3e-4, 0, 0, 0, 1e-4), dims=(3, 3))
CASES = {
    "plane strain": {"kinematics": "plane strain", "initial_strain": 2e-4},
    "plane stress": {"kinematics": "plane stress", "order": 2},
    "axisymmetric": {"kinematics": "axisymmetric", "initial_plastic_strain": P_0},
    "friction": {"friction": Coulomb(0.3), "order": 1},
}


def pressed(material, **data):
    mesh = block.structured_mesh(4, 4, simplices=True)
    given = {"traction": {"right": (1.5, 0.8)}, "contact": "contact", "gap": -5e-4}
    return Problem(mesh, material, **given | data)


@pytest.mark.parametrize("case", CASES)
def test_one_sub_element_is_linear_kinematic_hardening(case):
    """The same displacements through a history, by two different laws."""
    runs = []
    for material in kinematic_twins():
        problem = pressed(material, **CASES[case])
        steps = load_cycle(problem, [1, -0.7, 0.4], steps=2)
        runs.append(evolve(problem, steps).raise_for_status())
    for one, other in zip(*(run.steps for run in runs), strict=True):
        ours, theirs = (
            step.fields.displacement.vec.FV().NumPy() for step in (one, other)
        )
        assert np.abs(ours - theirs).max() < 1e-8 * np.abs(theirs).max()
        points = Points(one.problem.mesh, one.problem.kinematics, one.problem.order)
        scale = np.abs(points.at(other.fields.back_stress)).max()
        for name in ("back_stress", "plastic_strain"):
            mine, other_one = (
                points.at(getattr(step.fields, name)) for step in (one, other)
            )
            size = np.abs(other_one).max() or scale
            moduli = 2 * ELASTIC["lame_mu"]
            rounding = 1e-11 * moduli / (size if name == "back_stress" else 1.0)
            assert np.abs(mine - other_one).max() < (1e-6 + rounding) * size + 1e-12


def solid(material):
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    return Problem(mesh, material, traction={"right": (1.5, 0.4, 0.3)}, order=1)


def two_bodies(material):
    held = {"top": (0.0, -3e-3), "clamped": (0.0, 0.0)}
    return Problem(
        stacked_blocks(2, 0.4),
        material,
        clamped=None,
        contact=Contact("above", "below"),
        prescribed=held,
        friction=0.2,
    )


LAYERED = Material(
    **ELASTIC, yield_stress=0.8, overlay=Overlay([0.5, 0.3, 0.1], [0.8, 1.6, 3.0])
)


@pytest.mark.parametrize("make", [pressed, solid, two_bodies])
def test_certificate_and_newton_steps(make):
    """-J* is J, also in later steps; few Newton steps; nothing is beyond a yield surface."""
    problem = make(LAYERED)
    result = semismooth_newton(problem).raise_for_status()
    assert result.iterations <= 15
    assert result.state.at.yields.any()
    energy = result.primal_energy
    assert energy + result.dual_energy == pytest.approx(0, abs=1e-10 * abs(energy))

    factors = load_cycle(problem, [1, -1], steps=2)
    run = evolve(problem, factors).raise_for_status()
    assert max(run.column("iterations")) <= 15
    last = run.steps[-1]
    energy = last.solution.primal_energy
    assert energy + last.solution.dual_energy == pytest.approx(
        0, abs=1e-9 * abs(energy)
    )
    points = run.memory.functions.points
    assert points.at(last.fields.yield_function).max() < 1e-9


def test_stress_and_moduli_are_derivatives_of_the_energy():
    """Differences of the energy at random strains, after a random history."""
    random = np.random.default_rng(5)
    problem = Problem(block.structured_mesh(2, 2, simplices=True), LAYERED)
    points = Points(problem.mesh, problem.kinematics, 1)
    law = law_of(problem, points)
    count, d = len(points), problem.kinematics.d
    law.start_parts(1e-3 * random.standard_normal((count, len(law.parts) * d)))
    e = 3e-3 * random.standard_normal((count, d))
    volume = 1e-3 * random.standard_normal(count)
    at = law.returned(volume, e)
    mean, stress = law.stress(at)
    moduli = law.moduli(at, law.yielding_part(at))
    change = random.standard_normal((count, d))
    step = 1e-7

    def there(k):
        return law.returned(volume, e + k * step * change)

    slope = (law.energy_density(there(1)) - law.energy_density(there(-1))) / (2 * step)
    expected = np.einsum("pd,pd->p", stress, change)
    assert slope == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert mean == pytest.approx(law.bulk * volume)
    slopes = (law.stress(there(1))[1] - law.stress(there(-1))[1]) / (2 * step)
    assert moduli(change) == pytest.approx(slopes, rel=1e-5, abs=1e-3)

    conjugate = law.complementary_density(mean, stress)
    work = mean * volume + np.einsum("pd,pd->p", stress, e)
    assert law.energy_density(at) + conjugate == pytest.approx(work, rel=1e-10)
    other = law.complementary_density(mean, stress + 0.05)
    apart = work + 0.05 * e.sum(axis=1) - law.energy_density(at) - other
    assert (apart <= 1e-12).all()


def test_a_history_goes_on_from_what_is_kept(tmp_path):
    """From a checkpoint as without a stop; and from the memory of another run."""
    problem = pressed(LAYERED)
    steps = load_cycle(problem, [1, -1], steps=2)
    whole = evolve(problem, steps)
    stop = []

    def once(step):
        stop.append(step)
        if len(stop) == 2:
            raise StopIteration

    evolve(problem, steps, checkpoint=tmp_path / "run.npz", monitor=once)
    resumed = evolve(problem, steps, checkpoint=tmp_path / "run.npz")
    assert len(resumed.steps) == 4
    assert resumed.column("primal_energy") == pytest.approx(
        whole.column("primal_energy"), rel=1e-9
    )


def test_it_prints_as_given_and_refuses_by_name():
    assert repr(STEEL).startswith("Material.cyclic(young=200000.0, poisson=0.3, curve=")
    assert STEEL.tensile_yield_stress == pytest.approx(200.0)
    with pytest.raises(ValueError, match="bends upwards at the stress 300"):
        Material.cyclic(
            young=YOUNG, poisson=0.3, curve=[(0.001, 200), (0.01, 300), (0.011, 400)]
        )
    with pytest.raises(ValueError, match="two are needed"):
        Material.cyclic(young=YOUNG, poisson=0.3, curve=[(0.001, 200)])
    with pytest.raises(ValueError, match="a sum of at most 1"):
        Overlay([0.7, 0.6], [1.0, 2.0])
    with pytest.raises(ValueError, match="increasing"):
        Overlay([0.2, 0.2], [2.0, 1.0])
    with pytest.raises(ValueError, match=r"hardening=3\.0 with overlay"):
        pressed(replace(LAYERED, hardening=3.0))
    with pytest.raises(ValueError, match="the first bound"):
        pressed(replace(LAYERED, yield_stress=1.0))
    with pytest.raises(ValueError, match="two-dimensional"):
        pressed(LAYERED, kinematics="two-dimensional")
    with pytest.raises(ValueError, match="initial_hardening"):
        pressed(LAYERED, initial_hardening=0.1)
