"""Digests of meshes and problems, so that stored work is taken up by the same work."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from ngsolve import Mesh

from ngepc.checks.arguments import sample
from ngepc.model.contact import Coulomb
from ngepc.model.places import Place, values_at
from ngepc.model.problem import Problem, as_vector


def mesh_fingerprint(mesh: Mesh) -> str:
    """A digest of the vertices and elements of a mesh."""
    netgen_mesh = mesh.ngmesh
    elements = netgen_mesh.Elements2D() if mesh.dim == 2 else netgen_mesh.Elements3D()
    digest = hashlib.sha256(np.ascontiguousarray(netgen_mesh.Coordinates()).tobytes())
    digest.update(np.ascontiguousarray(elements.NumPy()["nodes"]).tobytes())
    return digest.hexdigest()


def problem_fingerprint(problem: Problem) -> str:
    """A digest of all data of a problem but its mesh, sampled on the mesh."""
    mesh, material, digest = problem.mesh, problem.material, hashlib.sha256()
    names = (problem.clamped_names, problem.contact_names)
    names += problem.contact_pairs
    digest.update(repr((*names, problem.kinematics.name, problem.order)).encode())
    body = [material.lame_lambda, material.lame_mu, material.effective_hardening]
    body += [material.hardening, problem.beta, problem.p_0, *problem.alpha_0]
    body += [] if problem.f is None else [problem.f]
    body += [] if problem.initial_strain is None else [problem.eps_0]
    if material.law is not None:
        body += [problem.accumulated_0, *material.law.data]
        digest.update(type(material.law).__qualname__.encode())
    for value in body:
        digest.update(sample(value, mesh).tobytes())
    for kind in (problem.tractions, problem.gaps):
        for name, value in sorted(kind.items()):
            digest.update(name.encode() + sample(value, mesh, [name]).tobytes())
    if problem.friction is not None:
        law = problem.friction
        value = law.coefficient if isinstance(law, Coulomb) else law
        digest.update(b"Coulomb" if isinstance(law, Coulomb) else b"Tresca")
        digest.update(sample(value, mesh, list(problem.touching_names)).tobytes())
    if problem.initial_displacement is not None:
        digest.update(sample(as_vector(problem.initial_displacement), mesh).tobytes())
    for place, components in sorted(problem.held_components.items(), key=str):
        digest.update(str(place).encode())
        _digest_at(digest, problem, place, components)
    for place, roller in sorted(problem.rollers.items(), key=str):
        digest.update(repr((place, roller.direction)).encode())
        _digest_at(digest, problem, place, [roller.value])
    for place, k in sorted(problem.spring_constants.items(), key=str):
        digest.update(f"springs {place}".encode())
        _digest_at(digest, problem, place, k if isinstance(k, tuple | list | np.ndarray) else [k])
    for place in problem.concentrated:
        if place in problem.loads:
            _digest_at(digest, problem, place, [problem.loads[place]])
    return digest.hexdigest()


def _digest_at(digest: object, problem: Problem, place: Place, values: Sequence) -> None:
    """Take in coefficients, None for a free component, at the vertices of a place."""
    for value in values:
        digest.update(str(value is None).encode())
        if value is not None:
            digest.update(values_at(value, problem.mesh, place)[1].tobytes())
