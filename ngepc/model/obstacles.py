"""Rigid obstacles: the gap psi in u . n <= psi, (2.1).

An obstacle is where a level function phi is <= 0.  Its gap, after a translation by the vector m, is
measured along the outer unit normal n of the undeformed body,

    psi(x) = t,  where  x + t n  is the point at which the ray enters it,  phi(x - m + t n) = 0.

So psi > 0 where body and obstacle are apart, and psi < 0 where the obstacle has been pushed in:
then the point must retreat by |psi|.  This is the linearised (small-strain) condition: neither
the normal nor the point x follow the displacement.  With phi = a t^2 + 2 b t + c on the ray

    t = c / ((b^2 - a c)^(1/2) - b);

planes have a = 0, spheres and cylinders a > 0, what is outside of them a < 0.  ``SignedDistance``
takes the first order of its phi, exact for a plane.  Where the ray never enters the obstacle, or
only behind the body, the gap is ``far``, a finite number that no small displacement reaches: ten
times the largest extent of the body unless it is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, InnerProduct, Mesh, sqrt, x, y, z

from ngepc.checks.arguments import (
    Coefficient,
    require_coefficient,
    require_components,
    require_direction,
    require_field,
    require_number,
    require_vector,
)
from ngepc.checks.declared import Along, Check, Declared, Positive, Vector
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.model.elements import outward_normal, vertex_coordinates
from ngepc.model.processes import processes_of

COORDINATES = (x, y, z)

Field = CoefficientFunction
"""A scalar or vector on the boundary of the body."""


class Obstacle(Declared):
    """A rigid body; ``gap`` turns it and a motion into a gap for a Problem.

    A subclass defines ``level`` or, if that is no polynomial, ``along``.
    """

    def dimensions(self) -> tuple[int, ...]:
        """Legal space dimensions N: the number of components of its vectors."""
        return tuple({len(v) for v in vars(self).values() if isinstance(v, tuple)}) or (
            2,
            3,
        )

    def level(self, X: Field, n: Field) -> tuple[Field | float, Field, Field]:
        """(a, b, c) of the level function a t^2 + 2 b t + c at the points X + t n."""
        raise NotImplementedError(
            f"{type(self).__name__}: a method level or along is needed"
        )

    def along(self, X: Field, n: Field, far: float) -> Field:
        """Distance t at which the ray X + t n enters the obstacle; ``far`` if it does not."""
        a, b, c = self.level(X, n)
        discriminant = b * b - a * c
        onward = IfPos(discriminant, sqrt(discriminant) - b, IfPos(CF(a), -1.0, -b))
        t = c / onward
        return IfPos(onward - 1e-12, IfPos(t - far, far, IfPos(-far - t, -far, t)), far)

    def gap(
        self,
        mesh: Mesh,
        motion: Sequence[Coefficient] | None = None,
        *,
        far: float | None = None,
    ) -> CoefficientFunction:
        """The gap psi (length), a scalar coefficient for ``Problem(gap=...)``.

        Parameters
        ----------
        mesh
            Mesh of the body; the gap is evaluated on its boundary.
        motion
            Translation m of the obstacle (length), N numbers or scalar coefficients, such as a
            ``Parameter`` that a load history changes; None for rest.
        far
            Gap where the ray does not meet the obstacle (length), > 0.

        Raises
        ------
        TypeError, ValueError
            For a mesh of the wrong dimension or data out of their ranges.
        """
        require_instance("mesh", mesh, Mesh, "an ngsolve.Mesh")
        N = mesh.dim
        X = CF(COORDINATES[: mesh.dim])
        if N not in self.dimensions():
            legal = " or ".join(map(str, self.dimensions()))
            raise ValueError(
                f"{in_words(self)} needs a mesh of dimension {legal}, this one has {N}"
            )
        if far is None:
            extent = processes_of(mesh).extent(vertex_coordinates(mesh))
            far = 10 * float(extent.max())
        far = require_number("far", far, 0, strict=True)
        if motion is not None:
            X = X - require_components("motion", motion, N)
        self._check_data(X, mesh)
        return self.along(X, outward_normal(mesh), far)

    def _check_data(self, X: Field, mesh: Mesh) -> None:
        """Raise ValueError where the data of the obstacle do not define a gap."""
        names = sorted(set(mesh.GetBoundaries()))
        require_field("motion", X, mesh, names, shapes=[(mesh.dim,)])


@dataclass(frozen=True)
class Plane(Obstacle):
    """The half-space behind the plane through ``point`` whose ``normal`` points at the body."""

    point: Vector
    normal: Along

    def __post_init__(self) -> None:
        super().__post_init__()
        require_vector("normal", self.normal, (len(self.point),))

    def level(self, X: Field, n: Field) -> tuple[float, Field, Field]:
        """That of the height over the plane."""
        m = CF(self.normal)
        return 0.0, InnerProduct(n, m) / 2, InnerProduct(X - CF(self.point), m)


@dataclass(frozen=True)
class Sphere(Obstacle):
    """A ball, in two dimensions a disc, with ``centre`` and ``radius`` > 0."""

    centre: Vector
    radius: Positive

    def level(self, X: Field, n: Field) -> tuple[Field, Field, Field]:
        """That of |X - centre|^2 - radius^2."""
        return _round(X - CF(self.centre), n, self.radius)


Disc = Sphere


@dataclass(frozen=True)
class Cylinder(Obstacle):
    """An infinite round cylinder around the line through ``point`` along ``axis``, in 3D."""

    point: Annotated[Sequence[float], Check(require_vector, lengths=(3,))]
    axis: Annotated[Sequence[float], Check(require_direction, lengths=(3,))]
    radius: Positive

    def level(self, X: Field, n: Field) -> tuple[Field, Field, Field]:
        """As for ``Sphere``, across the axis."""
        axis = CF(self.axis)
        d, m = (v - InnerProduct(v, axis) * axis for v in (X - CF(self.point), n))
        return _round(d, m, self.radius)


@dataclass(frozen=True, eq=False)
class SignedDistance(Obstacle):
    """An obstacle {phi <= 0} of any shape, to first order.

    Parameters
    ----------
    distance
        phi (length), a scalar coefficient in the coordinates x, y, z: the distance to the
        obstacle, negative inside.  Any level set function with a gradient does, to first order.
    """

    distance: CoefficientFunction

    def __post_init__(self) -> None:
        require_instance(
            "distance", self.distance, CoefficientFunction, "a CoefficientFunction"
        )
        require_coefficient("distance", self.distance)
        if "GridFunction" in str(self.distance):
            raise ValueError(
                "distance contains a GridFunction: a formula in x, y, z is needed"
            )

    def level(self, X: Field, n: Field) -> tuple[float, Field, Field]:
        """That of phi + t grad phi . n."""
        moved = {c: X[i] for i, c in enumerate(COORDINATES[: X.dim])}
        gradient = CF(tuple(self.distance.Diff(c).Replace(moved) for c in moved))
        return 0.0, InnerProduct(gradient, n) / 2, self.distance.Replace(moved)

    def _check_data(self, X: Field, mesh: Mesh) -> None:
        super()._check_data(X, mesh)
        names = sorted(set(mesh.GetBoundaries()))
        axes = np.eye(mesh.dim).tolist()
        require_field("distance", self.level(X, X)[2], mesh, names)
        gradient = CF(tuple(self.level(X, CF(tuple(axis)))[1] for axis in axes))
        found = require_field("distance", gradient, mesh, names, shapes=[(mesh.dim,)])
        if len(found) and not found.any():  # a part of a body may have no boundary
            raise ValueError(
                "distance has no gradient on the boundary: one in x, y, z is needed"
            )


def _round(d: Field, n: Field, radius: float) -> tuple[Field, Field, Field]:
    """(a, b, c) of |d + t n|^2 - radius^2 = a t^2 + 2 b t + c."""
    return InnerProduct(n, n), InnerProduct(d, n), InnerProduct(d, d) - radius**2
