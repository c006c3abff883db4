"""Processor time of a history with friction, beside CalculiX where it is installed.

    python -m pytest benchmarks/test_friction.py -s

A block with isotropic hardening is pressed down in 10 steps by a rigid plate and dragged along by
it in 10 more; the mesh has 561 nodes of order two, 33 of which touch.  CalculiX has the same mesh,
the same steps and both of its kinds of contact.  Its contact is a penalty, along the surface, too:
with stiffer springs its force approaches that of ngepc and must be within a percent; much stiffer
ones than here end its iterations.  Nothing is asserted about times.  Runs take turns, so that a
busy machine slows all of them alike.
"""

import statistics
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import SetNumThreads

from ngepc import Coulomb, Material, Problem, Schedule, evolve
from ngepc.geometries import block
from ngepc.linalg.blas import one_blas_thread
from ngepc.studies import calculix
from ngepc.studies.calculix import Deck, QuadraticMesh

RUNS = 5
STEPS = 10
SIZE = (2.0, 1.0)
CELLS = (16, 8)
YOUNG, POISSON, YIELD, MODULUS = 2.5e3, 0.25, 18.4, 150.0
FRICTION = 0.3
DEPTH = DRAG = 0.02
"""Displacements of the plate, after which all of the top slips."""

ENDS = (STEPS - 1, 2 * STEPS - 1)
"""The steps at the end of pressing and of dragging."""


@dataclass(frozen=True)
class Penalty:
    """CalculiX's contact: its kind, and stiffnesses of its springs over Young's modulus."""

    kind: str
    normal: float
    stick: float


PENALTIES = [
    Penalty(kind, normal, stick)
    for kind in ("SURFACE TO SURFACE", "NODE TO SURFACE")
    for normal, stick in ((50.0, 1.0), (200.0, 2.0))
]
STIFFEST = 200.0


def dragged(order, cells):
    """The problem and its steps for ngepc."""
    mesh = block.structured_mesh(*cells, size=SIZE, simplices=True)
    metal = Material.metal(
        young=YOUNG,
        poisson=POISSON,
        yield_stress=YIELD,
        plastic_modulus=MODULUS,
        kind="isotropic",
    )
    law = Coulomb(FRICTION)
    problem = Problem(
        mesh, metal, contact="contact", gap=0.0, friction=law, order=order
    )
    times = np.arange(1, 2 * STEPS + 1) / STEPS
    schedule = Schedule(
        times.tolist(),
        lambda t: {"gap": -DEPTH * min(t, 1.0)},
        obstacle_motion=lambda t: (DRAG * max(t - 1.0, 0.0), 0.0),
    )
    return problem, schedule


def deck_of(penalty):
    """The same as an input file for CalculiX."""
    mesh = block.structured_mesh(*CELLS, size=SIZE, simplices=True)
    body = QuadraticMesh(mesh)
    deck = Deck()
    deck.mesh(body.points, body.elements, calculix.KINDS[body.shape], "BODY")
    plastic = calculix.plastic_lines(YIELD, MODULUS)
    deck.material("METAL", YOUNG, POISSON, *plastic)
    deck.section("BODY", "METAL", True)
    deck.node_set("HELD", body.nodes_on("clamped"))
    add_plate(deck, body, penalty)
    deck.add("*BOUNDARY", "HELD,1,2")
    for dragging in (0, 1):
        deck.add("*STEP,INC=1000", "*STATIC,DIRECT", f"{1 / STEPS},1.")
        deck.add("*BOUNDARY", f"PLATENODES,1,1,{dragging * DRAG:.12g}")
        deck.add(f"PLATENODES,2,2,{-DEPTH:.12g}")
        deck.add("*NODE PRINT,NSET=HELD,TOTALS=ONLY", "RF", "*END STEP")
    return deck


def add_plate(deck, body, penalty):
    """A plate, wider than the block by what it is dragged, and contact with it."""
    width, height = SIZE
    s = np.linspace(-width / 4, width + width / 4, 7)
    below = np.column_stack([s, np.full(len(s), height)])
    above = below + np.array([0.0, 0.3])
    k = np.arange(len(s) - 1)
    n = len(s)
    corners = np.column_stack([k, k + 1, n + k + 1, n + k])
    first = deck.elements
    before = deck.mesh(np.vstack([below, above]), corners, "CPE4", "PLATE")
    deck.node_set("PLATENODES", np.arange(before, before + 2 * n))
    deck.surface("MASTER", [(first + int(i), 0) for i in k])
    deck.surface("SLAVE", body.faces_on("contact"))
    deck.material("STIFF", 10 * YOUNG, POISSON)
    deck.section("PLATE", "STIFF", True)
    springs = "*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR"
    deck.add("*SURFACE INTERACTION,NAME=TOUCH", springs)
    deck.add(f"{penalty.normal * YOUNG:.12g}")
    deck.add("*FRICTION", f"{FRICTION},{penalty.stick * YOUNG:.12g}")
    pair = f"*CONTACT PAIR,INTERACTION=TOUCH,TYPE={penalty.kind}"
    deck.add(pair, "SLAVE,MASTER")


@pytest.fixture(autouse=True)
def one_thread():
    SetNumThreads(1)


@one_blas_thread
def by_ngepc(order, cells):
    """Processor time, Newton steps, and the forces on the base at the ends."""
    problem, schedule = dragged(order, cells)
    start = time.process_time()
    history = evolve(problem, schedule)
    spent = time.process_time() - start
    assert history.status.is_success
    forces = np.array(history.column("reaction"))[list(ENDS)]
    return spent, sum(history.column("iterations")), forces


def by_calculix(penalty, folder):
    """The same; the time includes that of reading the input file."""
    answer = calculix.run(deck_of(penalty), folder)
    assert answer.finished
    return answer.cpu, answer.iterations, answer.forces[list(ENDS), :2]


def test_a_block_that_is_pressed_and_dragged(capsys, tmp_path):
    programs = {
        "ngepc, order 2": lambda: by_ngepc(2, CELLS),
        "ngepc, order 1, as many nodes": lambda: by_ngepc(1, [2 * c for c in CELLS]),
    }
    if calculix.available():
        for p in PENALTIES:
            name = f"ccx, {p.kind.lower()}, springs {p.normal:g} E, {p.stick:g} E"
            programs[name] = lambda p=p: by_calculix(p, tmp_path)
    found = defaultdict(list)
    for _ in range(RUNS):
        for name, run in programs.items():
            found[name].append(run())

    own = found["ngepc, order 2"][0][2]
    with capsys.disabled():
        for name, runs in found.items():
            seconds = [r[0] for r in runs]
            spent = f"{statistics.median(seconds):.2f} s"
            span = f"({min(seconds):.2f} to {max(seconds):.2f})"
            _, steps, forces = runs[0]
            shown = np.array2string(forces, precision=3).replace("\n", "")
            print(f"\n{name}: {spent} {span}, {steps} steps, forces {shown}", end="")
        print()
    for p, runs in zip(PENALTIES, list(found.values())[2:], strict=False):
        if p.normal == STIFFEST:
            apart = np.linalg.norm(runs[0][2] - own, axis=1)
            assert (apart < 0.01 * np.linalg.norm(own, axis=1)).all()
