"""Receipts that somebody made up: consistent in part, and false."""

import json

import numpy as np
import pytest
from campaigns.receipts import opened, passes
from ngsolve import x

from ngepc import Material, Problem, goal_bound, semismooth_newton, write_receipt
from ngepc.geometries import block
from ngepc.goals import check_receipt
from ngepc.goals.receipt_arrays import NO_OBSTACLE
from ngepc.goals.receipt_file import packed, proved_intervals

MATERIAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)


BODIES = {
    "order 1": (block.mesh(0.4, (1.0, 0.7)), 1),
    "order 2": (block.mesh(0.4, (1.0, 0.7)), 2),
    "solid, order 2": (block.structured_mesh(2, 2, 2, simplices=True), 2),
}


@pytest.fixture(scope="module", params=list(BODIES))
def receipt(request, tmp_path_factory):
    """Arrays and header of the receipt of a force."""
    path = tmp_path_factory.mktemp("receipt") / "receipt.npz"
    mesh, order = BODIES[request.param]
    problem = Problem(
        mesh,
        MATERIAL,
        contact="contact",
        gap=-0.002 - 0.002 * x,
        body_force=(1.0, -2.0, 0.5)[: mesh.dim],
        order=order,
    )
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    arrays, header = opened(path)
    assert passes(arrays, header)
    return arrays, header


def refused(arrays, header, message):
    """Whether the checker refuses a receipt with a message."""
    with pytest.raises(ValueError, match=message):
        proved_intervals(packed(arrays), header)


def copied(arrays, name):
    """An array to change."""
    return arrays[name].copy()


def boundary(arrays):
    """The places (side of a cell, cell) of the boundary."""
    other = arrays["other"].ravel()
    return np.flatnonzero(other == np.arange(other.size))


def inside(arrays):
    """A place of a side that two cells share."""
    other = arrays["other"].ravel()
    return np.flatnonzero(other != np.arange(other.size))[0]


def test_a_cell_that_is_folded_over_its_neighbour(receipt):
    """A vertex inside is moved across a side: the sizes of cells stay positive."""
    arrays, header = receipt
    points = copied(arrays, "points")
    N = len(points)
    vertices = arrays["cells"][: N + 1]
    on_boundary = [
        np.delete(vertices[:, p % vertices.shape[1]], p // vertices.shape[1])
        for p in boundary(arrays)
    ]
    points[:, np.setdiff1d(vertices, on_boundary)[0]] = [3.0, 2.0, 2.5][:N]
    refused(arrays | {"points": points}, header, "^cells: two overlap")


def test_a_cell_without_area(receipt):
    arrays, header = receipt
    points = copied(arrays, "points")
    a, b, c = arrays["cells"][:3, 0]
    points[:, c] = (points[:, a] + points[:, b]) / 2
    refused(arrays | {"points": points}, header, "^cells: too flat")


def test_a_cell_that_stands_twice(receipt):
    arrays, header = receipt
    cells = copied(arrays, "cells")
    cells[:, 1] = cells[:, 0]
    refused(arrays | {"cells": cells}, header, "^other: ")


def without_place(arrays, header, row):
    """The arrays without a side of the boundary."""
    names = "held", "traction", "gap", "pressure"
    short = {name: np.delete(arrays[name], row, axis=-1) for name in names}
    return short, with_sides(header, -1)


def with_sides(header, more):
    """A header that says that the boundary has more sides, or fewer."""
    P, K, B = header["sizes"]
    return header | {"sizes": [P, K, B + more]}


def test_a_side_of_the_boundary_that_is_left_out(receipt):
    """The free side would have to be in equilibrium; without it nobody looks."""
    arrays, header = receipt
    short, sizes = without_place(arrays, header, -1)
    refused(arrays | short, sizes, "^held: not the boundary")
    place = boundary(arrays)[-2:]
    other = arrays["other"].ravel().copy()
    other[place] = other[place[::-1]]
    glued = {"other": other.reshape(arrays["other"].shape)}
    names = "held", "traction", "gap", "pressure"
    fewer = {name: arrays[name][..., :-2] for name in names}
    sizes = with_sides(header, -2)
    refused(arrays | glued | fewer, sizes, "^other: not the other side")


def test_a_crack_that_cannot_be_seen(receipt):
    """Two cells share their points and are not joined: both sides would be free."""
    arrays, header = receipt
    place = inside(arrays)
    other = arrays["other"].ravel().copy()
    pair = [place, other[place]]
    other[pair] = pair
    refused(
        arrays | {"other": other.reshape(arrays["other"].shape)}, header, "^held: not"
    )
    rows = np.searchsorted(boundary(arrays), sorted(pair))
    longer = {"other": other.reshape(arrays["other"].shape)}
    for name in ("held", "traction", "gap", "pressure"):
        longer[name] = np.insert(arrays[name], rows, 0, axis=-1)
    refused(arrays | longer, with_sides(header, 2), "^held: not the boundary")
    cells = copied(arrays, "cells")
    cells[cells == cells[:3].max()] = -1  # another name of the same point
    refused(arrays | longer | {"cells": cells}, header, "^other: |^receipt: ")


def test_sides_that_are_joined_to_others(receipt):
    """To a side elsewhere, to one that is joined to a third, or to none."""
    arrays, header = receipt
    place = inside(arrays)
    for value in (place, boundary(arrays)[0], 0, header["sizes"][1], -1):
        other = arrays["other"].ravel().copy()
        if other[place] == value:
            continue
        other[place] = value
        wrong = {"other": other.reshape(arrays["other"].shape)}
        refused(arrays | wrong, header, "^other: not the other side|^held: not")


def test_a_displacement_that_is_torn(receipt):
    """Two cells have different nodes on the edge between them."""
    arrays, header = receipt
    if header["order"] == 1:
        return
    cells = copied(arrays, "cells")
    side, cell = np.divmod(inside(arrays), header["sizes"][1])
    cells[3 + side, cell] = cells[3:].max() - 1
    refused(arrays | {"cells": cells}, header, "^other: not the other side")


@pytest.mark.parametrize("change", [-1.0, 1e6])
def test_points_that_do_not_exist(change, receipt):
    arrays, header = receipt
    cells = arrays["cells"].astype(float)
    cells[0, 0] += change
    words = packed(arrays | {"cells": cells})
    with pytest.raises((ValueError, IndexError)):
        proved_intervals(words, header)


@pytest.mark.parametrize("row", [0, 1, 2, 3])
@pytest.mark.parametrize("value", [0.0, -1.0, 1e-20])
def test_moduli_that_are_not_positive(row, value, receipt):
    """B, mu, h and beta."""
    arrays, header = receipt
    values = copied(arrays, "law")
    values[row, -1] = value
    refused(arrays | {"law": values}, header, "^law: a modulus is not positive")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e20, -1e20])
