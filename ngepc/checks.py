"""What makes a problem well posed, checked before any work is done.

NGSolve accepts misspelt boundaries, singular supports and NaN in silence; here each is an error
that names the argument, its value and what is legal.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from ngsolve import CoefficientFunction, Det, Mesh, specialcf

from ngepc.material import Material
from ngepc.validation import (
    boundary_names,
    require_coefficient,
    require_finite,
    sample,
)

if TYPE_CHECKING:
    from ngepc.problem import Problem


def check_problem(problem: Problem) -> None:
    """Raise TypeError or ValueError for the first thing that is wrong with ``problem``."""
    check_mesh(problem.mesh)
    check_material(problem.material, problem.mesh)
    check_boundaries(problem)
    check_loads(problem)
    check_gap(problem)
    check_history(problem)
    check_support(problem)


def check_mesh(mesh: Mesh) -> None:
    """A mesh in two or three dimensions with elements of positive size, all oriented alike."""
    if not isinstance(mesh, Mesh):
        raise TypeError(f"mesh={mesh!r}: an ngsolve.Mesh is needed")
    if mesh.dim not in (2, 3):
        raise ValueError(f"mesh has dimension {mesh.dim}: 2 or 3 is needed")
    if mesh.ne == 0:
        raise ValueError("mesh has no elements: a mesh of the body is needed")
    size = sample(Det(specialcf.JacobianMatrix(mesh.dim)), mesh)
    if not np.isfinite(size).all() or np.abs(size).min() <= 1e-14 * np.abs(size).max():
        raise ValueError("mesh has degenerate elements (zero area or volume)")
    if size.min() < 0 < size.max():
        raise ValueError("mesh has inverted elements (Jacobian determinants of both signs)")


def check_material(material: Material, mesh: Mesh) -> None:
    """Elliptic elasticity, positive yield stress and hardening everywhere on the mesh."""
    if not isinstance(material, Material):
        raise TypeError(f"material={material!r}: a Material is needed")
    N = mesh.dim
    for name in ("lame_lambda", "hardening", "hardening_modulus", "hardening_stiffness"):
        values = require_finite(name, getattr(material, name), mesh)
        if name != "lame_lambda" and values.min() < 0:
            raise ValueError(f"{name} falls to {values.min():g}: values >= 0 are needed")
    for name in ("lame_mu", "yield_stress"):
        values = require_finite(name, getattr(material, name), mesh)
        if values.min() <= 0:
            raise ValueError(f"{name} falls to {values.min():g}: values > 0 are needed")
    bulk = sample(N * material.lame_lambda + 2 * material.lame_mu, mesh).min()
    if bulk <= 0:
        raise ValueError(
            f"lame_lambda={material.lame_lambda!r}: the elasticity is not elliptic, "
            f"{N} lambda + 2 mu falls to {bulk:g}, > 0 is needed in {N} dimensions"
        )
    h = sample(material.effective_hardening, mesh).min()
    if h <= 0:
        raise ValueError(
            f"the hardening h = k + (H sigma_y)^2 k_1 falls to {h:g}: > 0 is needed, "
            "the method is for hardening plasticity (perfect plasticity is not)"
        )


def check_boundaries(problem: Problem) -> None:
    """Existing names; nothing both clamped and something else; contact away from clamped."""
    mesh, clamped, contact = problem.mesh, problem.clamped_names, problem.contact_names
    for argument in ("traction", "prescribed"):
        given = getattr(problem, argument)
        if given is not None and not isinstance(given, Mapping):
            raise TypeError(f"{argument}={given!r}: a mapping of boundary name -> value is needed")
    loaded = _keys("traction", problem.traction, mesh)
    prescribed = _keys("prescribed", problem.prescribed, mesh)
    for name, others in {"contact": contact, "traction": loaded, "prescribed": prescribed}.items():
        twice = sorted(set(clamped) & set(others))
        if twice:
            raise ValueError(
                f"{name} and clamped overlap in {', '.join(twice)}: "
                "a clamped boundary carries nothing else"
            )
    if contact and clamped and vertices_of(mesh, clamped) & vertices_of(mesh, contact):
        raise ValueError(
            f"contact={problem.contact!r} meets clamped={problem.clamped!r}: the closed "
            "contact boundary must keep away from the clamped one, (2.2)"
        )


def _keys(argument: str, given: Mapping | None, mesh: Mesh) -> list[str]:
    keys = [n for names in (given or {}) for n in boundary_names(argument, names, mesh)]
    twice = sorted({n for n in keys if keys.count(n) > 1})
    if twice:
        raise ValueError(f"{argument} names {', '.join(twice)} more than once")
    return keys


def vertices_of(mesh: Mesh, names: tuple[str, ...]) -> set[int]:
    """Numbers of the vertices on the named boundaries, ends included."""
    return {v.nr for el in mesh.Boundaries("|".join(names)).Elements() for v in el.vertices}


def check_loads(problem: Problem) -> None:
    """Finite vector loads and prescribed displacements of N components."""
    N, mesh = problem.N, problem.mesh
    for name, g in (problem.traction or {}).items():
        for single in boundary_names("traction", name, mesh):
            _check_vector(f"traction[{single!r}]", g, N)
            require_finite(f"traction[{single!r}]", problem.tractions[single], mesh, [single])
    if problem.body_force is not None:
        _check_vector("body_force", problem.body_force, N)
        require_finite("body_force", problem.f, mesh)
    for name, components in (problem.prescribed or {}).items():
        for single in boundary_names("prescribed", name, mesh):
            argument = f"prescribed[{single!r}]"
            if not isinstance(components, tuple | list) or len(components) != N:
                raise ValueError(
                    f"{argument}={components!r}: {N} components are needed, None for a free one"
                )
            for c in components:
                if c is not None:
                    require_coefficient(argument, c)
                    require_finite(argument, c, mesh, [single])


def _check_vector(argument: str, value: object, N: int) -> None:
    if isinstance(value, CoefficientFunction):
        require_coefficient(argument, value, [(N,)])
    elif isinstance(value, tuple | list):
        if len(value) != N:
            raise ValueError(f"{argument}={value!r}: {N} components are needed")
        for component in value:
            require_coefficient(argument, component)
    else:
        raise TypeError(f"{argument}={value!r}: a vector of {N} components is needed")


def check_gap(problem: Problem) -> None:
    """A finite gap on the contact boundary, and none without one."""
    if problem.contact is None:
        if problem.gap is not None:
            raise ValueError(
                f"gap={problem.gap!r}: name the contact boundary too, or leave gap out"
            )
        return
    if problem.gap is None:
        raise ValueError(f"contact={problem.contact!r} needs a gap: a number or coefficient")
    names = problem.contact_names
    if isinstance(problem.gap, Mapping) and sorted(problem.gap) != sorted(names):
        raise ValueError(
            f"gap names {sorted(problem.gap)}: the contact boundaries are {sorted(names)}"
        )
    gaps = problem.gap if isinstance(problem.gap, Mapping) else dict.fromkeys(names, problem.gap)
    for name, gap in gaps.items():
        require_coefficient("gap", gap)
        require_finite("gap", gap, problem.mesh, [name])


def check_history(problem: Problem) -> None:
    """Initial plastic strain symmetric and trace-free, initial hardening of the right kind."""
    from ngepc.problem import split_hardening

    N, mesh = problem.N, problem.mesh
    if problem.initial_plastic_strain is not None:
        require_coefficient("initial_plastic_strain", problem.initial_plastic_strain, [(N, N)])
        p = require_finite("initial_plastic_strain", problem.initial_plastic_strain, mesh)
        _check_symmetric("initial_plastic_strain", p.reshape(-1, N, N))
        trace, size = np.abs(np.trace(p.reshape(-1, N, N), axis1=1, axis2=2)).max(), np.abs(p).max()
        if trace > 1e-10 * max(size, 1e-300):
            raise ValueError(
                f"initial_plastic_strain has trace up to {trace:g}: plastic strains are trace-free"
            )
    if isinstance(problem.initial_hardening, tuple) and len(problem.initial_hardening) != 2:
        raise ValueError(
            f"initial_hardening={problem.initial_hardening!r}: a scalar, an {N} x {N} "
            "coefficient or the pair of both is needed"
        )
    scalar, back_stress = split_hardening(problem.initial_hardening)
    if scalar is not None:
        require_coefficient("initial_hardening", scalar)
        if require_finite("initial_hardening", scalar, mesh).min() < 0:
            raise ValueError("initial_hardening falls below 0: the scalar alpha_1 must be >= 0")
    if back_stress is not None:
        require_coefficient("initial_hardening", back_stress, [(N, N)])
        samples = require_finite("initial_hardening", back_stress, mesh)
        _check_symmetric("initial_hardening", samples.reshape(-1, N, N))


def _check_symmetric(name: str, A: np.ndarray) -> None:
    if np.abs(A - A.transpose(0, 2, 1)).max() > 1e-10 * np.abs(A).max():
        raise ValueError(f"{name} is not symmetric")


def check_support(problem: Problem) -> None:
    """Clamped and prescribed components rule out rigid motions of every connected part."""
    mesh, N = problem.mesh, problem.N
    held = [(name, range(N)) for name in problem.clamped_names]
    held += [
        (single, [i for i, c in enumerate(components) if c is not None])
        for names, components in (problem.prescribed or {}).items()
        for single in boundary_names("prescribed", names, mesh)
    ]
    x = np.asarray(mesh.ngmesh.Coordinates())[:, :N]
    part = connected_parts(mesh)
    for number in np.unique(part):
        centre = x[part == number].mean(axis=0)
        rows = [
            _rigid_rows(x[v] - centre, i)
            for name, components in held
            for v in sorted(vertices_of(mesh, (name,)))
            if part[v] == number
            for i in components
        ]
        needed = N * (N + 1) // 2
        extent = np.ptp(x[part == number], axis=0).max()
        scale = np.r_[np.ones(N), np.full(needed - N, extent)]
        rank = np.linalg.matrix_rank(np.array(rows) / scale, tol=1e-8) if rows else 0
        if rank < needed:
            raise ValueError(
                f"clamped={problem.clamped!r} and prescribed={problem.prescribed!r} leave "
                f"{needed - rank} rigid motion(s) of the part around {centre.round(6).tolist()}: "
                "every connected part must be held"
            )


def _rigid_rows(x: np.ndarray, i: int) -> np.ndarray:
    """Component i of the rigid motions (translations, rotations) at the point x."""
    N = len(x)
    translations = np.eye(N)[i]
    pairs = [(a, b) for a in range(N) for b in range(a + 1, N)]
    rotations = [x[b] * (i == a) - x[a] * (i == b) for a, b in pairs]
    return np.r_[translations, rotations]


def connected_parts(mesh: Mesh) -> np.ndarray:
    """For each vertex the smallest vertex number of its connected part, shape (vertices,)."""
    elements = element_vertices(mesh)
    label = np.arange(mesh.nv)
    while True:
        smallest = label.copy()
        for nodes in elements:
            np.minimum.at(smallest, nodes, label[nodes].min(axis=1, keepdims=True))
        smallest = smallest[smallest]
        if (smallest == label).all():
            return label
        label = smallest


def element_vertices(mesh: Mesh) -> list[np.ndarray]:
    """Vertex numbers of the elements, an array (elements, vertices) for each shape."""
    netgen_mesh = mesh.ngmesh
    elements = netgen_mesh.Elements2D() if mesh.dim == 2 else netgen_mesh.Elements3D()
    nodes = elements.NumPy()["nodes"].astype(int)[:, : 2**mesh.dim] - 1
    count = (nodes >= 0).sum(axis=1)
    return [nodes[count == k][:, :k] for k in np.unique(count)]
