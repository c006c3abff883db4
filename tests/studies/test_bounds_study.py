"""The study of bounds: adaptive runs beside uniform meshes, rates and pictures."""

import pytest

from ngepc.studies import bounds

TARGETS = {
    ("lshape", "adaptive"): 8e-3,
    ("wrench", "adaptive"): 1e-3,
    ("sphere", "adaptive"): 0.22,
    ("lshape", "order 2 adaptive"): 2e-3,
    ("wrench", "order 2 adaptive"): 2e-4,
}


def test_the_table_has_adaptive_rows_and_the_pictures_are_written(
    tmp_path, monkeypatch, quickly_drawn
):
    monkeypatch.setattr(bounds, "TARGETS", TARGETS)
    monkeypatch.setattr(bounds, "SOLIDS", bounds.SOLIDS | {"sphere": (55,)})
    monkeypatch.setattr(bounds, "PICTURED", (0.8, 0.7, 0.6, 0.5))
    work = bounds.Bounds(tmp_path, levels=1)
    records = work.run()
    rows = work.table_rows(records)
    names = [r["example"] for r in rows]
    plane = ["lshape", "wrench", "lshape order 2", "wrench order 2"]
    assert names == [*plane, *bounds.SOLIDS, *map(" ".join, TARGETS)]
    for r in rows:
        # order two: the affine pressure of the bound follows the rows on coarse meshes only so far
        sharp = 1.5 if "order 2" in r["example"] else 1.45
        assert r["error"] <= r["bound"] <= sharp * r["error"]
    lshape = rows[names.index("lshape adaptive")]
    assert lshape["error"] <= TARGETS["lshape", "adaptive"]
    assert lshape["nodes"] < rows[0]["nodes"]
    written = {path.name for path in work.write(records)}
    pictures = {
        "bounds_rates.png",
        "bounds_lshape_meshes.png",
        "bounds_wrench_meshes.png",
    }
    assert pictures | {"bounds.md", "bounds.csv", "bounds.json"} == written


def test_rates_are_slopes():
    run = {"example": "lshape adaptive"}
    records = [
        run | {"nodes": n, "error": 3 / n, "bound": 4 / n} for n in (500, 1000, 2000)
    ]
    assert bounds.rates_of(records) == pytest.approx({"lshape adaptive": 1.0})
