"""What makes a problem well posed, checked before any work is done.

NGSolve accepts misspelt boundaries, singular supports and NaN in silence; here each is an error
that names the argument, its value and what is legal.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from ngsolve import CoefficientFunction, Det, Mesh, specialcf

from ngepc.checks.arguments import (
    Coefficient,
    boundary_names,
    require_coefficient,
    require_finite,
    sample,
)
from ngepc.model.elements import element_nodes, vertices_of
from ngepc.model.friction import Coulomb
from ngepc.model.given import Given
from ngepc.model.hardening import check_law
from ngepc.model.kinematics import Kinematics
from ngepc.model.loading import check_loads, check_springs, require_vector_load
from ngepc.model.material import Material, split_hardening
from ngepc.model.places import Place, Roller, places
from ngepc.model.processes import require_whole
from ngepc.model.rules import plastic_points
from ngepc.model.support import check_support


def check_problem(problem: Given) -> None:
    """Raise TypeError or ValueError for the first thing that is wrong with ``problem``."""
    problem.processes.together(partial(check_data, problem))
    check_support(problem)


def check_data(problem: Given) -> None:
    """What is wrong with the data on this process's part of the mesh."""
    check_shared(problem)
    check_material(problem.material, problem.mesh, problem.kinematics)
    check_axis(problem)
    check_boundaries(problem)
    check_loads(problem)
    check_springs(problem)
    check_pairs(problem)
    check_gap(problem)
    check_friction(problem)
    check_history(problem)


def check_shared(problem: Given) -> None:
    """What several processes cannot do."""
    mappings = [problem.traction, problem.pressure, problem.prescribed, problem.springs]
    acting = {}
    for given in (g for g in mappings if isinstance(g, Mapping)):
        acting |= given
    given = {
        "order=2": problem.order == 2,
        "friction": problem.friction is not None,
        "contact of two bodies": bool(problem.contact_pairs),
        "points and edges": not all(isinstance(place, str) for place in acting),
        "rollers": any(isinstance(value, Roller) for value in acting.values()),
    }
    for what in (name for name, there in given.items() if there):
        require_whole(what, problem.mesh)


def check_mesh(mesh: Mesh) -> None:
    """A mesh in two or three dimensions with elements of positive size, all oriented alike."""
    if not isinstance(mesh, Mesh):
        raise TypeError(f"mesh={mesh!r}: an ngsolve.Mesh is needed")
    if mesh.dim not in (2, 3):
        raise ValueError(f"mesh has dimension {mesh.dim}: 2 or 3 is needed")
    if mesh.comm.size > 1:
        raise ValueError(
            f"mesh is distributed by NGSolve over {mesh.comm.size} processes: ngepc.distribute is "
            "needed"
        )
    nodes = element_nodes(mesh)
    if len(nodes) == 0:
        raise ValueError("mesh has no elements: a mesh of the body is needed")
    if (nodes[:, 2**mesh.dim :] >= 0).any():
        raise ValueError(
            "mesh has elements of second order: leave SecondOrder() out (mesh.Curve bends elements)"
        )
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    size = sample(determinant, mesh)
    if not np.isfinite(size).all() or np.abs(size).min() <= 1e-14 * np.abs(size).max():
        raise ValueError("mesh has degenerate elements (zero area or volume)")
    if (nodes[:, 2**mesh.dim - 1] >= 0).any():
        corner = sample(determinant, mesh, corners=True)
        size = np.append(size, corner[np.abs(corner) > 1e-12 * np.abs(size).max()])
    if size.min() < 0 < size.max():
        raise ValueError("mesh has inverted elements (Jacobian determinants of both signs)")


def check_axis(problem: Given) -> None:
    """An axisymmetric body lies at radii x >= 0."""
    if not problem.kinematics.hoop:
        return
    radii = np.asarray(problem.mesh.ngmesh.Coordinates())[:, 0]
    if radii.min() < -1e-12 * np.abs(radii).max():
        raise ValueError(
            f'kinematics="axisymmetric": the mesh reaches to x = {radii.min():g}, radii x >= 0 are '
            "needed"
        )


