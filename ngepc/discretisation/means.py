"""Means over elements of data that are known at the integration points only.

Those by the rule of the solvers are compared with those of a finer rule, on many equal parts of
each element: they differ where a thin strip lies between the integration points.  A mean is one
over the reference element, the same as over the element where its Jacobian is constant.
"""

from __future__ import annotations

import numpy as np
from ngsolve import CF, ET, VOL, CoefficientFunction, ElementId, Mesh, x, y, z

from ngepc.checks.sentences import in_percent
from ngepc.discretisation.sampled import sampled_inside
from ngepc.discretisation.sampling import (
    AT_ONCE,
    FINEST,
    degree_two,
    parts_of_simplex,
    pieces_of,
    values_at_shares,
    with_last_share,
)
from ngepc.model.elements import elements_by_shape, plastic_points
from ngepc.model.problem import Problem

POINTS = 600_000
"""Points of the finer rule on all elements; more where ``FEWEST`` needs them."""
FEWEST = 4
"""Parts of an edge of the finer rule, at least."""
NOTICED = 0.02
"""Smaller differences of means are not mentioned, relative to the largest value."""


def differing_means(problem: Problem) -> str:
    """How far data that vary inside elements are from their values at the integration points.

    A sentence about each datum whose means over elements differ from those of a finer rule by more
    than two percent of its largest value.
    """
    found = [_in_words(problem, *datum) for datum in sampled_inside(problem)]
    return " ".join(filter(None, found))


def _in_words(problem: Problem, name: str, value: CoefficientFunction) -> str:
    """The sentence about one coefficient, empty where its means do not differ."""
    processes = problem.processes
    differences, sizes = _differences(problem, value)
    largest = processes.maximum(sizes)
    found = _closely(problem, value, int(differences.argmax()))
    difference, place = max(processes.all(found))
    if difference <= NOTICED * largest:
        return ""
    noticed = int((differences > NOTICED * largest).sum())
    many = processes.total(noticed)
    where = tuple(float(f"{c:.3g}") for c in place)
    return (
        f"{name} varies inside elements: in {many} of {processes.total(len(differences))} the mean "
        "at the integration points differs from that of a finer rule, by up to "
        f"{in_percent(difference / largest)} of the largest value, near {where}: "
        "refine the mesh there, or let its edges follow jumps."
    )


def _differences(
    problem: Problem, value: CoefficientFunction
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the means over each element differ, and the largest value on it."""
    mesh = problem.mesh
    differences = np.zeros(mesh.ne)
    sizes = np.zeros(mesh.ne)
    for numbers, _ in elements_by_shape(mesh):
        shape = mesh[ElementId(VOL, int(numbers[0]))].type
        finer = _points_of_parts(shape, _parts_of_edges(mesh, shape))
        together = max(AT_ONCE // len(finer), 1)
        for first in range(0, len(numbers), together):
            some = numbers[first : first + together]
            means = _usual_means(problem, shape, some, value)
            values = values_at_shares(mesh, some, finer, value)
            differences[some] = np.abs(values.mean(axis=1) - means).max(axis=1)
            sizes[some] = np.abs(values).max(axis=(1, 2))
    return differences, sizes


def _closely(
    problem: Problem, value: CoefficientFunction, number: int
) -> tuple[float, list[float]]:
    """The same for one element by the finest rule, and where the values differ most."""
    mesh = problem.mesh
    element = np.array([number])
    shape = mesh[ElementId(VOL, number)].type
    shares = _points_of_parts(shape, FINEST[mesh.dim])
    mean = _usual_means(problem, shape, element, value)[0]
    values = values_at_shares(mesh, element, shares, value)[0]
    away = np.abs(values - mean).max(axis=1)
    most = away > 0.99 * away.max()
    places = values_at_shares(mesh, element, shares[most], CF((x, y, z)[: mesh.dim]))[0]
    difference = np.abs(values.mean(axis=0) - mean).max()
    return float(difference), places.mean(axis=0).tolist()


def _usual_means(
    problem: Problem, shape: ET, numbers: np.ndarray, value: CoefficientFunction
) -> np.ndarray:
    """The means at the integration points over elements of one shape, (elements, components)."""
    rule = plastic_points(problem.mesh, problem.order)[shape]
    shares = with_last_share(np.array(rule.points)[:, : problem.mesh.dim])
    weights = np.array(rule.weights) / np.sum(rule.weights)
    values = values_at_shares(problem.mesh, numbers, shares, value)
    return np.einsum("q,eqc->ec", weights, values)


def _parts_of_edges(mesh: Mesh, shape: ET) -> int:
    """Parts of an edge of the finer rule on all elements."""
    parts = POINTS / (mesh.ne * len(pieces_of(shape)) * (mesh.dim + 1))
    return int(np.clip(parts ** (1 / mesh.dim), FEWEST, FINEST[mesh.dim]))


def _points_of_parts(shape: ET, count: int) -> np.ndarray:
    """Shares of points with equal weights, exact for degree two on each of the parts."""
    pieces = pieces_of(shape)
    dim = pieces.shape[2] - 1
    inside = np.matmul(degree_two(dim), parts_of_simplex(dim, count))
    return np.concatenate([inside.reshape(-1, dim + 1) @ one for one in pieces])
