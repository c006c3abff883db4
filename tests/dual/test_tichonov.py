"""The Slobodeckij integral against closed forms; the Tichonov choices on problems."""

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import BND, CF, Integrate, ds
from scipy.integrate import dblquad, quad

from ngepc import (
    Coupled,
    DualSpaces,
    Material,
    NewtonOptions,
    Status,
    Units,
    lshape_problem,
    semismooth_newton,
)
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.fractional import slobodeckij_matrix
from ngepc.dual.tichonov import (
    ContactGradient,
    ContactSobolev,
    Fractional,
    FullProduct,
    PlasticGradient,
    PlasticSobolev,
    SurfaceGradient,
)
from ngepc.geometries import block, lshape, ring

QUICK = NewtonOptions(quadrature_points=49)

CHOICES = {
    "R1": Fractional(),
    "R2": SurfaceGradient(),
    "full": FullProduct(),
    "R1, q free": Fractional(plastic=PlasticSobolev()),
    "full, z fixed": FullProduct(contact=ContactGradient()),
    "full, q fixed": FullProduct(plastic=PlasticGradient()),
}


def chain(points, *, closed=False):
    """Vertices and segments of a polygonal curve."""
    n = np.arange(len(points))
    segments = np.column_stack([n, np.roll(n, -1)])
    return np.asarray(points, float), segments if closed else segments[:-1]


def seminorm_squared(curve, z):
    return z @ slobodeckij_matrix(*curve) @ z


def interval(x):
    return chain(np.column_stack([x, 0 * x]))


def zigzag(count=12, seed=3):
    """A curve with acute, right and obtuse corners and lengths that differ by factors."""
    random = np.random.default_rng(seed)
    angles = np.cumsum(random.uniform(-1.2, 1.2, count))
    steps = random.uniform(0.2, 2.0, count)[:, None] * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    return np.cumsum(steps, axis=0)


def test_affine_function_on_any_partition():
    """|x|^2 = L^2 on (0, L): the quotient is 1."""
    x = 3.0 * np.sort(np.r_[0.0, np.random.default_rng(1).random(30), 1.0])
    assert seminorm_squared(interval(x), x) == pytest.approx(9.0, rel=1e-12)


def test_quadratic_function():
    """|x^2|^2 = int int (x + y)^2 = 7/6 on (0, 1); its P1 interpolant, with order about 3.8."""
    errors = []
    for n in (10, 20, 40):
        x = np.linspace(0, 1, n + 1)
        errors.append(abs(seminorm_squared(interval(x), x**2) - 7 / 6))
    assert errors[-1] < 2e-7
    assert np.log2(errors[0] / errors[1]) > 3.5
    assert np.log2(errors[1] / errors[2]) > 3.5


@pytest.mark.parametrize("k", [1, 2, 3])
def test_fourier_modes_on_the_circle(k):
    """|cos(k .)|^2 = 2 pi^2 k on a circle of any radius, with order 2 on inscribed polygons."""
    errors = []
    for n in (32, 64, 128):
        angle = 2 * np.pi * np.arange(n) / n
        circle = chain(5 * np.column_stack([np.cos(angle), np.sin(angle)]), closed=True)
        errors.append(abs(seminorm_squared(circle, np.cos(k * angle)) / (2 * np.pi**2 * k) - 1))
    assert errors[-1] < 4e-4 * k**2
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize("angle", [10, 60, 90, 150, 179.99999, 180, 200, 330])
@pytest.mark.parametrize("ratio", [1.0, 0.05])
def test_corner_against_numerical_integration(angle, ratio):
    """Two segments with a common vertex, by Duffy's substitution and adaptive quadrature."""
    a = np.array([1.0, 0.0])
    b = ratio * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    z = np.array([1.0, 0.2, -0.7])  # at a, 0, b
    value = seminorm_squared(chain([a, (0, 0), b]), z)

    def quotient(s, t):
        return (s * (z[0] - z[1]) - t * (z[2] - z[1])) ** 2 / ((s * a - t * b) @ (s * a - t * b))

    peak = min(1.0, max(0.0, np.cos(np.radians(angle)) * ratio))
    halves = quad(lambda t: quotient(1, t), 0, 1, epsabs=1e-13, epsrel=1e-12, points=[0.5])[0]
    halves += quad(lambda s: quotient(s, 1), 0, 1, epsabs=1e-13, epsrel=1e-12, points=[peak])[0]
    expected = (z[0] - z[1]) ** 2 + (z[2] - z[1]) ** 2 + ratio * halves
    assert value == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("distance", [1.0, 0.1, 0.01])
