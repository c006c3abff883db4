"""Data of a problem that are known from samples only, and the message about them.

Numbers, finite element functions and polynomials on elements are known exactly.  Gaps that are
formulas in the coordinates can be enclosed (``enclosed_gaps``).  Anything else is looked at in
points: loads and gaps on the lattice of ``Scan``, materials on that of ``finer``, histories at the
integration points.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from ngsolve import BND, H1, VOL, ElementId, Mesh

from ngepc.discretisation.enclosed_gaps import (
    OF_OBSTACLES,
    gaps_are_enclosed,
    gaps_are_followed,
)
from ngepc.discretisation.finer import parts_inside
from ngepc.discretisation.gap_records import scanned_gap
from ngepc.discretisation.lattices import parts_of_edges
from ngepc.discretisation.loads import shapes_at
from ngepc.discretisation.polynomials import HIGHEST, is_polynomial
from ngepc.model.places import Coulomb, Edge
from ngepc.model.problem import Problem

ON_BOUNDARY = (
    "traction",
    "pressure",
    "gap",
    "friction",
    "springs",
    "prescribed",
    "initial_displacement",
)
LOADS = ("body_force", "traction", "pressure")
"""Data that a solver samples on the lattice."""
OF_MATERIAL = (
    "lame_lambda",
    "lame_mu",
    "yield_stress",
    "hardening",
    "initial_strain",
    "material.law",
    "material.rate",
)
"""Data that the exact methods look at on the parts of ``finer``."""
BETWEEN = (*LOADS, *OF_MATERIAL, "gap")
"""Data that the exact methods look at between nodes and integration points."""


def sampled_data(problem: Problem) -> list[str]:
    """Names of the data that bounds know from samples: neither polynomials nor enclosed gaps."""
    return _names_of(problem, gaps_are_enclosed(problem))


def _names_of(problem: Problem, gap_is_known: bool) -> list[str]:
    """Names of the data that are no polynomials on elements, and of gaps that are not known."""
    return [
        name
        for name, value in _given(problem).items()
        if not (gap_is_known if name == "gap" else _exact(value, problem.mesh))
    ]


def what_is_unseen(problem: Problem, scanned: Collection[str] | None = BETWEEN) -> str:
    """A sentence about the data that are known from samples; empty where there are none.

    Parameters
    ----------
    problem
        The problem.
    scanned
        What is looked at between nodes and integration points; None for all, as error bounds do.
    """
    if scanned is None:
        names = sampled_data(problem)
    elif "gap" in scanned:
        names = _names_of(problem, gaps_are_followed(problem))
    else:
        names = _names_of(problem, _exact(problem.gap, problem.mesh, OF_OBSTACLES))
    if not names:
        return ""
    texts = [f"{name} ({_seen_at(problem, name, scanned)})" for name in names]
    known = f"Data known from samples only: {', '.join(texts)}"
    return f"{known}; variations between them can be missed."


def _seen_at(problem: Problem, name: str, scanned: Collection[str] | None) -> str:
    """Where a datum is looked at, in words."""
    outside = name in ON_BOUNDARY
    given = getattr(problem, name, None)
    on_edges = isinstance(given, Mapping) and any(isinstance(p, Edge) for p in given)
    if name == "springs" or on_edges:
        return "at integration points"
    if scanned is None or name in scanned:
        if scanned is not None and name in OF_MATERIAL:
            parts = parts_inside(problem.mesh)
        else:
            parts = parts_of_edges(problem.mesh, BND if outside else VOL)
        return f"at 1/{parts} of each edge of an element"
    return "at nodes" if outside else "at integration points"


def unseen_changes(problem: Problem, changes: Mapping[str, tuple[str, object]]) -> str:
    """A sentence about changes of data, name -> (datum, change), that are known from samples.

    Changes of gaps are looked at in nodes, those of materials where the data are.
    """
    outside = (*LOADS, *ON_BOUNDARY, "initial_plastic_strain")
    texts = []
    for name, (datum, change) in changes.items():
        if datum == "shape" or _exact(change, problem.mesh):  # vertices move
            continue
        scanned = "material.hill" if datum.startswith("hill.") else "material.law"
        group = datum if datum in outside else scanned
        texts.append(f"{name} ({_seen_at(problem, group, (*LOADS, *OF_MATERIAL))})")
    if not texts:
        return ""
    known = f"Changes known from samples only: {', '.join(texts)}"
    return f"{known}; variations between them can be missed."


def hidden_overlap(problem: Problem, u: np.ndarray) -> float:
    """The largest u . n - gap where an obstacle varies between nodes (length), zero if none.

    It is evaluated on the lattice of ``Scan``, for nodal displacements u (nodes, N).
    """
    scalar = H1(problem.mesh, order=problem.order)
    deepest = 0.0
    for name in problem.gaps:
        scan = scanned_gap(problem, name)
        for shape, numbers in scan.hidden_alike():
            shares = scan.lattice_in(shape)
            elements = [ElementId(BND, number) for number in numbers.tolist()]
            nodes = np.array([scalar.GetDofNrs(element) for element in elements])
            moved = shapes_at(scalar, elements[0], shares) @ u[nodes]
            normal = scan.on_elements(numbers, shares, problem.normal)
            gap = scan.on_elements(numbers, shares)[:, :, 0]
            depth = (moved * normal).sum(axis=2) - gap
            deepest = max(deepest, float(depth.max()))
    return deepest


def _given(problem: Problem) -> dict[str, object]:
    """Argument -> its given value."""
    material = problem.material
    return {
        "body_force": problem.body_force,
        "traction": problem.traction,
        "pressure": problem.pressure,
        "gap": problem.gap,
        "friction": problem.friction,
        "springs": problem.springs,
        "lame_lambda": material.lame_lambda,
        "lame_mu": material.lame_mu,
        "yield_stress": material.yield_stress,
        "hardening": material.effective_hardening,
        "initial_plastic_strain": problem.initial_plastic_strain,
        "initial_hardening": problem.initial_hardening,
        "initial_accumulated": problem.initial_accumulated,
        "initial_displacement": problem.initial_displacement,
        "initial_strain": problem.initial_strain,
        "material.law": [] if material.law is None else material.law.data,
        "material.rate": [] if material.rate is None else material.rate.data,
        "material.hill": []
        if material.hill is None
        else list(vars(material.hill).values()),
        "prescribed": [value for *_, value in problem.held],
    }


def _exact(value: object, mesh: Mesh, highest: int = HIGHEST) -> bool:
    """Whether every coefficient in a value, a mapping or a sequence is a polynomial."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, Coulomb):
        value = [value.coefficient, value.limit]
    if isinstance(value, list | tuple):
        return all(_exact(one, mesh, highest) for one in value)
    return is_polynomial(value, mesh, highest)
