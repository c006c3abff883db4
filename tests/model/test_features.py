"""Features of problems: each has a name, and what a method does not list is refused."""

import importlib
import pkgutil
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from bodies import STEEL, prisms
from ngsolve import CF

import ngepc
from ngepc import (
    Contact,
    Coulomb,
    Kinematics,
    Material,
    Norton,
    Overlay,
    Point,
    Problem,
    Roller,
    Voce,
)
from ngepc.geometries import block
from ngepc.model.features import FEATURES, features_of, require_covered
from ngepc.model.hill import Hill
from ngepc.model.kinematics import KINEMATICS

sys.path.append(str(Path(__file__).parents[2] / "docs"))
table = importlib.import_module("features")

EVERYWHERE = {
    "mesh",
    "material",
    "clamped",
    "traction",
    "pressure",
    "body_force",
    "gap",
    "prescribed",
    "initial_displacement",
    "duration",
}
"""Fields of ``Problem`` that every method knows; the others are features or part of one."""

SQUARE = block.structured_mesh(2, 2, simplices=True)
PLAIN = Problem(SQUARE, STEEL, order=1)
"""A clamped square of the plainest kind."""

LAW = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=Voce(1.0, 0.5, 10.0))
CONTACT = {"contact": "contact", "gap": 0.0}
ONE_MORE = {
    "two-dimensional": {"kinematics": "two-dimensional"},
    "axisymmetric": {"kinematics": "axisymmetric"},
    "other kinematics": {"kinematics": Kinematics("mine", 2, KINEMATICS[0].basis)},
    "order 2": {"order": 2},
    "quadrilaterals": {"mesh": block.structured_mesh(2, 2)},
    "hexahedra": {"mesh": block.structured_mesh(1, 1, 1), "kinematics": "solid"},
    "prisms": {"mesh": prisms(1), "kinematics": "solid"},
    "isotropic hardening": {
        "material": replace(STEEL, hardening_modulus=0.1, hardening_stiffness=1e3)
    },
    "hardening law": {"material": LAW},
    "rate": {"material": replace(STEEL, rate=Norton(1.0))},
    "anisotropic yield": {"material": replace(STEEL, hill=Hill())},
    "cyclic hardening": {
        "material": replace(
            STEEL, overlay=Overlay([0.5], [STEEL.yield_stress]), hardening=0.0
        )
    },
    "initial plastic strain": {"initial_plastic_strain": CF((0,) * 9, dims=(3, 3))},
    "initial hardening": {"initial_hardening": 0.1},
    "initial strain": {"initial_strain": 1e-3},
    "plane stress": {"kinematics": "plane stress"},
    "thickness": {"thickness": 2.0},
    "obstacle": CONTACT,
    "two bodies": {"contact": Contact("contact", "right")},
    "held by contact": {"clamped": None, **CONTACT},
    "friction": {**CONTACT, "friction": 0.1},
    "Coulomb friction": {**CONTACT, "friction": Coulomb(0.1)},
    "contact at a clamp": {"clamped": "left", **CONTACT},
    "rollers": {"prescribed": {"right": Roller()}},
    "edges and points": {"traction": {Point((1.0, 1.0)): (0.0, 1.0)}},
    "springs": {"springs": {"right": 1.0}},
}
"""Feature -> what gives it to the plain problem."""

IMPLIED = {
    "hexahedra": {"solid"},
    "prisms": {"solid"},
    "held by contact": {"obstacle"},
    "friction": {"obstacle"},
    "Coulomb friction": {"obstacle", "friction"},
    "contact at a clamp": {"obstacle"},
}
"""Feature -> others that a problem with it has, too."""


def test_each_feature_is_found():
    plain = {"plane strain", "kinematic hardening"}
    assert set(PLAIN.features) == plain
    for name, changes in ONE_MORE.items():
        if name == "two bodies":
            continue  # one body has no two: tests/contact/test_two_bodies.py
        found = set(replace(PLAIN, **changes).features) - plain
        assert found == {name} | IMPLIED.get(name, set()), name


def test_a_support_that_holds_what_a_clamp_holds_has_its_features():
    """A clamp is a support with zeros; one that leaves the normal of contact free is none."""
    clamped = replace(PLAIN, clamped="left", **CONTACT)
    held = replace(clamped, clamped=None, prescribed={"left": (0, 0)})
    sliding = replace(PLAIN, prescribed={"left": (0, None)}, **CONTACT)
    pressed = replace(PLAIN, prescribed={"left": (None, 0)}, **CONTACT)
    assert set(held.features) == set(clamped.features)
    assert "contact at a clamp" not in sliding.features
    assert "contact at a clamp" in pressed.features


def test_a_feature_says_argument_and_value():
    problem = replace(PLAIN, friction=0.5, **CONTACT)
    assert problem.features["friction"] == ("friction", 0.5)
    assert problem.features["obstacle"] == ("contact", "contact")


def test_what_is_not_listed_is_refused():
    problem = replace(PLAIN, initial_strain=1e-3)
    covers = frozenset(problem.features)
    require_covered(problem, "a method", covers)
    with pytest.raises(
        ValueError, match=r"initial_strain=0.001: a method needs no initial strain"
    ):
        require_covered(problem, "a method", covers - {"initial strain"})
    for name in covers:
        with pytest.raises(ValueError, match=r"needs .*; go away"):
            require_covered(problem, "a method", covers - {name}, "; go away")


def test_every_field_of_a_problem_is_a_feature_or_known_everywhere():
    """A new field of ``Problem`` is refused by all methods until they list it."""
    named = set(EVERYWHERE)
    for changes in ONE_MORE.values():
        named |= set(changes)
    assert {field.name for field in fields(Problem)} - named == {"initial_accumulated"}
    assert features_of(replace(PLAIN, initial_accumulated=0.1))["initial hardening"]


def test_methods_list_features_that_exist():
    for name, covers in table.METHODS.items():
        assert covers <= set(FEATURES), name
        assert covers, name


def test_every_list_is_in_the_table():
    """A method that lists what it covers has a column in docs/features.md."""
    tables = [value for _, value in lists_of_features()]
    assert len(tables) >= len(table.METHODS)
    assert {*tables} == {*table.METHODS.values()}


def lists_of_features():
    """(module, list) for each constant of the package whose name ends in COVERS."""
    for found in pkgutil.walk_packages(ngepc.__path__, "ngepc."):
        if ".notebooks" in found.name or found.name.endswith("__main__"):
            continue
        module = importlib.import_module(found.name)
        for name, value in vars(module).items():
            if name.endswith("COVERS"):
                yield found.name, value


def test_the_page_is_that_of_the_methods():
    """``python docs/features.py`` writes it."""
    assert table.PAGE.read_text("utf-8") == table.page()


def test_needs_are_said_in_words():
    assert all(len(feature.needed.split()) > 1 for feature in FEATURES.values())
    assert np.unique(list(FEATURES)).size == len(FEATURES)
