"""The list of public names, arguments and options, docs/public_api.txt, is that of the package."""

import runpy

from sources import ROOT


def test_the_public_interface_is_the_frozen_one():
    """``python docs/public_api.py`` writes it; docs/versions.md says what a change needs."""
    made = runpy.run_path(str(ROOT / "docs" / "public_api.py"))
    frozen = (ROOT / "docs" / "public_api.txt").read_text(encoding="utf-8")
    changed = set(made["lines"]()) ^ set(frozen.splitlines())
    assert changed == set(), "run python docs/public_api.py, and see docs/versions.md"
    assert list(made["lines"]()) == frozen.splitlines()
