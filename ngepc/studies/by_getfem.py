"""Problems without contact by GetFEM, an independent program, where a Python has it."""

from __future__ import annotations

import json
import subprocess
import tempfile
from functools import cache
from operator import itemgetter
from pathlib import Path

import numpy as np
from ngsolve import BND, VOL, Mesh

from ngepc.studies.accuracy_cases import Case

PYTHONS = ("python3", "/usr/bin/python3")
"""Interpreters that may have GetFEM; Debian's python3-getfem is for that of the system."""

PROGRAM = Path(__file__).with_name("getfem_program.py")

INCREMENTS = (1, 4, 16)
SEARCHES = ("default", "simplest")
"""Parameters that are tried: the fastest of those with the fewest increments that converge."""

LONGEST = 15.0
"""Seconds after which a run counts as failed."""


@cache
def interpreter() -> str | None:
    """A Python that has GetFEM, or None."""
    for python in PYTHONS:
        try:
            command = [python, "-I", "-c", "import getfem"]
            found = subprocess.run(command, capture_output=True, check=False)
        except OSError:
            continue
        if found.returncode == 0:
            return python
    return None


def arrays_of(case: Case, mesh: Mesh) -> dict:
    """The mesh, the metal and the loads of a case as arrays."""
    N = mesh.dim
    names = list(mesh.GetBoundaries())
    points = np.array([v.point for v in mesh.vertices])
    facets = list(mesh.Elements(BND))
    corners = np.array([[v.nr for v in facet.vertices] for facet in facets])
    held = dict(case.loads.get("prescribed") or {})
    if case.loads["clamped"]:
        held[case.loads["clamped"]] = (0,) * N
    traction = case.loads.get("traction", {})
    kind, where, component, _ = case.printed
    m = case.metal
    regions = [[names.index(name) for name in together.split("|")] for together in held]
    most = max(map(len, regions))
    return {
        "points": points,
        "elements": np.array([[v.nr for v in e.vertices] for e in mesh.Elements(VOL)]),
        "middles": points[corners].mean(axis=1),
        "numbers": np.array([names.index(facet.mat) for facet in facets]),
        "metal": np.array([m.young, m.poisson, m.yield_stress, m.modulus]),
        "held": np.array([r + [-1] * (most - len(r)) for r in regions]),
        "fixed": np.array([[float(v is not None) for v in vs] for vs in held.values()]),
        "values": np.array([[float(v or 0) for v in vs] for vs in held.values()]),
        "loaded": names.index(*traction) if traction else -1,
        "traction": np.array([float(t) for t in next(iter(traction.values()), (0,))]),
        "asked": names.index(where) if kind == "force" else -1,
        "where": np.array(where if kind != "force" else (0.0,) * N, dtype=float),
        "component": component,
    }


def best_run(case: Case, mesh: Mesh, least: int = 1) -> dict | None:
    """The value, Newton steps and processor time with the best parameters; None without any.

    ``increments`` are at least as many as were needed on a coarser mesh, ``least``.
    """
    counts = [count for count in INCREMENTS if count >= least]
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "data.npz"
        np.savez(source, **arrays_of(case, mesh))
        for count in counts:
            tried = [attempt(case, source, count, search) for search in SEARCHES]
            good = [found for found in tried if found is not None]
            if good:
                return min(good, key=itemgetter("cpu")) | {"increments": count}
    return None


def attempt(case: Case, source: Path, increments: int, search: str) -> dict | None:
    """One run of the program; None where it fails."""
    target = source.with_name("answer.json")
    target.unlink(missing_ok=True)
    words = [interpreter(), "-I", PROGRAM, source, target, str(increments), search]
    try:
        subprocess.run(words, capture_output=True, check=False, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return None
    if not target.exists():
        return None
    answer = json.loads(target.read_text(encoding="utf-8"))
    if not answer["good"]:
        return None
    return answer | {"value": case.printed[3] * answer["value"]}
