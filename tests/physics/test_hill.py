"""Hill's ellipsoid against closed forms: R-values and yield stresses along directions."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, x

from ngepc import Hill, Material, Norton, Problem, Voce, evolve, semismooth_newton
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.geometries import block
from ngepc.sensitivity.gradient import gradient

ELASTIC = {"lame_lambda": 500.0, "lame_mu": 400.0}
R_VALUES = (1.8, 1.2, 2.3)
YIELD = 1.0
OVER = 1 + 1e-6  # of the yield stress, where the direction of the flow is looked at
ANISOTROPIC = Hill.r_values(*R_VALUES)


def material(hill, hardening=5.0):
    return Material(
        **ELASTIC, yield_stress=np.sqrt(2 / 3) * YIELD, hardening=hardening, hill=hill
    )


def pulled(hill, tension, n=1, **data):
    """A square pulled along x, at an angle to the axes of the material."""
    mesh = block.structured_mesh(n, n, size=(1.0, 1.0), simplices=True)
    held = {"left": (0, None), "clamped": (None, 0)}
    given = {"clamped": None, "prescribed": held, "traction": {"right": (tension, 0.0)}}
    return Problem(
        mesh, material(hill), **given | {"kinematics": "plane stress"} | data
    )


def turned(angle):
    return Hill.r_values(*R_VALUES, angle=angle)


def yield_stress_at(angle):
    """Of a bar: 1 = F sin^4 + G cos^4 + H cos^2 2 angle + 2 N sin^2 cos^2, times its square."""
    sine, cosine = np.sin(angle) ** 2, np.cos(angle) ** 2
    h = ANISOTROPIC
    square = h.F * sine**2 + h.G * cosine**2 + h.H * (cosine - sine) ** 2
    return YIELD / np.sqrt(square + 2 * h.N * sine * cosine)


ANGLES = {"rolling": 0.0, "diagonal": np.pi / 4, "transverse": np.pi / 2}


@pytest.mark.parametrize("case", range(3))
def test_r_values_and_directional_yield_stresses(case):
    """A little above the yield stress the plastic strains have the ratio that was given.

    The axes of the sheet do not shear only where they are those of the pull: at 45 degrees the
    shear is free, the sheet is pulled without a support against it.
    """
    angle = list(ANGLES.values())[case]
    stress = yield_stress_at(angle)
    below = semismooth_newton(pulled(turned(-angle), 0.999 * stress))
    assert below.plastic_increment.vec.Norm() == 0
    problem = pulled(turned(-angle), (1 + 1e-7) * stress)
    at = one_point(turned(-angle), stress)
    p = at["plastic"]
    assert p[1, 1] / p[2, 2] == pytest.approx(R_VALUES[case], rel=1e-5)
    if case != 1:  # elsewhere the sides shear
        above = semismooth_newton(problem)
        strain = np.array(above.plastic_strain(problem.mesh(0.3, 0.3))).reshape(3, 3)
        assert strain[1, 1] / strain[2, 2] == pytest.approx(R_VALUES[case], rel=1e-4)


def one_point(hill, tension):
    """The direction of the flow under a tension along x, from the normal of the law."""
    mesh = block.structured_mesh(1, 1, size=(1.0, 1.0), simplices=True)
    problem = Problem(mesh, material(hill), kinematics="plane strain")
    points = Points(mesh, problem.kinematics, 1)
    law = law_of(problem, points)
    basis = problem.kinematics.basis
    stress = np.einsum("dij,ij->d", basis, np.diag([tension, 0.0, 0.0]))
    s = np.tile(OVER * stress, (len(points), 1))
    at = law.returned(np.zeros(len(points)), s / law.two_mu[:, None])
    assert at.yields.all()
    assert at.size == pytest.approx(OVER * np.sqrt(2 / 3) * YIELD)
    return {"plastic": np.tensordot(at.plastic_strain[0], basis, axes=1)}


def test_the_isotropic_ellipsoid_is_von_mises():
    """Same steps' end, strains and energies; both kinematics and a solid."""
    for kinematics in ("plane stress", "plane strain", "axisymmetric"):
        one = semismooth_newton(pulled(Hill(), 1.4, 3, kinematics=kinematics))
        other = semismooth_newton(pulled(None, 1.4, 3, kinematics=kinematics))
        scale = np.abs(other.state.u).max()
        assert np.abs(one.state.u - other.state.u).max() < 1e-9 * scale
        assert one.primal_energy == pytest.approx(other.primal_energy, rel=1e-11)


def solid(hill, **data):
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    traction = {"right": (1.2, 0.2, 0.3)}
    return Problem(mesh, material(hill), traction=traction, order=1, **data)


