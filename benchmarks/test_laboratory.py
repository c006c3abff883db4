"""Processor time of a picture of the laboratory while a slider moves.

    python -m pytest benchmarks/test_laboratory.py -s

The median over a drag is printed; nothing is asserted about it.
"""

import statistics
import time
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import SetNumThreads

from ngepc import lab, lshape_problem
from ngepc.geometries import lshape
from ngepc.pictures.live_server import as_json
from ngepc.studies.large import indented_block

PLANE = {"load": np.linspace(8.0, 11.0, 20)}
SPACE = {"obstacle": -np.linspace(0.0, 0.01, 12)}


def plane(nodes, order=1):
    return replace(lshape_problem(lshape.paper_mesh(nodes)), order=order)


BODIES = {
    "833 nodes": (lambda: plane(833), PLANE),
    "833 nodes, order 2": (lambda: plane(833, 2), PLANE),
    "3201 nodes": (lambda: plane(3201), PLANE),
    "sphere, 1745 nodes": (lambda: indented_block(2), SPACE),
}


@pytest.mark.parametrize("name", BODIES)
def test_a_picture_while_dragging(name, capsys):
    SetNumThreads(1)
    make, drag = BODIES[name]
    ((slider, values),) = drag.items()
    laboratory = lab(make(), **{slider: (values.min() - 1e-9, values.max())})
    times = []
    for value in values:
        begin = time.process_time()
        for frame in laboratory.frames({slider: value}):
            as_json(frame)
            end = time.process_time()
            times.append((frame["exact"], 1e3 * (end - begin)))
            begin = end
    every = statistics.mean(t for _, t in times)
    exact = statistics.median(t for is_exact, t in times if is_exact)
    with capsys.disabled():
        print(f"\n{name}: solutions {exact:.0f} ms, all pictures {every:.0f} ms")
