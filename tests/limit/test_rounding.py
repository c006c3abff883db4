"""Rounding of both bounds: enclosures beside fractions, and fields corrected to thirty digits."""

import itertools
import math
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from ngepc import Material, Problem
from ngepc.bounds.simplices import FACETS
from ngepc.geometries import block
from ngepc.limit.bracket import bracket_on, centre_of
from ngepc.limit.data import GROWS, STAYS
from ngepc.limit.enclosed import Enclosed, cross
from ngepc.limit.flow_proof import Removal, proved
from ngepc.limit.outline import Outline, Tree, tree_from
from ngepc.limit.reading import growing_names, limit_data
from ngepc.limit.static import Statics
from ngepc.limit.statics_proof import OF_TRACTIONS
from ngepc.limit.yielding import SHAPES
from ngepc.linalg.bernstein import multi_indices
from ngepc.linalg.conic import cone_solution

CLAY = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1.0
)
DIGITS = Fraction(1, 10**30)


def fractions(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, dtype=float))


@pytest.mark.parametrize("seed", range(3))
def test_enclosures_hold_the_exact_numbers(seed):
    """Chains of operations with random numbers, cancellation included, beside fractions."""
    random = np.random.default_rng(seed)
    a, b, c = random.normal(size=(3, 40, 3)) * 10.0 ** random.integers(
        -4, 4, (3, 40, 3)
    )
    x, y, z = (Enclosed(part) for part in (a, b, c))
    p, q, r = (fractions(part) for part in (a, b, c))
    found = ((x * y - z) * (x + z) / y).sum(axis=1)
    exact = ((p * q - r) * (p + r) / q).sum(axis=1)
    assert (np.abs(exact - fractions(found.middle)) <= fractions(found.radius)).all()
    turned = cross(x, y)
    normal = (turned * x).sum(axis=1)  # zero
    assert (fractions(normal.radius) >= np.abs(fractions(normal.middle))).all()
    assert (normal.radius <= 1e-13 * np.abs(a * a * b).sum(axis=1) + 1e-3).all()
    squares = (x * x).root()
    assert (
        np.abs(fractions(squares.middle) - np.abs(p)) <= fractions(squares.radius)
    ).all()


def divided_simplex(N):
    """The parts of the unit simplex between its centre and its facets, by their vertices."""
    whole = np.vstack([np.zeros(N), np.eye(N)])
    centre = whole.mean(axis=0)
    parts = []
    for k in range(N + 1):
        part = whole.copy()
        part[k] = centre
        parts.append(part)
    return parts