def check_material(material: Material, mesh: Mesh, kinematics: Kinematics) -> None:
    """Elliptic elasticity, positive yield stress and hardening everywhere on the mesh."""
    if not isinstance(material, Material):
        raise TypeError(f"material={material!r}: a Material is needed")
    N = kinematics.size
    for name in ("lame_lambda", "hardening", "hardening_modulus", "hardening_stiffness"):
        values = require_finite(name, getattr(material, name), mesh)
        if name != "lame_lambda" and values.min() < 0:
            raise ValueError(f"{name} falls to {values.min():g}: values >= 0 are needed")
    for name in ("lame_mu", "yield_stress"):
        values = require_finite(name, getattr(material, name), mesh)
        if values.min() <= 0:
            raise ValueError(f"{name} falls to {values.min():g}: values > 0 are needed")
    name = f"{N} lame_lambda + 2 lame_mu"
    bulk = require_finite(name, N * material.lame_lambda + 2 * material.lame_mu, mesh).min()
    if bulk <= 0:
        raise ValueError(
            f"lame_lambda={material.lame_lambda!r}: the elasticity is not elliptic, "
            f"{N} lambda + 2 mu falls to {bulk:g}, > 0 is needed for {N} x {N} tensors"
        )
    if material.law is not None:
        check_law(material.law, mesh)
    name = "the hardening h = k + (H sigma_y)^2 k_1"
    h = require_finite(name, material.effective_hardening, mesh).min()
    if h <= 0 and material.law is None:
        raise ValueError(
            f"{name} falls to {h:g}: > 0 is needed, "
            "the method is for hardening plasticity (perfect plasticity is a Tabulated law)"
        )


def check_boundaries(problem: Given) -> None:
    """Existing names; nothing both clamped and something else."""
    mesh, clamped, contact = problem.mesh, problem.clamped_names, problem.contact_names
    named = {"contact": list(contact)}
    for argument in ("traction", "pressure", "prescribed", "springs"):
        given = getattr(problem, argument)
        if given is not None and not isinstance(given, Mapping):
            raise TypeError(f"{argument}={given!r}: a mapping of boundary name -> value is needed")
        named[argument] = _keys(argument, given, mesh)
    for name, others in named.items():
        twice = sorted(set(clamped) & set(others))
        if twice:
            raise ValueError(
                f"{name} and clamped overlap in {', '.join(twice)}: "
                "a clamped boundary carries nothing else"
            )


def _keys(argument: str, given: Mapping | None, mesh: Mesh) -> list[Place]:
    legal = boundary_names if argument == "pressure" else places
    keys = [place for key in (given or {}) for place in legal(argument, key, mesh)]
    twice = sorted({str(place) for place in keys if keys.count(place) > 1})
    if twice:
        raise ValueError(f"{argument} names {', '.join(twice)} more than once")
    return keys


def check_pairs(problem: Given) -> None:
    """Existing names, two different boundaries in each pair, none of them a rigid obstacle's."""
    mesh, rigid = problem.mesh, set(problem.contact_names)
    for pair in problem.contact_pairs:
        one, two = (boundary_names("contact", n, mesh) for n in (pair.first, pair.second))
        if set(one) & set(two) or (set(one) | set(two)) & rigid:
            raise ValueError(
                f"contact={pair!r}: two different boundaries are needed, and no obstacle on them"
            )
        if vertices_of(mesh, one) & vertices_of(mesh, two):
            raise ValueError(
                f"contact={pair!r}: the bodies share nodes; mesh them apart (without Glue)"
            )


def check_gap(problem: Given) -> None:
    """A finite gap on the contact boundary, and none without one."""
    if not problem.contact_names:
        if problem.gap is not None:
            raise ValueError(
                f"gap={problem.gap!r}: name the contact boundary too, or leave gap out"
            )
        return
    if problem.gap is None:
        raise ValueError(f"contact={problem.contact!r} needs a gap: a number or coefficient")
    names = problem.contact_names
    if isinstance(problem.gap, Mapping) and set(problem.gap) != set(names):
        raise ValueError(
            f"gap names {sorted(map(str, problem.gap))}: the contact boundaries are {sorted(names)}"
        )
    gaps = problem.gap if isinstance(problem.gap, Mapping) else dict.fromkeys(names, problem.gap)
    for name, gap in gaps.items():
        argument = f"gap[{name!r}]" if isinstance(problem.gap, Mapping) else "gap"
        require_coefficient(argument, gap)
        require_finite(argument, gap, problem.mesh, [name], corners=True)