@pytest.mark.parametrize(
    "name", ["points", "u", "stress", "gap", "passed", "arm", "law", "tangent"]
)
def test_numbers_that_have_no_size(name, value, receipt):
    arrays, header = receipt
    values = copied(arrays, name)
    values.ravel()[-1] = value
    refused(arrays | {name: values}, header, "^numbers: ")


def test_arms_that_are_too_short(receipt):
    """Forces have come from farther away; a sum of arms that are negative is no way out."""
    arrays, header = receipt
    for change in (0.0, 0.9, -1.0):
        refused(arrays | {"arm": change * arrays["arm"]}, header, "^arm: short")


def test_a_pull_of_the_obstacle(receipt):
    """A negative pressure; one where no obstacle is proves nothing."""
    arrays, header = receipt
    contact = arrays["gap"][0, 0] < NO_OBSTACLE
    pressure = copied(arrays, "pressure")
    pressure[0, 0, np.flatnonzero(contact)[0]] = -1.0
    refused(arrays | {"pressure": pressure}, header, "^pressure: negative")
    stress = copied(arrays, "pressure")
    stress[0, 0, np.flatnonzero(~contact)[0]] = 1e-14
    found = proved_intervals(packed(arrays | {"pressure": stress}), header)
    assert found["upper"] - found["lower"] > 1e2 * (header["upper"] - header["lower"])


def test_a_body_inside_the_obstacle(receipt):
    """The gap of the problem is smaller than the motion says."""
    arrays, header = receipt
    gap = copied(arrays, "gap")
    gap[0] -= 1e-4
    refused(arrays | {"gap": gap}, header, "^u: inside the obstacle")


