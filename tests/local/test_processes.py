"""Bodies that processes share: the same steps, energies, forces and files as on one process."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from ngepc.local import petsc
from ngepc.model import parts

pytestmark = pytest.mark.skipif(
    (petsc.petsc is None or parts.MPI is None)
    and not os.environ.get("NGEPC_NEEDS_PETSC"),
    reason="petsc4py or mpi4py is missing",
)

BODIES = (
    "block",
    "fine block",
    "springs",
    "Tresca",
    "Coulomb",
    "quadratic",
    "quadratic Coulomb",
    "lshape",
    "quadratic lshape",
)


def finished(count, *program, folder=None):
    """What several processes leave."""
    mine = ("OMPI_", "PMIX_")  # what an MPI of the tests' own process has left
    clean = {
        name: value for name, value in os.environ.items() if not name.startswith(mine)
    }
    clean["OMPI_MCA_mpi_yield_when_idle"] = "1"  # who waits leaves the core to others
    start = ["mpiexec", "--allow-run-as-root", "--oversubscribe", "-n", str(count)]
    return subprocess.run(
        [*start, sys.executable, "-m", "mpi4py", *program],
        **dict(
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
            env=clean,
            cwd=folder,
        ),
    )


def output_of(count, *program, folder=None):
    """What several processes print."""
    done = finished(count, *program, folder=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


RAISES = """
import sys, time
from mpi4py import MPI
from ngepc import Material, NewtonOptions, PETSc, Problem, parts, semismooth_newton
from ngepc.geometries import block

comm = MPI.COMM_WORLD
whole = block.structured_mesh(4, 4, 4, simplices=True) if comm.rank == 0 else None
metal = dict(lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0)
pressed = dict(contact="contact", gap=-0.03, order=1)
problem = Problem(parts.distribute(whole), Material.kinematic(**metal), **pressed)

def monitor(record):
    if comm.rank == comm.size - 1 and record.iteration == 1:
        print("raised at", time.time(), flush=True)
        ENDS

result = semismooth_newton(
    problem, options=NewtonOptions(inverse=PETSc()), monitor=monitor
)
sys.stdout.write(f"{result.status} {result.iterations}\\n")
sys.stdout.flush()
"""


def ended(count, ends, tmp_path):
    """What processes leave of which the last one does this in the first step, and the seconds."""
    script = tmp_path / "raises.py"
    script.write_text(RAISES.replace("ENDS", ends))
    done = finished(count, script)
    raised = float(re.search(r"raised at (\S+)", done.stdout).group(1))
    return done, time.time() - raised


@pytest.mark.parametrize("count", [2, 3, 7])
def test_one_process_that_raises_ends_all_with_its_traceback(count, tmp_path):
    """The others wait for it in a sum; PETSc's end would wait for them."""
    error = 'raise RuntimeError("one of several processes")'
    done, took = ended(count, error, tmp_path)
    assert done.returncode != 0
    assert "RuntimeError: one of several processes" in done.stderr
    assert "in monitor" in done.stderr
    assert took < 30


@pytest.mark.parametrize(
    ("ends", "status", "said"),
    [
        ("sys.exit(0)", 0, ""),
        ("sys.exit(7)", 7, ""),
        ('sys.exit("no licence on this node")', 1, "no licence on this node"),
        ("raise KeyboardInterrupt", 130, "KeyboardInterrupt"),
    ],
)
@pytest.mark.parametrize("count", [2, 3])
def test_one_process_that_leaves_ends_all_with_its_status(
    count, ends, status, said, tmp_path
):
    done, took = ended(count, ends, tmp_path)
    assert done.returncode == status
    assert said in done.stderr
    assert took < 30


