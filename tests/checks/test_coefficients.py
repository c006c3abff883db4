"""Functions of other meshes, and parts of coefficients: what is found, rebuilt and refused."""

import numpy as np
import pytest
from bodies import STEEL
from netgen.occ import Circle, OCCGeometry, Rectangle
from ngsolve import (
    BND,
    CF,
    H1,
    L2,
    Det,
    GridFunction,
    IfPos,
    Inv,
    Mesh,
    Parameter,
    Trace,
    exp,
    grad,
    specialcf,
    sqrt,
    x,
    y,
)
from ngsolve.fem import CacheCF

from ngepc import Fields, Material, Point, Problem, semismooth_newton
from ngepc.checks.arguments import points_beyond, sample
from ngepc.checks.coefficients import (
    PARAMETER,
    as_constant,
    leaves_of,
    rebuilt,
    with_numbers,
    with_own_functions,
)
from ngepc.geometries import block

SQUARE = block.structured_mesh(3, 3)
CUBE = block.structured_mesh(2, 2, 2)


def function(mesh, value=0.05, space=H1):
    found = GridFunction(space(mesh))
    found.Set(value)
    return found


def holed():
    """The square without a hole that no vertex and no point of a rule lies in."""
    body = Rectangle(1, 1).Face() - Circle((0.513, 0.487), 0.002).Face()
    return Mesh(OCCGeometry(body, dim=2).GenerateMesh(maxh=0.3))


@pytest.mark.parametrize("number", [0, 1, -2.5, 1e-300, 1e300, 1 / 3])
def test_a_number_as_a_coefficient_is_that_number_to_the_last_bit(number):
    found = as_constant(number)
    assert found(SQUARE(0.3, 0.4)) == number
    assert tuple(found.dims) == ()
    assert not sample(found * x - CF(number) * x, SQUARE).any()


def test_zero_as_a_coefficient_is_left_out_of_products():
    assert str(as_constant(0.0) * x) == str(0 * x)


PARAMETER_OF = {
    "itself": lambda P, g: P,
    "a sum": lambda P, g: 2 * P + g,
    "pieces": lambda P, g: IfPos(x - 0.5, P, P * P),
    "a gradient": lambda P, g: P * grad(g)[0],
    "a region": lambda P, g: SQUARE.MaterialCF({"default": P, ".*": P * x}),
    "compiled": lambda P, g: (P * x + g).Compile(),
    "a vector": lambda P, g: CF((P, 1.0, g)),
    "a matrix": lambda P, g: CF((P, 1.0, 1.0, P), dims=(2, 2)),
    "its trace": lambda P, g: Trace(CF((P, 1.0, 1.0, P), dims=(2, 2))),
    "its inverse": lambda P, g: Inv(CF((P, 1.0, 1.0, P), dims=(2, 2))),
    "its determinant": lambda P, g: Det(CF((P, 1.0, 1.0, P), dims=(2, 2))) * sqrt(P),
    "beside what is sealed": lambda P, g: exp(P) + specialcf.mesh_size,
}


@pytest.mark.parametrize("name", PARAMETER_OF)
def test_a_parameter_becomes_its_number_everywhere(name):
    P = Parameter(3.0)
    value = PARAMETER_OF[name](P, function(SQUARE, x * y))
    own = with_own_functions("load", value)
    assert not [one for one in leaves_of(own, PARAMETER) if isinstance(one, Parameter)]
    assert tuple(own.dims) == tuple(value.dims)
    before = sample(value, SQUARE)
    assert np.array_equal(sample(own, SQUARE), before)
    P.Set(5.0)
    assert np.array_equal(sample(own, SQUARE), before)
    assert not np.array_equal(sample(value, SQUARE), before)


def test_what_has_no_parameter_is_itself():
    value = 2 * x + function(SQUARE)
    assert with_numbers("load", value) is value
    assert rebuilt(value, lambda leaf: leaf) is value


def test_a_function_that_is_set_again_leaves_its_copy():
    g = function(SQUARE, x)
    value = 2 * g + grad(g)[0]
    own = with_own_functions("load", value)
    before = sample(value, SQUARE)
    g.Set(y)
    assert np.array_equal(sample(own, SQUARE), before)


def test_sealed_parts_are_refused():
    with pytest.raises(ValueError, match="load has a Parameter inside a part"):
        with_numbers("load", CacheCF(Parameter(1.0) * x))
    with pytest.raises(ValueError, match="gap has a GridFunction inside a part"):
        Problem(SQUARE, STEEL, contact="contact", gap=CacheCF(function(SQUARE)))


COVERING = {
    "finer": lambda: block.structured_mesh(7, 7),
    "larger": lambda: block.structured_mesh(4, 4, size=(2.0, 2.0)),
    "a copy": lambda: Mesh(SQUARE.ngmesh.Copy()),
}


