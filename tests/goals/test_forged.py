"""Receipts that somebody made up: consistent in part, and false."""

import json

import numpy as np
import pytest
from campaigns.receipts import opened, passes
from ngsolve import x

from ngepc import Material, Problem, goal_bound, semismooth_newton, write_receipt
from ngepc.geometries import block
from ngepc.goals import check_receipt
from ngepc.goals.receipt_file import numbered_sides, packed, passed, ways

MATERIAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)


@pytest.fixture(scope="module", params=[1, 2])
def receipt(request, tmp_path_factory):
    """Arrays and header of the receipt of a force."""
    path = tmp_path_factory.mktemp("receipt") / "receipt.npz"
    problem = Problem(
        block.mesh(0.4, (1.0, 0.7)),
        MATERIAL,
        contact="contact",
        gap=-0.002 - 0.002 * x,
        body_force=(1.0, -2.0),
        order=request.param,
    )
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    arrays, header = opened(path)
    assert passes(arrays, header)
    return arrays, header


def refused(arrays, header, message):
    """Whether the checker refuses a receipt with a message."""
    with pytest.raises(ValueError, match=message):
        check_receipt.proved_intervals(packed(arrays, header), header)


def copied(arrays, name):
    """An array to change."""
    return arrays[name].copy()


def test_a_cell_that_is_folded_over_its_neighbour(receipt):
    """A vertex inside is moved across a side: the sizes of cells stay positive."""
    arrays, header = receipt
    points = copied(arrays, "points")
    first, second = numbered_sides(arrays["cells"].T)
    place = first[first == second]
    K = header["K"]
    on_boundary = [np.delete(arrays["cells"][:, p % K], p // K) for p in place]
    inside = np.setdiff1d(arrays["cells"], on_boundary)[0]
    points[:, inside] = [3.0, 2.0]
    refused(arrays | {"points": points}, header, "^cells: two overlap")


def test_a_cell_without_area(receipt):
    arrays, header = receipt
    points = copied(arrays, "points")
    a, b, c = arrays["cells"][:, 0]
    points[:, c] = (points[:, a] + points[:, b]) / 2
    refused(arrays | {"points": points}, header, "^cells: a cell is too flat")


def test_a_cell_that_stands_twice(receipt):
    arrays, header = receipt
    cells = copied(arrays, "cells")
    cells[:, 1] = cells[:, 0]
    refused(arrays | {"cells": cells}, header, "^sides: ")


def test_a_side_of_the_boundary_that_is_left_out(receipt):
    """The free side would have to be in equilibrium; without it nobody looks."""
    arrays, header = receipt
    first, second = numbered_sides(arrays["cells"].T)
    last = np.flatnonzero(first == second)[-1]
    short = {}
    for name in ("held", "contact", "prescribed", "traction", "gap", "pressure"):
        short[name] = arrays[name][..., :-1]
    if header["order"] == 2:
        short["u"] = np.delete(arrays["u"], header["P"] + last, axis=2)
    sizes = {"S": header["S"] - 1, "B": header["B"] - 1}
    refused(arrays | short, header | sizes, "^sides: not as many")


def test_two_neighbours_that_are_not_joined(receipt):
    """One has copies of its points: a crack, whose two sides need data like all of the boundary."""
    arrays, header = receipt
    cells = copied(arrays, "cells")
    P = header["P"]
    added = arrays["points"][:, cells[:, 0]]
    cells[:, 0] = P + np.arange(3)
    places = arrays["u"][:, :, arrays["cells"][:, 0]]
    u = np.concatenate([arrays["u"][..., :P], places, arrays["u"][..., P:]], axis=2)
    points = np.concatenate([arrays["points"], added], axis=1)
    apart = {"cells": cells, "points": points, "u": u}
    refused(arrays | apart, header | {"P": P + 3}, "^sides: not as many")


def test_cells_with_a_side_for_three(receipt):
    """A third cell at a side would be in no balance."""
    arrays, header = receipt
    first, second = numbered_sides(arrays["cells"].T)
    inner = np.flatnonzero(first != second)[0]
    K = header["K"]
    ends = np.delete(arrays["cells"][:, first[inner] % K], first[inner] // K)
    others = np.setdiff1d(np.arange(K), [first[inner] % K, second[inner] % K])
    apex = arrays["cells"].max()
    cells = copied(arrays, "cells")
    cells[:, others[0]] = np.sort([*ends, apex if apex not in ends else 0])
    refused(arrays | {"cells": cells}, header, "^sides: ")


@pytest.mark.parametrize("change", [0.5, -1.0, 1e6])
def test_points_that_do_not_exist(change, receipt):
    arrays, header = receipt
    cells = arrays["cells"].astype(float)
    cells[0, 0] += change
    refused(arrays | {"cells": cells}, header, "^cells: not ascending points|^sides: ")


@pytest.mark.parametrize("name", ["mu", "hardening", "beta"])
@pytest.mark.parametrize("value", [0.0, -1.0])
def test_moduli_that_are_not_positive(name, value, receipt):
    arrays, header = receipt
    values = copied(arrays, name)
    values[-1] = value
    refused(arrays | {name: values}, header, f"^{name}: not positive|^bulk")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e31, 1e-31, 5e-324])
@pytest.mark.parametrize("name", ["points", "u", "stress", "gap", "passed", "mu"])
def test_numbers_that_have_no_size(name, value, receipt):
    arrays, header = receipt
    values = copied(arrays, name)
    values.ravel()[-1] = value
    refused(arrays | {name: values}, header, "^numbers: ")


def test_a_pull_of_the_obstacle(receipt):
    """A negative pressure, and one where no obstacle is."""
    arrays, header = receipt
    pressure = copied(arrays, "pressure")
    contact = arrays["contact"] != 0
    for place, value in ((contact, -1.0), (~contact, 1.0)):
        pressure[:] = arrays["pressure"]
        pressure[0, 0, np.flatnonzero(place)[0]] = value
        refused(arrays | {"pressure": pressure}, header, "^pressure: ")


def test_a_body_inside_the_obstacle(receipt):
    """The gap of the problem is larger than the motion says, or the support moves."""
    arrays, header = receipt
    gap = copied(arrays, "gap")
    gap[:, 0] -= 1e-4
    refused(arrays | {"gap": gap}, header, "^u: inside the obstacle")
    motion = copied(arrays, "prescribed")
    motion[:, :, 0] += 1e-9
    refused(arrays | {"prescribed": motion}, header, "^u: not the prescribed")


def test_a_goal_with_other_weights(receipt):
    """Twice the force, with the same adjoint; or another force on the body."""
    arrays, header = receipt
    gap = copied(arrays, "gap")
    gap[:, 1] *= 2
    refused(arrays | {"gap": gap}, header, "^u: the adjoint is wrong")
    for name in ("body_force", "traction"):
        values = copied(arrays, name)
        values[..., 1, :] += 1.0
        refused(arrays | {name: values}, header, "^passed: too little")


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf, 1e-31])
def test_a_factor_that_is_no_number(factor, receipt):
    arrays, header = receipt
    refused(arrays, header | {"factor": factor}, "^factor: |cannot convert")


