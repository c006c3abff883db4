"""Digests of meshes and problems, so that stored work is taken up by the same work."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from ngsolve import Mesh

from ngepc._version import __version__
from ngepc.checks.arguments import sample
from ngepc.model.contact import Coulomb
from ngepc.model.places import values_at
from ngepc.model.problem import Problem


def work_fingerprint(kind: str, problem: Problem, **more: object) -> dict:
    """What stored work belongs to: the version, the mesh, the data, and ``more``."""
    return {
        "kind": kind,
        "version": __version__,
        "mesh": mesh_fingerprint(problem.mesh),
        "problem": problem_fingerprint(problem),
        **more,
    }


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
    names = (problem.clamped_names, problem.contact_names, *problem.contact_pairs)
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
        digest.update(sample(problem.u_0, mesh).tobytes())
    placed = [("held", p, values) for p, values in problem.held_components.items()]
    placed += [(f"roller {r.direction}", p, [r.value]) for p, r in problem.rollers.items()]
    for p, k in problem.spring_constants.items():
        placed.append(("spring", p, k if isinstance(k, Sequence | np.ndarray) else [k]))
    placed += [("load", p, [problem.loads[p]]) for p in problem.concentrated if p in problem.loads]
    for kind, place, values in sorted(placed, key=lambda entry: (entry[0], str(entry[1]))):
        digest.update(f"{kind} {place}".encode())
        for value in values:
            digest.update(b"free" if value is None else values_at(value, mesh, place)[1].tobytes())
    return digest.hexdigest()