@pytest.mark.parametrize("N", [2, 3])
def test_stresses_on_a_divided_simplex(N):
    """Tractions and a constant force have one stress; its size is that of the constants."""
    parts = divided_simplex(N)
    pairs = list(itertools.combinations_with_replacement(range(N), 2))
    basis = np.zeros((len(pairs), N, N))
    for c, (i, j) in enumerate(pairs):
        basis[c, i, j] = basis[c, j, i] = 1.0
    s = len(pairs)
    columns = np.arange((N + 1) ** 2 * s).reshape(N + 1, N + 1, s)
    inside = []
    data = []
    slopes = []
    for part in parts:
        inverse = np.linalg.inv((part[1:] - part[0]).T)
        slopes.append(np.vstack([-inverse.sum(axis=0), inverse]))
    volume = 1 / math.factorial(N) / (N + 1)

    def row(entries):
        result = np.zeros((N, columns.size))
        for places, vector in entries:
            result[:, places] += (basis @ vector).T
        return result

    for k, m in itertools.combinations(range(N + 1), 2):
        normal = slopes[k][m]
        others = [(i, i) for i in range(N + 1) if i not in (k, m)]
        for i, j in [*others, (k, m)]:
            inside.append(row([(columns[k, i], normal), (columns[m, j], -normal)]))
    for k in range(N + 1):
        area = -slopes[k][k] * N * volume
        data += [row([(columns[k, i], area)]) for i in range(N + 1) if i != k]
    for k in range(N + 1):
        data.append(row([(columns[k, i], slopes[k][i]) for i in range(N + 1)]))
    _, sizes, rows = np.linalg.svd(np.concatenate(inside))
    stresses = rows[(sizes > 1e-10).sum() :].T
    assert stresses.shape[1] == {2: 15, 3: 42}[N]
    matrix = np.concatenate(data) @ stresses
    assert np.linalg.svd(matrix)[1].min() > 0.05
    solved = stresses @ np.linalg.pinv(matrix)
    tractions = solved[:, : -N * (N + 1)]
    forces = solved[:, -N * (N + 1) :].reshape(-1, N + 1, N).sum(axis=1)
    forces = forces * math.factorial(N)
    weights = np.array([1 if i == j else math.sqrt(2) for i, j in pairs])
    whole = np.concatenate([tractions, forces], axis=1).reshape(
        -1, s, tractions.shape[1] + N
    )
    whole = whole * weights[:, None]
    most = 0.0
    for at_vertex in whole:
        blocks = np.split(at_vertex, at_vertex.shape[1] // N, axis=1)
        most = max(most, sum(np.linalg.norm(part, 2) for part in blocks))
    assert 0.9 * OF_TRACTIONS[N] < most < OF_TRACTIONS[N]


def pulled():
    """A block on two planes of symmetry with a traction and its own weight."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None)}
    given = {"traction": {"contact": (0, 1.0)}, "body_force": (0.3, -0.2)}
    problem = Problem(mesh, CLAY, None, prescribed=supports, **given)
    data = limit_data(problem, growing_names(problem, None))
    return data.without_units()[0]


def corrected(rows, values, x):
    """The solution of equations in fractions that is next to x, to thirty digits."""
    inverse = np.linalg.pinv(rows.astype(float))
    for _ in range(5):
        x = x + fractions(inverse @ (values - rows @ x).astype(float))
    assert max(abs(values - rows @ x)) < DIGITS
    return x


def equilibrium(data):
    """Equations of equilibrium for the tensors' entries xx, yy, xy, in fractions: rows, load."""
    cells = data.cells
    points = fractions(cells.points)
    rows = []
    load = []
    sums = {}
    count = 9 * len(cells.nodes)
    for t, nodes in enumerate(cells.nodes):
        x = points[nodes]
        areas = []
        for k in range(3):
            a, b = (x[i] for i in FACETS[2][k])
            areas.append(np.array([b[1] - a[1], a[0] - b[0]]))
        volume = -((x[1] - x[0]) @ areas[1]) / 2
        for p in range(2):
            row = np.zeros(count, dtype=object)
            for i in range(3):
                place = 9 * t + 3 * i
                row[place + p] -= areas[i][p] / 2
                row[place + 2] -= areas[i][1 - p] / 2
            rows.append(row)
            load.append(-volume * Fraction(data.force[GROWS, t, p]))
        for k in range(3):
            facet = cells.facet_of[t, k]
            for i in FACETS[2][k]:
                for p in range(2):
                    key = (facet, nodes[i], p)
                    row = sums.setdefault(key, np.zeros(count, dtype=object))
                    place = 9 * t + 3 * i
                    row[place + p] += areas[k][p]
                    row[place + 2] += areas[k][1 - p]
    for (facet, node, p), row in sums.items():
        given = Fraction(0)
        if cells.outer[facet]:
            axes = np.flatnonzero(
                np.abs(data.frame[facet, : data.held[facet]]).sum(axis=0)
            )
            if p in axes:
                continue
            vertex = list(cells.facets[facet]).index(node)
            a, b = points[cells.facets[facet]]
            length = abs(b - a).max()  # sides along the axes
            given = Fraction(data.traction[GROWS, facet, vertex, p]) * length
        rows.append(row)
        load.append(given)
    return np.array(rows), np.array(load)


def lower_solution(statics):
    """The unknowns of the largest gain that the solver finds."""
    return cone_solution(statics.program(statics.gain())).x


def test_the_lower_bound_is_below_that_of_an_exact_stress():
    """The stress next to it that is in equilibrium to thirty digits nowhere exceeds yield.

    The correction is within the bound of the defect, which rounding alone makes positive.
    """
    data = pulled()
    shape = SHAPES["plane strain"]
    statics = Statics(data, shape)
    x = statics.admissible(lower_solution(statics), centre_of(statics))
    tensors = np.einsum("tic,cpq->tipq", statics.coordinates(x), shape.basis)
    entries = tensors[:, :, [0, 1, 0], [0, 1, 1]]
    rows, load = equilibrium(data)
    values = load * Fraction(float(x[-1]))
    start = fractions(entries.ravel())
    missed = max(abs(values - rows @ start))
    exact = corrected(rows, values, start).reshape(-1, 3, 3)
    change = exact - start.reshape(-1, 3, 3)
    squares = (
        change[..., 0] ** 2 + change[..., 1] ** 2 + 2 * change[..., 2] ** 2
    ).max()
    bound = statics.defect(x).stress
    assert 0 < missed < 1e-12
    assert 0 < float(squares) <= bound.min() ** 2
    assert bound.max() < 1e-8
    difference = exact[..., 0] - exact[..., 1]
    dev = difference**2 / 2 + 2 * exact[..., 2] ** 2
    assert dev.max() <= Fraction(float(data.bound.max())) ** 2
    assert float(dev.max()) > 0.999 * data.bound.max() ** 2


@pytest.mark.parametrize("noise", [1e-9, 1e-5])
def test_defects_are_not_below_the_change_to_equilibrium(noise):
    """A stress that is spoilt by noise, and the nearest one in equilibrium."""
    data = pulled()
    shape = SHAPES["plane strain"]
    statics = Statics(data, shape)
    x = statics.balanced(lower_solution(statics))
    spoilt = x.copy()
    spoilt[:-1] += noise * np.random.default_rng(1).normal(size=len(x) - 1)
    nearest = statics.balanced(spoilt)
    change = np.linalg.norm(statics.coordinates(nearest - spoilt), axis=2)
    found = statics.defect(spoilt).stress
    assert (found >= change.max(axis=1)).all()
    assert found.max() > 1e3 * statics.defect(nearest).stress.max()


def test_the_upper_bound_is_above_that_of_an_exact_mechanism():
    """The velocity next to it that is free of divergence to thirty digits, with fixed supports."""
    data = pulled()
    bracket, _ = bracket_on(data, SHAPES["plane strain"], None)
    found = bracket.mechanism
    cells = data.cells
    slopes = []
    for nodes in cells.nodes:
        x = fractions(cells.points[nodes])
        doubled = (x[1] - x[0])[0] * (x[2] - x[0])[1]
        doubled = doubled - (x[1] - x[0])[1] * (x[2] - x[0])[0]
        own = []
        for k in range(3):
            a, b = (x[i] for i in FACETS[2][k])
            own.append(np.array([a[1] - b[1], b[0] - a[0]]) / doubled)
        slopes.append(own)
    # nodes of degree two: the vertices, and the middles of edges by their ends
    keys = {}
    for nodes in cells.nodes:
        for i, j in itertools.combinations_with_replacement(range(3), 2):
            keys.setdefault(tuple(sorted((nodes[i], nodes[j]))), len(keys))
    order = {(0, 0): (2, 0, 0), (1, 1): (0, 2, 0), (2, 2): (0, 0, 2)}
    order |= {(0, 1): (1, 1, 0), (0, 2): (1, 0, 1), (1, 2): (0, 1, 1)}
    places = {tuple(int(i) for i in a): k for k, a in enumerate(multi_indices(2, 2))}
    v = np.zeros(2 * len(keys), dtype=object)
    strains = []
    for t, nodes in enumerate(cells.nodes):
        at = {}
        for pair, powers in order.items():
            number = keys[tuple(sorted(nodes[list(pair)]))]
            at[pair] = number
            v[2 * number : 2 * number + 2] = fractions(found.values[t, places[powers]])
        for i in range(3):
            row = np.zeros((2, 2, 2 * len(keys)), dtype=object)
            for j in range(3):
                number = at[tuple(sorted((i, j)))]
                for p in range(2):
                    row[p, :, 2 * number + p] += 2 * slopes[t][j]
            strains.append(row)
    strains = np.array(strains)
    held = []
    for facet in np.flatnonzero(cells.outer):
        ends = cells.facets[facet]
        for row in data.frame[facet, : data.held[facet]]:
            axis = int(np.flatnonzero(row)[0])
            for pair in ((ends[0], ends[0]), (ends[0], ends[1]), (ends[1], ends[1])):
                unit = np.zeros(2 * len(keys), dtype=object)
                unit[2 * keys[tuple(sorted(pair))] + axis] = Fraction(1)
                held.append(unit)
    assert all(abs(row @ v) == 0 for row in held)
    rows = np.array([*(strains[:, 0, 0] + strains[:, 1, 1]), *held])
    zero = np.zeros(len(rows), dtype=object)
    exact = corrected(rows, zero, v)
    change = float(max(abs(exact - v)))
    assert 0 < change < 1e-13
    gradients = (strains @ exact).astype(np.longdouble).reshape(-1, 3, 2, 2)
    e = np.stack(
        [gradients[..., 0, 0], (gradients[..., 0, 1] + gradients[..., 1, 0]) / 2]
    )
    sizes = np.sqrt(2 * (e**2).sum(axis=0))
    # the mean of the coefficients is above that of the finer parts, which the bound has
    above = (sizes.mean(axis=1) * cells.volume * data.bound).sum()
    corners = np.einsum("ctk,ak->cta", e, np.full((1, 3), 1 / 3))
    below = np.sqrt(2 * (corners**2).sum(axis=0))[:, 0]
    below = (below * cells.volume * data.bound).sum()
    power = 0
    for t, nodes in enumerate(cells.nodes):
        force = fractions(data.force[GROWS, t]) * Fraction(float(cells.volume[t])) / 6
        for i, j in itertools.combinations_with_replacement(range(3), 2):
            number = keys[tuple(sorted((nodes[i], nodes[j])))]
            power += force @ exact[2 * number : 2 * number + 2]
    for facet in np.flatnonzero(cells.outer):
        ends = cells.facets[facet]
        load = fractions(data.traction[GROWS, facet]).sum(axis=0) / 2
        length = Fraction(float(np.abs(np.diff(cells.points[ends], axis=0)).max()))
        for pair in ((ends[0], ends[0]), (ends[0], ends[1]), (ends[1], ends[1])):
            number = keys[tuple(sorted(pair))]
            power += load @ exact[2 * number : 2 * number + 2] * length / 3
    assert below / float(power) <= found.factor <= above / float(power) + 1e-9
    assert float(power) >= 1.0


@pytest.mark.parametrize("moves", [True, False])
def test_quotients_of_proofs_are_not_below_the_exact_ones(moves):
    """Dissipation less the power of what stays, over that of what grows; by fractions."""
    random = np.random.default_rng(9)
    data = SimpleNamespace(moves=moves)
    for _ in range(200):
        size = 10.0 ** random.integers(-6, 7)
        cells, removed = random.uniform(0, 1, (2, 3))
        others, grows, stays = random.uniform(0, 1e-3, 3)
        radius = 1e-14 * size
        middle = size * random.normal()
        if random.random() < 0.5:
            stays = middle = abs(middle)  # they cancel
        power = random.uniform(1, 2)
        powers = {STAYS: Enclosed(middle, radius), GROWS: Enclosed(power, radius)}
        radii = {STAYS: stays, GROWS: grows}
        removal = Removal(removed, (radii[0], radii[1]))
        found = proved(data, (powers[0], powers[1]), removal, cells, others)
        exact = [
            Fraction(a) for a in (*cells, *removed, others, stays, radius, -middle)
        ]
        total = sum(exact)
        sign = 1 if total > 0 else -1
        over = Fraction(1)
        if not moves:
            over = Fraction(power) - sign * (Fraction(radius) + Fraction(grows))
        bound = total / over
        assert Fraction(found.factor) >= bound
        assert found.factor <= float(bound) + 1e-11 * (size + 10)
        dissipated = [
            Fraction(a) + Fraction(b) for a, b in zip(cells, removed, strict=True)
        ]
        assert all(
            Fraction(a) >= b for a, b in zip(found.dissipated, dissipated, strict=True)
        )
    too_weak = Removal(removed, (2.0, 2.0))
    found = proved(
        SimpleNamespace(moves=False),
        (Enclosed(1.0), Enclosed(1.0)),
        too_weak,
        cells,
        0.0,
    )
    assert found.factor == math.inf


def test_trees_lead_from_all_cells_to_the_outside():
    """Sums over ways count each cell once, and the facets of a way join its cells."""
    data = pulled()
    cells = data.cells
    roots = np.flatnonzero(cells.outer)[:1]
    tree = tree_from(cells, roots)
    assert len(tree.order) == len(cells.nodes)
    sums = tree.sums(np.ones(len(cells.nodes)))
    assert sums.max() == pytest.approx(len(cells.nodes))
    assert tree.facet[tree.above < 0] == roots
    for cell, above in enumerate(tree.above):
        if above >= 0:
            assert {*cells.owners[tree.facet[cell]]} == {cell, above}


def test_outlines_are_those_of_the_cells():
    data = pulled()
    outline = Outline(data.cells)
    np.testing.assert_allclose(outline.volumes.middle, data.cells.volume, rtol=1e-14)
    assert np.abs(outline.areas.middle.sum(axis=1)).max() < 1e-15
    np.testing.assert_allclose(outline.sizes, data.cells.measure, rtol=1e-11)


def test_sums_along_a_tree_are_not_below_the_exact_ones():
    """A chain of many cells, whose sums lose digits."""
    count = 5000
    number = np.arange(count)
    tree = Tree(number[::-1], np.zeros(count, dtype=int), number - 1)
    for seed in range(4):
        values = np.random.default_rng(seed).uniform(0, 1, count)
        sums = tree.sums(values)
        for cell in (0, 1, 100, 4000):
            exact = sum(map(Fraction, values[cell:].tolist()))
            assert exact <= Fraction(sums[cell]) <= exact * (1 + Fraction(1, 10**10))