def test_disjoint_segments_against_numerical_integration(distance):
    x = np.array([(0.0, 0.0), (1.0, 0.0), (1.0 + distance, 0.0), (2.0, 0.5)])
    z = np.array([0.2, 1.0, -0.7, 0.3])
    size = np.linalg.norm(x[3] - x[2])

    def quotient(t, s):
        d = (1 - s) * x[0] + s * x[1] - (1 - t) * x[2] - t * x[3]
        return size * ((1 - s) * z[0] + s * z[1] - (1 - t) * z[2] - t * z[3]) ** 2 / (d @ d)

    both = 2 * dblquad(quotient, 0, 1, 0, 1, epsabs=1e-9, epsrel=1e-9)[0]
    expected = (z[1] - z[0]) ** 2 + (z[3] - z[2]) ** 2 + both
    value = z @ slobodeckij_matrix(x, np.array([[0, 1], [2, 3]])) @ z
    assert value == pytest.approx(expected, rel=1e-8)


def test_refinement_does_not_change_a_function():
    """The same P1 function on a partition of the curve and on its refinement."""
    x = zigzag()
    z = np.random.default_rng(0).standard_normal(len(x))
    t = np.sort(np.r_[np.arange(len(x)), np.arange(len(x) - 1) + 0.5, np.arange(len(x) - 1) + 0.1])
    fine = np.column_stack([np.interp(t, np.arange(len(x)), column) for column in x.T])
    value = seminorm_squared(chain(fine), np.interp(t, np.arange(len(x)), z))
    assert value == pytest.approx(seminorm_squared(chain(x), z), rel=1e-11)


def test_invariances():
    """Constants, motions, dilations (s = 1/2 in the plane), order and direction of segments."""
    x, segments = chain(zigzag())
    W = slobodeckij_matrix(x, segments)
    assert np.abs(W.sum(axis=1)).max() < 1e-12 * np.abs(W).max()
    assert np.abs(W - W.T).max() < 1e-14 * np.abs(W).max()
    assert np.linalg.eigvalsh(W)[1] > 0  # nothing but constants in the kernel
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = slobodeckij_matrix(7.0 * x @ turn + (3.0, -2.0), segments[::-1, ::-1])
    assert np.abs(moved - W).max() < 1e-11 * np.abs(W).max()


def test_curve_that_touches_itself_is_refused():
    x = np.array([(0, 0), (1, 0), (0, 0), (1, 0)], float)
    with pytest.raises(ValueError, match="touches itself"):
        slobodeckij_matrix(x, np.array([[0, 1], [2, 3]]))


def scaled_problem(stress, length):
    """A pressed square in units where the stress and length units are so many of the plain ones."""
    mesh = block.structured_mesh(6, 6, size=(length, length), simplices=True)
    material = Material.kinematic(
        lame_lambda=1e3 * stress,
        lame_mu=1e3 * stress,
        yield_stress=1.25 * stress,
        hardening=100 * stress,
    )
    push = {"left": (6.0 * stress, 4.0 * stress)}
    return flat_problem(mesh, material, traction=push, contact="contact", gap=-0.002 * length)


@pytest.mark.parametrize("name", CHOICES)
def test_units_of_the_products(name):
    """The same body in other units: V scales as stress length^2, and so do all iterates."""
    plain, scaled = (
        semismooth_newton(
            scaled_problem(stress, length),
            regularisation=Coupled(
                1e3, tichonov=CHOICES[name], units=Units(stress=stress, length=length)
            ),
        )
        for stress, length in ((1.0, 1.0), (1e6, 1e-2))
    )
    assert plain.status is scaled.status is Status.CONVERGED
    assert plain.history.records[-1].plastic_active > 0.01
    assert plain.contact_force > 0.1
    energies = np.array(scaled.history.energies) / (1e6 * 1e-4)
    assert energies == pytest.approx(np.array(plain.history.energies), rel=1e-9)


@pytest.mark.parametrize("name", CHOICES)
def test_lshape_converges_to_one_limit(name):
    """V falls to the limit -J of about 0.375 as gamma grows, whatever the product."""
    problem = lshape_problem(lshape.paper_mesh(225))
    values = []
    result = None
    for gamma in (1e3, 1e4):
        choice = Coupled(gamma, tichonov=CHOICES[name])
        result = semismooth_newton(problem, start=result, options=QUICK, regularisation=choice)
        assert result.status is Status.CONVERGED
        values.append(result.dual_energy)
    assert values[0] > values[1] > 0.37
    at_end = result.normal_stress(problem.mesh(1e-6, 1.0, VOL_or_BND=BND))
    if CHOICES[name].contact.ends_fixed:
        assert at_end == pytest.approx(0.0, abs=1e-3)
    else:
        assert at_end < -1.0  # the pressure peaks at this end of Gamma_c


