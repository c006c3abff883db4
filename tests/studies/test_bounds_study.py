"""The study of bounds: adaptive runs beside uniform meshes, rates and pictures."""

import numpy as np
import pytest

from ngepc.studies import bounds

TARGETS = {"lshape": 3e-3, "wrench": 2e-4, "sphere": 0.2}
TARGETS |= {"lshape order 2": 1e-4, "wrench order 2": 1e-5}


def test_the_table_has_adaptive_rows_and_the_pictures_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(bounds, "TARGETS", TARGETS)
    monkeypatch.setattr(bounds, "PICTURED", (0.5, 0.4, 0.3, 0.2))
    work = bounds.Bounds(tmp_path, levels=1, figures=True)
    records = work.run()
    names = [r["example"] for r in records]
    plane = ["lshape", "wrench", "lshape order 2", "wrench order 2"]
    assert names == [*plane, *bounds.SOLIDS, *(f"{label} adaptive" for label in TARGETS)]
    for r in records:
        assert r["error"] <= r["bound"] <= 1.45 * r["error"]
    lshape = records[names.index("lshape adaptive")]
    assert lshape["error"] <= 3e-3
    assert lshape["nodes"] < records[0]["nodes"]
    written = {path.name for path in work.write(records)}
    pictures = {"bounds_rates.png", "bounds_lshape_meshes.png", "bounds_wrench_meshes.png"}
    assert pictures | {"bounds.md", "bounds.csv", "bounds.json"} == written


def test_rates_are_slopes():
    nodes = np.array([500, 1000, 2000])
    curve = np.column_stack([nodes, 3.0 / nodes, 4.0 / nodes]).tolist()
    assert bounds.rates_of([{"example": "lshape adaptive", "history": curve}]) == pytest.approx(
        {"lshape adaptive": 1.0}
    )
