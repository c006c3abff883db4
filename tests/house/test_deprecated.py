"""Names of the version before: each warns, names the new one, and gives the same object."""

import importlib
import subprocess
import sys

import numpy as np
import pytest

from ngepc import Overlay, lshape_problem, semismooth_newton
from ngepc._deprecated import MOVED, OLD_MODULES
from ngepc.geometries import lshape
from ngepc.model.processes import ALONE, Team


@pytest.mark.parametrize(("old", "new"), MOVED.items())
def test_an_old_name_warns_and_gives_the_new_object(old, new):
    module, _, name = old.rpartition(".")
    with pytest.warns(DeprecationWarning, match=rf"{old} is now {new}"):
        found = getattr(importlib.import_module(module), name)
    home, _, name = new.rpartition(".")
    assert found is getattr(importlib.import_module(home), name)


def test_old_modules_have_no_file_and_all_their_names_are_kept():
    homes = {old.rpartition(".")[0] for old in MOVED}
    assert homes >= OLD_MODULES
    for name in OLD_MODULES:
        assert not hasattr(importlib.import_module(name), "__file__")


def test_an_unknown_name_of_an_old_module_is_refused():
    with pytest.raises(ImportError, match="cannot import name 'nonsense'"):
        from ngepc.dual.newton import nonsense  # noqa: F401
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        importlib.import_module("ngepc.model.material").nonsense  # noqa: B018


def test_the_warning_names_the_line_of_the_user():
    code = "from ngepc.model.material import lame_parameters"
    run = [sys.executable, "-W", "always", "-c", code]
    told = subprocess.run(run, capture_output=True, text=True, check=True).stderr
    assert "ngepc.model.material.lame_parameters is now" in told
    assert "_deprecated.py" not in told


def test_old_attributes_warn_and_give_the_new_ones():
    result = semismooth_newton(lshape_problem(lshape.paper_mesh(65)))
    balance = result.equilibrium
    with pytest.warns(DeprecationWarning, match=r"Equilibrium\.residual_force"):
        assert balance.missing is balance.residual_force
    with pytest.warns(DeprecationWarning, match=r"Equilibrium\.free_residual"):
        assert np.array_equal(balance.imbalance, balance.free_residual)
    with pytest.warns(DeprecationWarning, match=r"Team\.maximum"):
        assert ALONE.most(np.array([1.0, 3.0])) == 3.0
    shared = Team()
    shared.node_count = 5
    with pytest.warns(DeprecationWarning, match=r"Team\.node_count"):
        assert shared.count == 5
    overlay = Overlay(shares=(0.75,), bounds=(1.0,))
    with pytest.warns(DeprecationWarning, match=r"Overlay\.elastic_share"):
        assert overlay.spare == overlay.elastic_share == 0.25
