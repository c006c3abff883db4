"""Materials that change with the temperature from step to step; Bree's plate by closed forms."""

import numpy as np
import pytest
from ngsolve import x
from ngsolve.meshes import MakeStructured2DMesh

from ngepc import Hill, Material, Problem, Schedule, Voce, evolve, gradient
from ngepc.geometries import block

POISSON = 0.3
EXPANSION = 1.2e-5


def young(T):
    return 200e3 - 80.0 * T


def yield_stress(T):
    return 300.0 - 0.25 * T


def modulus(T):
    return 4000.0 - 3.0 * T


def metal(T, kind="isotropic", **share):
    return Material.metal(
        young=young(T),
        poisson=POISSON,
        yield_stress=yield_stress(T),
        plastic_modulus=modulus(T),
        kind=kind,
        **share,
    )


def bar(material, **data):
    """A bar of length 2 whose state is uniform."""
    held = {"left": (0, None), "clamped": (None, 0)}
    given = {"clamped": None, "prescribed": held, "kinematics": "plane stress"}
    mesh = block.structured_mesh(2, 1, size=(2.0, 1.0), simplices=True)
    return Problem(mesh, material, **given | data)


def through(path, make=metal, **data):
    """Strains at the ends of steps to pairs (stress, temperature)."""
    problem = bar(make(0.0), traction={"right": (1.0, 0.0)})
    steps = [
        (
            float(number),
            {
                "traction": {"right": (stress, 0.0)},
                "material": make(T),
                "initial_strain": EXPANSION * T,
            },
        )
        for number, (stress, T) in enumerate(path, start=1)
    ]
    run = evolve(problem, steps).raise_for_status()
    place = problem.mesh(1.0, 0.5)
    return np.array([step.fields.displacement(place)[0] for step in run.steps]), run


PATH = [(360.0, 0.0), (360.0, 400.0), (360.0, 0.0), (0.0, 0.0), (-330.0, 200.0)]
"""Pulled cold, heated, cooled, unloaded, pushed warm."""


def flow(kind, x, T, share=None):
    """(radius, centre) of the elastic range of a bar at the plastic strain x, first way out."""
    share = {"isotropic": 0.0, "kinematic": 1.0}.get(kind, share)
    hardened = modulus(T) * x
    return yield_stress(T) + (1 - share) * hardened, share * hardened


@pytest.mark.parametrize("kind", ["isotropic", "kinematic", "mixed"])
def test_a_bar_with_a_yield_stress_that_falls_with_the_temperature(kind):
    """The plastic strain stays when the bar cools; hardening is that of the strain by now."""
    share = {"kinematic_share": 0.6} if kind == "mixed" else {}
    found, run = through(PATH, lambda T: metal(T, kind, **share))
    s = share.get("kinematic_share", float(kind == "kinematic"))

    plastic = peeq = 0.0
    expected = []
    for stress, T in PATH:
        radius = yield_stress(T) + (1 - s) * modulus(T) * peeq
        relative = stress - s * modulus(T) * plastic
        gained = max(abs(relative) - radius, 0.0) / modulus(T)
        plastic += np.sign(relative) * gained
        peeq += gained
        expected.append(stress / young(T) + plastic + EXPANSION * T)
    assert found == pytest.approx(np.array(expected), rel=1e-9, abs=1e-14)
    peeq_found = run.steps[-1].fields.accumulated_plastic_strain
    assert peeq_found(run.problem.mesh(0.7, 0.4)) == pytest.approx(peeq, rel=1e-9)
    gaps = [
        step.solution.primal_energy + step.solution.dual_energy for step in run.steps
    ]
    assert np.abs(gaps).max() < 1e-9 * run.column("elastic_energy")[0]


def test_a_law_of_hardening_at_a_temperature():
    """R(PEEQ, T) of Voce with data that depend on the temperature."""

    def law(T):
        return Voce(yield_stress(T), 200.0 - 0.2 * T, 30.0)

    def material(T):
        lam = young(T) * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
        mu = young(T) / (2 * (1 + POISSON))
        return Material.with_law(lame_lambda=lam, lame_mu=mu, law=law(T))

    _, run = through([(360.0, 0.0), (360.0, 300.0)], material)
    peeq = run.steps[-1].fields.accumulated_plastic_strain
    value = peeq(run.problem.mesh(0.7, 0.4))
    assert law(300.0).stress(value) == pytest.approx(360.0, rel=1e-9)


def test_sub_elements_keep_their_plastic_strains():
    """Pulled cold and heated without load: sub-elements stay apart, the bar follows their sum."""

    def cyclic(T):
        part = 1 - T / 1000
        curve = [(0.001, 200.0), (0.003, 300.0), (0.01, 380.0)]
        curve = [(strain, part * stress) for strain, stress in curve]
        return Material.cyclic(young=200e3 * part, poisson=POISSON, curve=curve)

    found, _ = through([(340.0, 0.0), (340.0, 100.0), (340.0, 0.0)], cyclic)
    strain = 0.003 + (340.0 - 300.0) / 80.0 * 0.007
    assert found[0] == pytest.approx(strain, rel=1e-9)
    hot = 0.003 + (340.0 / 0.9 - 300.0) / 80.0 * 0.007  # the curve in stress / part
    assert found[1] == pytest.approx(hot + 100 * EXPANSION, rel=1e-9)
    # cooled at the same stress the sub-elements go back along the elastic line
    assert found[2] > found[0]


