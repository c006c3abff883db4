"""What each check lets through, what it gives back, and what it says of the rest."""

from pathlib import Path

import numpy as np
import pytest
from ngsolve import CF, H1, GridFunction, x

from ngepc.checks.arguments import (
    boundary_names,
    require_coefficient,
    require_components,
    require_datum,
    require_direction,
    require_field,
    require_in,
    require_integer,
    require_number,
    require_vector,
)
from ngepc.checks.kinds import (
    require_attributes,
    require_flag,
    require_function,
    require_instance,
    require_mapping,
    require_mesh,
    require_path,
    require_sequence,
    require_text,
)
from ngepc.geometries import block

SQUARE = block.structured_mesh(2, 2)


def refused(message, check, *args, kind=ValueError, **how):
    with pytest.raises(kind, match=message):
        check("given", *args, **how)


def test_numbers_and_their_ranges():
    """Ends belong to a range unless it is strict; infinite, NaN and texts do not."""
    assert require_number("given", 2, 2) == 2.0
    assert require_number("given", 3, 2, most=3) == 3.0
    assert require_number("given", 2.5, 2, strict=True, below=3) == 2.5
    refused("given=2: a finite number > 2 is needed", require_number, 2, 2, strict=True)
    refused("a finite number >= 2 is needed", require_number, 1, 2)
    refused("a finite number <= 3 is needed", require_number, 4, most=3)
    refused("a finite number < 3 is needed", require_number, 3, below=3)
    refused("a finite number >= 0 and <= 1 is", require_number, 2, 0, most=1)
    for wrong in (np.inf, -np.inf, np.nan, 10**400):
        refused("a finite number is needed", require_number, wrong)
    for wrong in ("1", True, None, 1j, [1]):
        refused("a real number is needed", require_number, wrong, kind=TypeError)


def test_integers():
    found = require_integer("given", 3.0, 1, 3)
    assert found == 3
    assert type(found) is int
    assert require_integer("given", 1, 1) == 1
    refused("an integer is needed", require_integer, 1.5, 1, kind=TypeError)
    refused("an integer >= 1 is needed", require_integer, 0, 1)
    refused("an integer >= 1 and <= 3 is needed", require_integer, 4, 1, 3)


def test_vectors_and_directions():
    assert require_vector("given", np.array([1, 2]), (2, 3)) == (1.0, 2.0)
    refused("2 or 3 numbers are needed", require_vector, (1,), (2, 3))
    refused("a sequence of 2 numbers", require_vector, "12", (2,), kind=TypeError)
    refused("a sequence of 2 numbers", require_vector, {1, 2}, (2,), kind=TypeError)
    with pytest.raises(ValueError, match=r"given\[1\]=nan"):
        require_vector("given", (1, np.nan), (2,))
    assert require_direction("given", (3, 4), (2,)) == pytest.approx((0.6, 0.8))
    assert require_direction("given", (0, -2), (2,)) == (0.0, -1.0)
    refused("other than zero", require_direction, (0, 0), (2,))


def test_coefficients_and_their_shapes():
    require_coefficient("given", 1)
    require_coefficient("given", CF((x,)))
    require_coefficient("given", CF((1, 2)), [(2,), (3,)])
    refused(r"shape \(2,\): a scalar is needed", require_coefficient, CF((1, 2)))
    refused("scalar: shape", require_coefficient, x, [(2,)])
    refused("a number or a Coef", require_coefficient, "x", kind=TypeError)
    complex_function = GridFunction(H1(SQUARE, complex=True))
    refused("is complex: a real", require_coefficient, complex_function, kind=TypeError)
    assert require_datum("given", 2, 1) == 2.0
    assert require_datum("given", x, 1) is x
    refused("a finite number >= 1", require_datum, 0, 1)


def test_components():
    vector = CF((1, x))
    assert require_components("given", vector, 2) is vector
    made = require_components("given", (2, x), 2)
    assert made(SQUARE(0.25, 0.5)) == pytest.approx((2.0, 0.25))
    refused("2 components are needed", require_components, (1, 2, 3), 2)
    refused("a vector of 2 components", require_components, 1.0, 2, kind=TypeError)
    refused("shape", require_components, CF((1, 2, 3)), 2)