def test_fractional_product_is_closer_to_the_limit():
    """Half a derivative less and free ends: at one gamma V is lower than with R2."""
    problem = lshape_problem(lshape.paper_mesh(417))
    R1, R2 = (
        semismooth_newton(problem, regularisation=Coupled(1e3, tichonov=choice)).dual_energy
        for choice in (Fractional(), SurfaceGradient())
    )
    assert R1 < 0.8 * R2


def pressed_ring(maxh):
    """A ring held inside whose outer circle, of radius 2, is pushed in by 0.01; elastic."""
    material = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=1e3, hardening=100.0)
    mesh = ring.mesh(maxh)
    return flat_problem(mesh, material, clamped="inner", contact="outer", gap=-0.01)


LAME_PRESSURE = -0.01 * 4500 / 1.5
"""u_r = A (r - 1/r) has sigma_rr(2) = (2 (lambda + mu) + 2 mu / 4) A = 4500 A, u_r(2) = 1.5 A."""


@pytest.mark.parametrize(
    ("choice", "error", "rate"),
    [(FullProduct(), 0.003, 1.5), (Fractional(), 0.013, 0.5)],
    ids=["full", "R1"],
)
def test_closed_contact_boundary(choice, error, rate):
    """The constant pressure of Lamé's ring; q = 0 on the boundary costs (R1) an order."""
    errors = []
    for maxh in (0.4, 0.2):
        problem = pressed_ring(maxh)
        result = semismooth_newton(problem, regularisation=Coupled(1e7, tichonov=choice))
        assert result.status is Status.CONVERGED
        force, length = (
            Integrate(f * ds("outer"), problem.mesh) for f in (result.normal_stress, CF(1.0))
        )
        errors.append(abs(force / length / LAME_PRESSURE - 1))
    assert errors[1] < error
    assert np.log2(errors[0] / errors[1]) > rate


@pytest.mark.parametrize("choice", [Fractional(), FullProduct()], ids=["R1", "full"])
def test_constants_have_the_length_term_alone(choice):
    """<B_z 1, 1> = |Gamma_c| / L on a closed boundary."""
    problem = pressed_ring(0.5)
    units = Units(length=3.0)
    blocks = LinearBlocks(problem, DualSpaces(tichonov=choice, units=units), "sparsecholesky")
    B = blocks.B["contact"]
    one = B.CreateColVector()
    one[:] = 1.0
    length = Integrate(CF(1.0) * ds("outer"), problem.mesh)
    assert one.InnerProduct((B * one).Evaluate()) == pytest.approx(length / 3.0, rel=1e-12)


def test_closed_contact_boundary_is_refused_by_the_seminorm():
    with pytest.raises(ValueError, match=r"closed piece without ends.*Fractional"):
        semismooth_newton(pressed_ring(0.5), 100.0)


def test_one_closed_piece_is_enough_to_be_refused():
    mesh = block.with_hole(0.3, size=(1.0, 1.0))
    problem = flat_problem(mesh, pressed_ring(0.5).material, contact="contact|hole", gap=0.0)
    with pytest.raises(ValueError, match="closed piece without ends"):
        semismooth_newton(problem, 100.0)


def test_fractional_product_on_a_surface_is_refused():
    mesh = block.structured_mesh(1, 1, 1, simplices=True)
    material = Material.kinematic(lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=1.0)
    problem = flat_problem(mesh, material, contact="contact", gap=0.0)
    with pytest.raises(ValueError, match="two dimensions"):
        LinearBlocks(problem, Coupled(1.0, tichonov=Fractional()), "sparsecholesky")


def test_products_are_positive_definite():
    for choice in (Fractional(), FullProduct(), Fractional(contact=ContactSobolev())):
        blocks = LinearBlocks(pressed_ring(0.6), DualSpaces(tichonov=choice), "sparsecholesky")
        for name, part in blocks.parts.items():
            B, B_inverse, space = blocks.B[name], blocks.B_inverse[name], part.space
            v, w = B.CreateColVector(), B.CreateColVector()
            free = np.array(space.FreeDofs())
            v.FV().NumPy()[:] = np.random.default_rng(1).standard_normal(len(v)) * free
            Bv = (B * v).Evaluate()
            w.data = B_inverse * Bv - v
            assert w.Norm() < 1e-9 * v.Norm()
            assert v.InnerProduct(Bv) > 0
