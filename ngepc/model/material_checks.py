"""Checks of a material on the mesh and in the kinematics of a problem."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from ngsolve import Mesh

from ngepc.checks.arguments import (
    is_number,
    require_datum,
    require_field,
    require_in,
    sample,
)
from ngepc.checks.declared import declared_checks
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.model.data import ProblemData, as_scalar
from ngepc.model.hardening import check_law
from ngepc.model.hill import Hill
from ngepc.model.kinematics import TWO_DIMENSIONAL
from ngepc.model.material import Material
from ngepc.model.viscosity import check_rate


def check_material(problem: ProblemData) -> None:
    """Elliptic elasticity, positive yield stress and hardening everywhere; radii x >= 0."""
    material = problem.material
    mesh = problem.mesh
    require_instance("material", material, Material, "a Material")
    for name, check in declared_checks(Material).items():
        if check.func is require_datum:
            require_field(name, getattr(material, name), mesh, **check.keywords)
    check_elasticity(problem)
    if material.data_sheet and problem.kinematics is TWO_DIMENSIONAL:
        needed = "its factors are those of three dimensions, Material.kinematic or"
        raise ValueError(
            f'kinematics="two-dimensional" with {in_words(material)}: {needed} '
            "Material.isotropic is needed"
        )
    if material.law is not None:
        check_law(material.law, mesh)
    if material.rate is not None:
        check_rate(material.rate, mesh)
    if material.hill is not None:
        check_hill(problem)
    if material.overlay is not None:
        check_overlay(problem)
    check_hardening(problem)
    if problem.kinematics.hoop:
        check_radii(mesh)


def check_elasticity(problem: ProblemData) -> None:
    """A positive bulk modulus of N x N tensors; the shear modulus is checked as a field."""
    material = problem.material
    N = problem.kinematics.size
    bulk = N * material.lame_lambda + 2 * material.lame_mu
    name = f"{N} lame_lambda + 2 lame_mu"
    least = require_in(name, sample(bulk, problem.mesh), "the body").min()
    if least <= 0:
        raise ValueError(
            f"lame_lambda={in_words(material.lame_lambda)}: the elasticity is not elliptic, "
            f"{N} lambda + 2 mu falls to {least:g}, > 0 is needed for {N} x {N} tensors"
        )


def check_hardening(problem: ProblemData) -> None:
    """Positive linear hardening, of a material without another law."""
    material = problem.material
    name = "the hardening h = k + (H sigma_y)^2 k_1"
    h = sample(material.effective_hardening, problem.mesh)
    least = require_in(name, h, "the body").min()
    if least <= 0 and material.law is None and material.overlay is None:
        raise ValueError(
            f"{name} falls to {least:g}: > 0 is needed, "
            "the method is for hardening plasticity (perfect plasticity is a Tabulated law)"
        )


def check_radii(mesh: Mesh) -> None:
    """The mesh of a body of revolution has no vertex beyond the axis."""
    radii = np.asarray(mesh.ngmesh.Coordinates())[:, 0]
    if radii.min() < -1e-12 * np.abs(radii).max():
        reach = f"the mesh reaches to x = {radii.min():g}, radii x >= 0 are needed"
        raise ValueError(f'kinematics="axisymmetric": {reach}')


def check_hill(problem: ProblemData) -> None:
    """Anisotropic yield, of a body in three dimensions."""
    material = problem.material
    if problem.kinematics is TWO_DIMENSIONAL:
        raise ValueError(
            f'kinematics="two-dimensional" with hill={in_words(material.hill)}: '
            "another kinematics is needed, the ellipsoid has three axes"
        )
    data = [(field.name, getattr(material.hill, field.name)) for field in fields(Hill)]
    samples = np.broadcast_arrays(
        *(require_field(f"hill.{n}", datum, problem.mesh)[:, 0] for n, datum in data)
    )
    ids = [id(datum) for _, datum in data]
    values = dict(zip(ids, samples, strict=True))
    material.hill.form(problem.kinematics.basis, lambda datum: values[id(datum)])


def check_overlay(problem: ProblemData) -> None:
    """Sub-elements without other hardening, of a body in three dimensions."""
    material = problem.material
    overlay = material.overlay
    if problem.kinematics is TWO_DIMENSIONAL:
        raise ValueError(
            f'kinematics="two-dimensional" with overlay={in_words(overlay)}: '
            "another kinematics is needed, the curve is that of a bar in three dimensions"
        )
    for name in ("hardening", "hardening_modulus", "law", "rate", "hill"):
        value = getattr(material, name)
        absent = value is None or (is_number(value) and value == 0)
        if not absent:
            raise ValueError(
                f"{name}={in_words(value)} with overlay={in_words(overlay)}: leave one of them out"
            )
    first = sample(as_scalar(material.yield_stress), problem.mesh)
    if not np.allclose(first, overlay.bounds[0], rtol=1e-12):
        raise ValueError(
            f"yield_stress={in_words(material.yield_stress)} with "
            f"overlay={in_words(overlay)}: the first bound, "
            f"{overlay.bounds[0]:g}, is needed"
        )