def test_names_of_boundaries():
    """Each once, in the order given; texts are taken apart at their bars."""
    assert boundary_names("given", "left|right|left", SQUARE) == ("left", "right")
    assert boundary_names("given", ["right", "left"], SQUARE) == ("right", "left")
    for wrong in (1, b"left", ["left", 2]):
        with pytest.raises(TypeError, match="a boundary name or several"):
            boundary_names("given", wrong, SQUARE)
    with pytest.raises(ValueError, match="no boundary 'top'; this mesh has"):
        boundary_names("given", "left|top", SQUARE)
    with pytest.raises(ValueError, match="at least one boundary"):
        boundary_names("given", [], SQUARE)


def test_fields_and_samples():
    """Inside by default; vertices too where corners are asked for."""
    inside = require_field("given", x, SQUARE)
    assert inside.shape[1] == 1
    assert 0 < inside.min() < inside.max() < 1
    everywhere = require_field("given", x, SQUARE, corners=True)
    assert everywhere.min() == pytest.approx(0.0, abs=1e-15)
    assert everywhere.max() == pytest.approx(1.0)
    assert require_field("given", x, SQUARE, ["right"]).min() == pytest.approx(1.0)
    assert require_field("given", 3, SQUARE).tolist() == [[3.0]]
    with pytest.raises(ValueError, match="given falls to 0: values > 0"):
        require_field("given", x, SQUARE, ["left"], least=0, strict=True)
    with pytest.raises(ValueError, match=r"infinite at 16 of 16 .* of the body"):
        require_field("given", 1 / (x - x), SQUARE)
    with pytest.raises(ValueError, match=r"sampled points of left"):
        require_field("given", 1 / x, SQUARE, ["left"])
    samples = np.array([[1.0], [2.0]])
    assert require_in("given", samples, "the body", 1) is samples
    refused("falls to 1: values > 1", require_in, samples, "here", 1, strict=True)
    refused("falls to 1: values >= 2", require_in, samples, "here", 2)


def test_kinds():
    assert require_instance("given", 1, (int, str), "an integer") == 1
    refused(
        "an integer is needed", require_instance, 1.0, int, "an integer", kind=TypeError
    )
    require_attributes("given", [], ("append", "pop"), "a list")
    for wrong in (list, ()):
        refused(
            "a list", require_attributes, wrong, ("append",), "a list", kind=TypeError
        )
    require_mesh("given", SQUARE)
    refused("dimension 2: 3 is needed", require_mesh, SQUARE, (3,))
    refused("an ngsolve.Mesh", require_mesh, SQUARE.ngmesh, kind=TypeError)
    assert require_flag("given", False) is False
    refused("True or False", require_flag, 1, kind=TypeError)


def test_functions_and_texts():
    require_function("given", len, "a list")
    require_function("given", None, "a list", optional=True)
    for wrong in (None, 1, x):
        refused(
            "a function of a list", require_function, wrong, "a list", kind=TypeError
        )
    refused("a function", require_function, 1, "a list", optional=True, kind=TypeError)
    assert require_text("given", "") == ""
    assert require_text("given", None, optional=True) is None
    refused("a text is needed", require_text, None, kind=TypeError)
    refused("a text is needed", require_text, 1, optional=True, kind=TypeError)


def test_paths():
    assert require_path("given", "a/b.npz", ".npz") == Path("a/b.npz")
    assert require_path("given", Path("b")) == Path("b")
    refused("a name that ends in '.npz'", require_path, "a.txt", ".npz")
    refused("the name of a file", require_path, "")
    for wrong in (b"a.npz", 1, None):
        refused("the name of a file", require_path, wrong, kind=TypeError)


def test_sequences_and_mappings():
    for legal in ([], (1,), np.zeros(2)):
        require_sequence("given", legal, "numbers")
    for wrong in ("a", b"a", {1: 2}, {1}, list, 1):
        refused(
            "a sequence of numbers", require_sequence, wrong, "numbers", kind=TypeError
        )
    require_mapping("given", {"a": 1}, "names")
    refused("at least one entry", require_mapping, {}, "names")
    refused("a mapping of names", require_mapping, [("a", 1)], "names", kind=TypeError)