def test_a_clamped_bar_that_is_heated():
    """sigma = E (0 - alpha T - p); it yields where that reaches R(T), and is pulled when cold."""
    problem = bar(
        metal(0.0),
        prescribed={"left": (0, None), "right": (0, None), "clamped": (None, 0)},
    )
    temperatures = [100.0, 200.0, 300.0, 150.0, 0.0]
    steps = [
        (float(k), {"material": metal(T), "initial_strain": EXPANSION * T})
        for k, T in enumerate(temperatures, start=1)
    ]
    run = evolve(problem, steps).raise_for_status()
    plastic = peeq = 0.0
    for step, T in zip(run.steps, temperatures, strict=True):
        trial = young(T) * (-EXPANSION * T - plastic)
        over = abs(trial) - yield_stress(T) - modulus(T) * peeq
        gained = max(over, 0.0) / (young(T) + modulus(T))
        plastic += np.sign(trial) * gained
        peeq += gained
        stress = young(T) * (-EXPANSION * T - plastic)
        found = step.fields.stress(problem.mesh(1.2, 0.6))[0]
        assert found == pytest.approx(stress, rel=1e-8)
    assert peeq > 0
    assert stress > 0


# Bree's plate: constant tension, and a temperature that comes and goes across the thickness

E = 1000.0
R = 1.0
RADIUS = 1000.0
LOW = 0.02


def bree_ring(X):
    """A thin wide ring: the strain along it is uniform across its wall, and nothing else resists.

    The wall of thickness 1 carries the tension X R by a pressure inside; it does not harden.
    """
    material = Material.metal(
        young=E, poisson=POISSON, yield_stress=R, plastic_modulus=0.0
    )
    mesh = MakeStructured2DMesh(
        nx=CELLS, ny=1, mapping=lambda xi, eta: (RADIUS + xi, LOW * eta)
    )
    return Problem(
        mesh,
        material,
        clamped=None,
        prescribed={"bottom": (None, 0)},
        pressure={"left": X * R / RADIUS},
        kinematics="axisymmetric",
    )


CELLS = 24


def bree_cycles(X, Y, cycles):
    """Elongations over R/E at the ends of cycles, and what each of them dissipates."""
    problem = bree_ring(X)
    hot = 2 * Y * R / E * (0.5 - (x - RADIUS))  # E alpha T = Y R at the surfaces

    def changes(time):
        heat = abs((time + 1) % 2 - 1)
        return {"initial_strain": heat * hot}

    times = tuple(0.5 * k for k in range(1, 4 * cycles + 1))
    run = evolve(problem, Schedule(times, changes)).raise_for_status()
    place = problem.mesh(RADIUS + 0.5, 0.5 * LOW)
    radial = np.array([step.fields.displacement(place)[0] for step in run.steps])
    strain = radial / (RADIUS + 0.5) * E / R
    lost = np.reshape(run.column("dissipation"), (cycles, 4)).sum(axis=1)
    return strain[3::4], lost


def test_bree_elastic():
    """X + Y < 1: no plastic strains."""
    _, lost = bree_cycles(0.3, 0.5, 2)
    assert lost.tolist() == [0.0, 0.0]


def test_bree_shakedown():
    """X + Y > 1, X + Y/4 < 1, Y < 2: plastic strains of the first cycle only."""
    _, lost = bree_cycles(0.3, 1.2, 3)
    assert lost[0] > 0
    assert lost[-1] < 1e-3 * lost[0]


def test_bree_alternating_plasticity():
    """Y > 2, X Y < 1: the same plastic strains in each cycle, Y (1 - 2/Y)^2 R/E, and no growth."""
    Y = 3.0
    strain, lost = bree_cycles(0.2, Y, 4)
    area = 2 * np.pi * (RADIUS + 0.5) * LOW
    assert lost[-1] == pytest.approx(area * R * R / E * Y * (1 - 2 / Y) ** 2, rel=0.02)
    assert abs(strain[-1] - strain[-2]) < 1e-3 * Y


@pytest.mark.parametrize(("X", "Y"), [(0.8, 1.5), (0.9, 1.0)])
def test_bree_ratcheting(X, Y):
    """X + Y/4 > 1: the plate grows in each cycle by 2 Y (1 - 2 ((1 - X)/Y)^(1/2)) R/E."""
    strain, _ = bree_cycles(X, Y, 4)
    growth = 2 * Y * (1 - 2 * np.sqrt((1 - X) / Y))
    assert strain[-1] - strain[-2] == pytest.approx(growth, rel=0.02)


def test_bree_ratcheting_where_the_core_yields_both_ways():
    """X Y > 1 and Y (1 - X) > 1: by 2 (X Y - 1) R/E."""
    X, Y = 0.4, 3.5
    strain, _ = bree_cycles(X, Y, 4)
    assert strain[-1] - strain[-2] == pytest.approx(2 * (X * Y - 1), rel=0.02)


def test_what_is_refused():
    problem = bar(metal(0.0), traction={"right": (330.0, 0.0)})

    def to(material):
        return evolve(problem, [(1.0, {}), (2.0, {"material": material})])

    with pytest.raises(ValueError, match="hardening is zero in one of two"):
        to(metal(0.0, "kinematic"))
    with pytest.raises(ValueError, match="law like that of the problem"):
        to(
            Material.metal(
                young=1e3, poisson=0.3, yield_stress=1.0, plastic_modulus=0.0
            )
        )
    lam = {"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": 1.0, "hardening": 1.0}
    with pytest.raises(ValueError, match="hill like that of the problem"):
        to(Material(**lam, hill=Hill()))
    run = to(metal(100.0))
    with pytest.raises(ValueError, match=r"material of step 2 .* one material"):
        gradient(run, "elastic_energy", ["yield_stress"])