@pytest.mark.parametrize("make", [lambda h: pulled(h, 1.3, 4), solid])
def test_certificate_contact_and_gradients(make):
    """-J* is J, few Newton steps, and derivatives agree with differences."""
    hill = Hill.yield_ratios(r_11=1.2, r_22=0.9, r_12=0.8, angle=0.3 * (1 + x))
    problem = make(hill)
    result = semismooth_newton(problem).raise_for_status()
    assert result.plastic_increment.vec.Norm() > 0
    assert result.iterations <= 15
    energy = result.primal_energy
    assert energy + result.dual_energy == pytest.approx(0, abs=1e-10 * abs(energy))
    found = gradient(result, "elastic_energy", ["yield_stress", "hardening", "lame_mu"])

    for name, slope in found.items():
        given = getattr(problem.material, name)
        values = []
        for step in (-1e-4 * given, 1e-4 * given):
            data = {n: getattr(problem.material, n) for n in (*ELASTIC, *found)}
            other = Material(**data | {name: given + step}, hill=hill)
            again = semismooth_newton(problem.changed(material=other))
            values.append(gradient(again, "elastic_energy", [name]).functional)
        difference = (values[1] - values[0]) / (2e-4 * given)
        assert slope == pytest.approx(difference, rel=1e-4, abs=1e-9)


VOCE = Material.with_law(**ELASTIC, law=Voce(YIELD, 0.5, 40.0), hardening=2.0)
GROWING = {
    "linear": replace(
        material(None, 1.0), hardening_modulus=0.5, hardening_stiffness=30.0
    ),
    "law": VOCE,
    "rate": replace(VOCE, rate=Norton(1.0, 3.0)),
}
"""Materials whose yield surface grows."""

TO_AND_FRO = [(t, {"traction": {"right": (f, 0.0)}}) for t, f in ((1, 1.2), (2, -1.25))]


@pytest.mark.parametrize("name", GROWING)
def test_an_ellipsoid_that_grows(name):
    """With Hill's values for von Mises it is the sphere, also of a history; both have no gap."""
    found = []
    for hill in (None, Hill(), turned(0.4)):
        grows = replace(GROWING[name], hill=hill)
        problem = replace(pulled(None, 1.2, 2), material=grows, duration=1.0)
        found.append(evolve(problem, TO_AND_FRO).raise_for_status())
        points = Points(problem.mesh, problem.kinematics, problem.order)
        for step in found[-1].steps:
            if name != "rate":
                assert points.at(step.fields.yield_function).max() < 1e-8
            peeq = points.at(step.fields.accumulated_plastic_strain)
        carried = found[-1].memory.arrays["accumulated"]
        assert peeq == pytest.approx(carried, rel=1e-9)
    sphere, same, _ = (run.steps[-1].fields.displacement.vec.FV() for run in found)
    scale = np.abs(sphere.NumPy()).max()
    assert np.abs(sphere.NumPy() - same.NumPy()).max() < 1e-8 * scale
    result = semismooth_newton(problem).raise_for_status()
    energy = result.primal_energy
    assert energy + result.dual_energy == pytest.approx(0, abs=1e-9 * abs(energy))


def test_histories_and_the_yield_function():
    problem = pulled(turned(0.4), 1.3, 2)
    steps = [(t, {"traction": {"right": (f, 0.0)}}) for t, f in ((1, 1.3), (2, -1.4))]
    run = evolve(problem, steps).raise_for_status()
    points = Points(problem.mesh, problem.kinematics, problem.order)
    for step in run.steps:
        value = points.at(step.fields.yield_function)
        assert np.abs(value).max() < 1e-8


def test_what_is_refused():
    with pytest.raises(ValueError, match="two-dimensional"):
        pulled(Hill(), 1.0, kinematics="two-dimensional")
    with pytest.raises(ValueError, match="S\\^2 > 0"):
        pulled(Hill(F=-1.0), 1.0)
    with pytest.raises(ValueError, match="r_45=-1"):
        Hill.r_values(1.0, -1.0, 1.0)
    with pytest.raises(ValueError, match="angle=30: radians"):
        Hill.r_values(1.0, 1.0, 1.0, angle=30.0)
    with pytest.raises(ValueError, match="finite"):
        pulled(Hill(angle=CF(1.0) / (x - x)), 1.0)


def test_a_point_without_stress_yields_nothing_beside_one_that_yields():
    problem = pulled(ANISOTROPIC, 1.5 * YIELD)
    points = Points(problem.mesh, problem.kinematics, problem.order)
    law = law_of(problem, points)
    d = problem.kinematics.d
    s = np.zeros((len(points), d))
    s[1:, 0] = 3 * YIELD
    with np.errstate(all="raise"):
        gained = law.gained_at(s, np.full(len(points), 800.0))
    assert gained[0] == 0
    assert (gained[1:] > 0).all()