@pytest.mark.parametrize("name", COVERING)
@pytest.mark.parametrize("space", [H1, L2])
def test_a_mesh_that_covers_the_body_is_accepted(name, space):
    """A constant is the same on every mesh: the digits of the number."""
    other = COVERING[name]()
    soft = {"lame_mu": 1e3, "yield_stress": 1.25, "hardening": 100.0}
    results = [
        semismooth_newton(
            Problem(
                SQUARE,
                Material.kinematic(lame_lambda=stiff, **soft),
                pressure={"left": 3.0},
                contact="contact",
                gap=gap,
            )
        )
        for stiff, gap in [
            (1e3, 1e-3),
            (function(other, 1e3, space), function(other, 1e-3, space)),
        ]
    ]
    numbers, functions = (result.primal_energy for result in results)
    assert functions == pytest.approx(numbers, rel=1e-11)


MISSING = {
    "half": lambda: block.structured_mesh(4, 4, size=(0.5, 1.0)),
    "a hole between all points": holed,
}


@pytest.mark.parametrize("name", MISSING)
def test_a_mesh_that_misses_a_part_of_the_body_is_refused(name):
    soft = function(MISSING[name](), 1e3)
    metal = {"lame_mu": 1e3, "yield_stress": 1.25, "hardening": 100.0}
    with pytest.raises(
        ValueError, match=r"lame_lambda has a GridFunction of another m"
    ):
        Problem(SQUARE, Material.kinematic(lame_lambda=2 * soft, **metal))
    with pytest.raises(ValueError, match=r"body_force has a .* points of the body"):
        Problem(SQUARE, STEEL, body_force=(0, soft))


def test_a_boundary_needs_only_its_own_points():
    """A strip along the top covers the contact boundary, not the body."""
    strip = Mesh(
        OCCGeometry(Rectangle(1, 0.1).Face().Move((0, 0.9, 0)), dim=2).GenerateMesh(
            maxh=0.1
        )
    )
    gap = function(strip, 0.01)
    given = {"pressure": {"left": 3.0}, "contact": "contact"}
    with_number = semismooth_newton(Problem(SQUARE, STEEL, gap=0.01, **given))
    with_strip = semismooth_newton(Problem(SQUARE, STEEL, gap=gap, **given))
    assert with_strip.primal_energy == pytest.approx(
        with_number.primal_energy, rel=1e-10
    )
    with pytest.raises(ValueError, match=r"pressure\['left'\] has .* points of left"):
        Problem(SQUARE, STEEL, pressure={"left": gap})


def test_a_notch_in_another_mesh_is_noticed_where_loads_are_integrated():
    """It is narrower than the distance of the points of an ordinary rule."""
    notch = Rectangle(0.02, 0.3).Face().Move((0.61, 0.8, 0))
    body = Rectangle(1, 1).Face() - notch
    other = Mesh(OCCGeometry(body, dim=2).GenerateMesh(maxh=0.3))
    load = {"contact": (0.0, function(other, 1.0))}
    with pytest.raises(ValueError, match=r"traction\['contact'\] has .* of contact"):
        Problem(block.structured_mesh(2, 2), STEEL, traction=load)


def test_another_dimension_is_refused():
    with pytest.raises(ValueError, match="another mesh, of dimension 3: one of dim"):
        Problem(SQUARE, STEEL, contact="contact", gap=function(CUBE))
    with pytest.raises(ValueError, match="another mesh, of dimension 2: one of dim"):
        Problem(CUBE, STEEL, contact="contact", gap=function(SQUARE))


def test_points_and_fields():
    far = function(block.structured_mesh(2, 2, 2, size=(0.5, 0.5, 0.5)), 1.0)
    place = Point((1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="misses 1 of 1 points of Point"):
        Problem(CUBE, STEEL, traction={place: (far, 0, 0)})
    result = semismooth_newton(Problem(SQUARE, STEEL, pressure={"left": 3.0}))
    half = function(MISSING["half"](), 1.0)
    with pytest.raises(ValueError, match="plastic_increment has a GridFunction"):
        Fields(result.problem, result.displacement, CF((half,) * 3))


UNIT_BODIES = {
    "square": lambda: SQUARE,
    "cube": lambda: CUBE,
    "tetrahedra": lambda: block.mesh(0.5),
}


@pytest.mark.parametrize("body", UNIT_BODIES)
def test_points_beyond_the_boundary(body):
    """One for each facet, outside the unit square or cube, and closer to it than a cell is wide."""
    mesh = UNIT_BODIES[body]()
    points = points_beyond(mesh)
    outside = np.maximum(points - 1, -points).max(axis=1)
    assert len(points) == mesh.GetNE(BND)
    assert (outside > 0).all()
    assert (outside < 0.1).all()