def check_friction(problem: Given) -> None:
    """A finite friction law >= 0, none without contact; no u_0 without friction."""
    if problem.friction is None:
        if problem.initial_displacement is not None:
            raise ValueError(
                "initial_displacement matters for friction alone: give friction too, or leave "
                "initial_displacement out"
            )
        return
    if problem.contact is None:
        raise ValueError(
            f"friction={problem.friction!r}: name the contact boundary too, or leave friction out"
        )
    coulomb = isinstance(problem.friction, Coulomb)
    name = "friction.coefficient" if coulomb else "friction"
    value = problem.friction.coefficient if coulomb else problem.friction
    require_coefficient(name, value)
    least = require_finite(name, value, problem.mesh, problem.touching_names).min()
    if least < 0:
        raise ValueError(f"{name} falls to {least:g}: values >= 0 are needed")
    if problem.initial_displacement is not None:
        require_vector_load("initial_displacement", problem.initial_displacement, problem.N)
        require_finite("initial_displacement", problem.u_0, problem.mesh, problem.touching_names)


def check_history(problem: Given) -> None:
    """Initial plastic strain symmetric and trace-free, initial hardening of the right kind.

    A polynomial with alpha_1 >= 0 at the integration points, which histories carry, may fall below
    zero between them, but not its means on the elements.
    """
    N, mesh = problem.kinematics.size, problem.mesh
    if problem.initial_plastic_strain is not None:
        require_coefficient("initial_plastic_strain", problem.initial_plastic_strain, [(N, N)])
        p = require_finite("initial_plastic_strain", problem.initial_plastic_strain, mesh)
        _check_symmetric("initial_plastic_strain", p.reshape(-1, N, N))
        trace, size = np.abs(np.trace(p.reshape(-1, N, N), axis1=1, axis2=2)).max(), np.abs(p).max()
        if trace > 1e-10 * max(size, 1e-300):
            raise ValueError(
                f"initial_plastic_strain has trace up to {trace:g}: plastic strains are trace-free"
            )
    if problem.initial_strain is not None:
        require_coefficient("initial_strain", problem.initial_strain, [(), (N, N)])
        require_finite("initial_strain", problem.initial_strain, mesh)
        _check_symmetric("initial_strain", sample(problem.eps_0, mesh).reshape(-1, N, N))
    if isinstance(problem.initial_hardening, tuple) and len(problem.initial_hardening) != 2:
        raise ValueError(
            f"initial_hardening={problem.initial_hardening!r}: a scalar, an {N} x {N} "
            "coefficient or the pair of both is needed"
        )
    scalar, back_stress = split_hardening(problem.initial_hardening)
    if scalar is not None:
        require_coefficient("initial_hardening", scalar)
        least = _least("initial_hardening", scalar, problem)
        if least < 0:
            raise ValueError(f"initial_hardening falls to {least:g}: alpha_1 >= 0 is needed")
    if back_stress is not None:
        require_coefficient("initial_hardening", back_stress, [(N, N)])
        samples = require_finite("initial_hardening", back_stress, mesh)
        _check_symmetric("initial_hardening", samples.reshape(-1, N, N))
    if problem.initial_accumulated is not None:
        require_coefficient("initial_accumulated", problem.initial_accumulated)
        least = _least("initial_accumulated", problem.initial_accumulated, problem)
        if least < 0:
            raise ValueError(f"initial_accumulated falls to {least:g}: values >= 0 are needed")


def _least(name: str, value: Coefficient, problem: Given) -> float:
    """The least value at the integration points, where histories live; below rounding it is 0.

    Between them the polynomials that earlier steps leave may fall below what they interpolate.
    """
    require_finite(name, value, problem.mesh)
    if not isinstance(value, CoefficientFunction):
        return float(value)
    mesh = problem.mesh
    points = mesh.MapToAllElements(plastic_points(mesh, problem.order), mesh.Materials(".*"))
    values = np.ravel(value(points))
    return 0.0 if values.min() >= -1e-14 * np.abs(values).max() else float(values.min())


def _check_symmetric(name: str, A: np.ndarray) -> None:
    if np.abs(A - A.transpose(0, 2, 1)).max() > 1e-10 * np.abs(A).max():
        raise ValueError(f"{name} is not symmetric")