def test_an_obstacle_that_an_edge_reaches_between_its_vertices(receipt):
    """A room a (1 - s)^2 + 2 c s (1 - s) + b s^2 is negative somewhere if c < -(a b)^(1/2).

    On triangles none of the coefficients may be negative.
    """
    arrays, header = receipt
    if header["order"] == 1:
        return
    r = check_receipt.Body(packed(arrays), header)
    u = np.einsum("xtB,xB->tB", r.u[0].take(r.ends, axis=1), r.normal)
    nowhere = copied(arrays, "gap")
    nowhere[0] = NO_OBSTACLE
    nowhere[1] = 0.0
    still = copied(arrays, "u")
    still[1] = 0.0
    clear, inside_it = [1.0, 4.0, -1.98], [1.0, 4.0, -2.02]
    if len(u) == 6:
        clear, inside_it = (
            [1.0, 1.0, 4.0, 1e-3, 2.0, 1.0],
            [1.0, 1.0, 4.0, 1.0, 2.0, -1e-3],
        )
    for room in (clear, inside_it):
        gap = nowhere.copy()
        gap[0, :, 0] = u[:, 0] + 1e-3 * np.array(room)
        words = packed(arrays | {"gap": gap, "u": still, "pressure": 0 * gap})
        if room is clear:
            check_receipt.Body(words, header)
        else:
            with pytest.raises(ValueError, match=r"^u: inside the obstacle"):
                check_receipt.Body(words, header)


def test_a_goal_with_other_weights(receipt):
    """Twice the force, with the same adjoint; or another force on the body."""
    arrays, header = receipt
    gap = copied(arrays, "gap")
    gap[1] *= 2
    refused(arrays | {"gap": gap}, header, "^u: .* the adjoint wrong there")
    for name in ("body_force", "traction"):
        values = copied(arrays, name)
        values[1] += 1.0
        refused(arrays | {name: values}, header, "^passed: too little")


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf, 1e-20, 1e20])
def test_a_factor_that_is_no_number(factor, receipt):
    arrays, header = receipt
    refused(arrays, header | {"factor": factor}, "^factor: |cannot convert")


@pytest.mark.parametrize("claim", [None, "1", [1.0], {}, np.nan, True, False])
def test_claims_that_are_no_numbers(claim, receipt):
    """Comparisons with them are refused, or false; true and false are 1 and 0 to Python alone."""
    arrays, header = receipt
    for name in ("lower", "upper", "goal lower", "goal upper"):
        assert not passes(arrays, header | {name: claim})


def test_claims_are_needed(receipt, tmp_path):
    arrays, header = receipt
    path = tmp_path / "receipt.npz"
    words = packed(arrays)
    for name in header.keys() - {"made by"}:
        rest = {key: value for key, value in header.items() if key != name}
        np.savez(path, header=json.dumps(rest), receipt=words)
        with pytest.raises((KeyError, ValueError)):
            check_receipt.check(path)


def test_sizes_of_arrays_whose_sum_overflows():
    """2^32 bytes: numpy would read arrays from before and after the file."""
    sizes = 2967644, 15000000, 40
    header = {"kinematics": "two-dimensional", "order": 1, "sizes": sizes}
    numbers = 4 * sizes[0] + 35 * sizes[1] + 10 * sizes[2]
    assert numbers - 2**29 == 64
    words = np.broadcast_to(np.zeros(1), numbers)
    with pytest.raises(ValueError, match=r"^receipt: too large"):
        check_receipt.arrays_in(words, header)


def test_a_body_that_nothing_holds(receipt):
    """Forces end where it is free, or where only the component along the side is held."""
    arrays, header = receipt
    free = {"held": 0 * arrays["held"]}
    refused(arrays | free, header, "^passed: too little")
    for component in range(len(arrays["held"])):
        held = copied(arrays, "held")
        held[component] = 0
        refused(arrays | {"held": held}, header, "^passed: too little")


def test_a_name_is_no_claim(receipt, tmp_path):
    """Names of goals are in quotes, and on one line."""
    arrays, header = receipt
    names = "a in (1, 2), b", "u\nPASS: another", "'a' in (1, 2), 'b", ["a"], 3.0
    for name in names:
        claims = header | {"goal": name}
        path = tmp_path / "receipt.npz"
        np.savez(path, header=json.dumps(claims), receipt=packed(arrays))
        text = check_receipt.check(path)
        assert text.isprintable()
        assert f", {name!r} in ({header['goal lower']}, " in text


def test_a_roller_along_a_side_holds_no_torque(receipt):
    """Components across all sides of the boundary are free: the body can turn."""
    arrays, header = receipt
    r = check_receipt.Body(packed(arrays), header)
    along = np.abs(r.normal) < 0.5
    refused(arrays | {"held": along}, header, "^passed: too little")


def test_sizes_do_not_depend_on_the_distance_from_the_origin(receipt):
    """Coordinates are exact, so that differences are; far away means of them are not."""
    arrays, header = receipt
    points = np.round(arrays["points"] * 2**10) / 2**10
    sizes = []
    for shift in (0.0, 2.0**41):
        words = packed(arrays | {"points": points + shift})
        sizes.append(check_receipt.Body(words, header).length)
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=1e-14)