def test_a_monitor_of_one_process_stops_all(tmp_path):
    done, took = ended(3, "raise StopIteration", tmp_path)
    assert done.returncode == 0
    assert done.stdout.count("stopped 1") == 3
    assert took < 30


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Number of processes -> what they find."""
    script, told = Path(__file__).with_name("shared_bodies.py"), {}
    for count in (1, 2, 3):
        folder = tmp_path_factory.mktemp(f"processes{count}")
        told[count] = json.loads(output_of(count, script, str(folder)).splitlines()[-1])
    return told


@pytest.mark.parametrize("body", [*BODIES, "softer"])
@pytest.mark.parametrize("count", [2, 3])
def test_processes_find_what_one_finds(runs, body, count):
    one, several = runs[1][body], runs[count][body]
    for name in ("status", "steps", "facets", "nodes"):
        assert several[name] == one[name]
    rows = 153 if "quadratic" in body else 45
    said = (
        f"Friction on {rows} rows: whether there are other equilibria was not examined."
    )
    searched = (
        "Friction: a search from 21 starts found no other equilibrium, "
        "which is no proof that there is none."
    )
    with_friction = "Coulomb" in body
    alone = searched if body == "Coulomb" else said  # one process examines few rows
    assert (alone in one["message"]) == with_friction
    assert (said in several["message"]) == with_friction
    assert several["message"].replace(said, alone) == one["message"]
    assert one["status"] == "converged"
    assert one["steps"] >= 4
    assert several["energies"][-1] == pytest.approx(one["energies"][-1], rel=1e-12)
    assert several["energies"] == pytest.approx(one["energies"], rel=1e-2)
    assert (one["slipping"] > 0) == (with_friction or body == "Tresca")
    for name in (
        "plastic",
        "contact force",
        "contact area",
        "pressure",
        "slipping",
        "strain",
        "error",
    ):
        assert several[name] == pytest.approx(one[name], rel=1e-7)
    assert several["penetration"] == pytest.approx(one["penetration"], rel=1e-6)
    assert several["moment"] == pytest.approx(one["moment"], rel=1e-10, abs=1e-12)
    for name, force in one["reactions"].items():
        assert several["reactions"][name] == pytest.approx(force, rel=1e-6, abs=1e-7)
    assert sum(several["iterations"]) <= 1.3 * sum(one["iterations"]) + 5


@pytest.mark.parametrize("count", [2, 3])
def test_no_process_has_much_more_than_its_share(runs, count):
    for body in BODIES:
        told = runs[count][body]
        assert max(told["own"]) < 1.5 * told["nodes"] / count


def test_what_is_not_done_is_refused_by_name_on_all_processes(runs):
    wanted = {
        "direct": "inverse='sparsecholesky'",
        "gamma": "gamma",
        "primal": "primal_newton",
        "loose": "rigid motion",
        "name": "no boundary 'nowhere'",
    }
    first, second = runs[2]["block"]["refusals"]
    assert first == second
    for name, word in wanted.items():
        assert word in first[name]
    assert "PyAMG" in first["pyamg"]


def test_what_one_process_alone_sees_or_none_is_refused_by_all(runs):
    told = runs[2]["faults"]
    for name, words in {
        "held twice": "the values must agree",
        "flat": "degenerate",
    }.items():
        first, second = told[name]
        assert first == second
        assert words in first


@pytest.mark.parametrize("count", [2, 3])
def test_histories_go_on_from_the_files_of_all_processes(runs, count):
    one, several = runs[1]["history"], runs[count]["history"]
    assert (several["stopped"], several["status"]) == ("stopped", "converged")
    assert [row["iterations"] for row in several["rows"]] == [
        row["iterations"] for row in one["rows"]
    ]
    for name in ("contact_force", "primal_energy", "dissipation", "max_plastic_strain"):
        wanted = [row[name] for row in one["rows"]]
        assert [row[name] for row in several["rows"]] == pytest.approx(
            wanted, rel=1e-6, abs=1e-9
        )


@pytest.mark.parametrize("body", BODIES)
def test_files_of_the_parts_are_those_of_the_whole(runs, body):
    path = Path(runs[2][body]["file"])
    listing = ElementTree.parse(path).getroot()
    parts_there = [piece.get("file") for piece in listing.iter("DataSet")]
    pieces = [meshio.read(path.with_name(name)) for name in parts_there]
    whole = meshio.read(runs[1][body]["file"])
    assert len(pieces) == 2
    assert all({"displacement", "stress"} <= set(piece.point_data) for piece in pieces)
    assert sum(len(piece.cells[0].data) for piece in pieces) == len(whole.cells[0].data)
    mises = np.sort(
        np.concatenate([piece.point_data["von_mises"].ravel() for piece in pieces])
    )
    assert mises == pytest.approx(
        np.sort(whole.point_data["von_mises"].ravel()), abs=1e-4
    )


def test_the_script_of_the_page_runs(tmp_path):
    page = Path(__file__).resolve().parents[2] / "docs" / "howto" / "distributed.md"
    script = re.search(
        r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE
    )[1]
    (tmp_path / "body.py").write_text(script)
    nodes, status, *_ = output_of(2, "body.py", folder=tmp_path).split()
    assert (int(nodes), status) == (1745, "converged")
    assert (tmp_path / "body.pvd").is_file()
    assert (tmp_path / "body_0001.vtu").is_file()