@pytest.mark.parametrize("claim", [None, "1", [1.0], {}, np.nan])
def test_claims_that_are_no_numbers(claim, receipt):
    """Comparisons with them are refused, or false."""
    arrays, header = receipt
    for name in ("lower", "upper", "goal lower", "goal upper"):
        assert not passes(arrays, header | {name: claim})


def test_claims_are_needed(receipt, tmp_path):
    arrays, header = receipt
    path = tmp_path / "receipt.npz"
    words = packed(arrays, header)
    for name in header.keys() - {"made by"}:
        rest = {key: value for key, value in header.items() if key != name}
        np.savez(path, header=json.dumps(rest), receipt=words)
        with pytest.raises((KeyError, ValueError)):
            check_receipt.check(path)


def test_a_body_that_nothing_holds(receipt):
    """Forces end where it is free, or in the first cell: it can move."""
    arrays, header = receipt
    free = {"held": 0 * arrays["held"]}
    refused(arrays | free, header, "^passed: where the body is free")
    forces = 0 * arrays["passed"]
    refused(arrays | free | {"passed": forces}, header, "^passed: too little")
    places = numbered_sides(arrays["cells"].T)
    way, levels = ways(arrays["cells"].T, places, np.zeros(header["B"], dtype=bool))
    forces += passed(np.full(header["K"], 1e9), way, places, levels)
    refused(arrays | free | {"passed": forces}, header, "^held: the body can move")


def test_sizes_do_not_depend_on_the_distance_from_the_origin(receipt):
    """Coordinates are exact, so that differences are; far away means of them are not."""
    arrays, header = receipt
    points = np.round(arrays["points"] * 2**10) / 2**10
    sizes = []
    for shift in (0.0, 2.0**41):
        words = packed(arrays | {"points": points + shift}, header)
        sizes.append(check_receipt.opened(words, header).length)
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=1e-14)
