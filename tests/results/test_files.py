"""Files on a full disk: the old one stays, and the error names the new one."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="file sizes are limited")

WRITES = """
import resource, sys
from pathlib import Path
from ngepc import evolve, lshape_problem, semismooth_newton, write_receipt
from ngepc.geometries import lshape
from ngepc.pictures.export import export_vtu
from ngepc.pictures.curves import plot_contact_pressure
from ngepc.pictures.style import save_figure
from ngepc.results.files import replace_contents

coarse = lshape_problem(lshape.paper_mesh(33))
result = semismooth_newton(lshape_problem(lshape.mesh(maxh=0.05)))
path = Path(sys.argv[1])
writers = {
    "text.txt": lambda path: replace_contents(path, bytes(100_000)),
    "body.vtu": lambda path: export_vtu(result, path),
    "curve.png": lambda path: save_figure(plot_contact_pressure(result), path),
    "receipt.npz": lambda path: write_receipt(result, path),
    "history.npz": lambda path: evolve(coarse, [(1.0, {"gap": 0.2})], checkpoint=path),
}
for name in writers:
    (path / name).write_text("old")
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
for name, write in writers.items():
    try:
        write(path / name)
    except OSError as error:
        print(name, "|", error)
"""


def test_a_full_disk_leaves_the_old_files_and_names_the_new_ones(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", WRITES, str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    names = ["text.txt", "body.vtu", "curve.png", "receipt.npz", "history.npz"]
    told = dict(line.split(" | ") for line in done.stdout.splitlines())
    assert list(told) == names
    for name in names:
        assert f"{tmp_path / name} cannot be written: File too large" in told[name]
        assert (tmp_path / name).read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
