"""Rigid obstacles as gaps: what stands against u . n <= psi in (2.2).

The gap of an obstacle O that is moved by the vector m (a translation) is measured along the
outer unit normal n of the undeformed body,

    psi(x) = t,  where  x + t n  is the point at which the ray enters O + m.

So psi > 0 where body and obstacle are apart, and psi < 0 where the obstacle has been pushed in:
then the point must retreat by |psi|.  This is the linearised (small-strain) condition: neither
the normal nor the point x follow the displacement.  Planes, spheres, cylinders and cavities use
the ray itself, in closed form; ``SignedDistance`` uses its first order,

    psi(x) = phi(x - m) / (-grad phi(x - m) . n),

which is exact for a plane.  Where the ray never enters the obstacle, or only behind the body,
the gap is ``far``, a finite number that no small displacement reaches: ten times the largest
extent of the body unless it is given.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, InnerProduct, Mesh, sqrt, x, y, z

from ngepc.checks.arguments import (
    Coefficient,
    require_coefficient,
    require_finite,
    require_number,
    require_vector,
)
from ngepc.checks.kinds import require_instance
from ngepc.model.elements import vertex_coordinates
from ngepc.model.given import as_vector
from ngepc.model.normals import outward_normal

COORDINATES = (x, y, z)

Field = CoefficientFunction
"""A scalar or vector on the boundary of the body."""


class Obstacle(ABC):
    """A rigid body; ``gap`` turns it and a motion into a gap for a Problem."""

    def dimensions(self) -> tuple[int, ...]:
        """Space dimensions N in which it makes sense: as many as its vectors have components."""
        return tuple({len(v) for v in vars(self).values() if isinstance(v, tuple)}) or (2, 3)

    @abstractmethod
    def along(self, X: Field, n: Field, far: float) -> Field:
        """The entry t of the ray X + t n into the obstacle at rest, ``far`` if there is none."""

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
            Gap where the obstacle is out of the way (length), > 0.

        Raises
        ------
        TypeError, ValueError
            For a mesh of the wrong dimension or data out of their ranges.
        """
        require_instance("mesh", mesh, Mesh, "an ngsolve.Mesh")
        N = mesh.dim
        if N not in self.dimensions():
            legal = " or ".join(map(str, self.dimensions()))
            raise ValueError(f"{self!r} needs a mesh of dimension {legal}, this one has {N}")
        if far is None:
            far = 10 * float(np.ptp(vertex_coordinates(mesh), axis=0).max())
        far = require_number("far", far, 0, strict=True)
        X = CF(COORDINATES[:N])
        if motion is not None:
            X = X - _motion(motion, N)
        self._check_data(X, mesh)
        return self.along(X, outward_normal(mesh), far)

    def _check_data(self, X: Field, mesh: Mesh) -> None:
        """Raise ValueError where the data of the obstacle at ``X`` make no gap."""
        require_finite("motion", X, mesh, sorted(set(mesh.GetBoundaries())))

    def _keep(self, **legal: object) -> None:
        """Replace fields by what checks have made of them."""
        for name, value in legal.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Plane(Obstacle):
    """The half-space behind the plane through ``point`` whose ``normal`` points at the body."""

    point: Sequence[float]
    normal: Sequence[float]

    def __post_init__(self) -> None:
        self._keep(point=require_vector("point", self.point, (2, 3)))
        self._keep(normal=_unit("normal", self.normal, len(self.point)))

    def along(self, X: Field, n: Field, far: float) -> Field:
        """T = (X - point) . m / (-n . m) for the plane's normal m, where n . m < 0."""
        m = CF(self.normal)
        return _quotient(InnerProduct(X - CF(self.point), m), -InnerProduct(n, m), far)


class Round(Obstacle):
    """An obstacle whose surface is where a quadratic function vanishes along each ray."""

    @abstractmethod
    def quadratic(self, X: Field, n: Field) -> tuple[Field, Field, Field]:
        """(a, b, c) of the square of the distance at X + t n less radius^2, a t^2 + 2 b t + c."""

    def along(self, X: Field, n: Field, far: float) -> Field:
        """The smaller root, unless both are behind the surface of the body."""
        a, b, c = self.quadratic(X, n)
        discriminant = b * b - a * c
        root = _root(discriminant)
        hit = IfPos(discriminant, IfPos(root - b, 1.0, -1.0), -1.0)
        return IfPos(hit, _quotient(-b - root, a, far), far)


@dataclass(frozen=True)
class Sphere(Round):
    """A ball, in two dimensions a disc, with ``centre`` and ``radius`` > 0."""

    centre: Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        self._keep(centre=require_vector("centre", self.centre, (2, 3)))
        self._keep(radius=require_number("radius", self.radius, 0, strict=True))

    def quadratic(self, X: Field, n: Field) -> tuple[Field, Field, Field]:
        """That of the distance from the centre."""
        return _square(X - CF(self.centre), n, self.radius)


Disc = Sphere


@dataclass(frozen=True)
class Cylinder(Round):
    """An infinite round cylinder around the line through ``point`` along ``axis``, in 3D."""

    point: Sequence[float]
    axis: Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        self._keep(point=require_vector("point", self.point, (3,)))
        self._keep(axis=_unit("axis", self.axis, 3))
        self._keep(radius=require_number("radius", self.radius, 0, strict=True))

    def quadratic(self, X: Field, n: Field) -> tuple[Field, Field, Field]:
        """That of the distance from the axis."""
        axis = CF(self.axis)
        d, m = (v - InnerProduct(v, axis) * axis for v in (X - CF(self.point), n))
        return _square(d, m, self.radius)


@dataclass(frozen=True)
class Cavity(Obstacle):
    """Everything outside a Sphere (Disc) or Cylinder: a rigid ring or bore around the body."""

    inside: Round

    def __post_init__(self) -> None:
        require_instance("inside", self.inside, Round, "a Sphere, Disc or Cylinder")

    def dimensions(self) -> tuple[int, ...]:
        """Those of the hollow."""
        return self.inside.dimensions()

    def along(self, X: Field, n: Field, far: float) -> Field:
        """The larger root, unless n points from the wall into the hollow."""
        a, b, c = self.inside.quadratic(X, n)
        t = _quotient(_root(b * b - a * c) - b, a, far)
        return IfPos(IfPos(c, IfPos(b, -1.0, 1.0), -1.0), far, t)


@dataclass(frozen=True, eq=False)
class SignedDistance(Obstacle):
    """An obstacle {phi <= 0} of any shape, to first order.

    Parameters
    ----------
    distance
        phi (length), a scalar coefficient in the coordinates x, y, z: the distance to the
        obstacle, negative inside.  Any level set function with a gradient does, to first order.
    gradient
        grad phi, a vector coefficient; None to differentiate ``distance``.  It is needed where
        ``distance`` contains a GridFunction, and then the motion enters to first order,
        phi(x) - grad phi(x) . m.
    """

    distance: CoefficientFunction
    gradient: CoefficientFunction | None = None

    def __post_init__(self) -> None:
        require_instance("distance", self.distance, CoefficientFunction, "a CoefficientFunction")
        require_coefficient("distance", self.distance)
        if self.gradient is not None:
            kind = CoefficientFunction, "a CoefficientFunction"
            require_instance("gradient", self.gradient, *kind)
            require_coefficient("gradient", self.gradient, [(2,), (3,)])
        elif "GridFunction" in str(self.distance):
            raise ValueError("distance contains a GridFunction: its gradient is needed too")

    def dimensions(self) -> tuple[int, ...]:
        """Those of the gradient, otherwise any."""
        return (2, 3) if self.gradient is None else tuple(self.gradient.dims)

    def along(self, X: Field, n: Field, far: float) -> Field:
        """T = phi / (-grad phi . n) where the obstacle faces the body."""
        phi, gradient = self._level(X)
        return _quotient(phi, -InnerProduct(gradient, n), far)

    def _level(self, X: Field) -> tuple[Field, Field]:
        """Phi and grad phi at ``X``."""
        own = COORDINATES[: X.dim]
        if self.gradient is not None:
            return self.distance + InnerProduct(self.gradient, X - CF(own)), self.gradient
        moved = {c: X[i] for i, c in enumerate(own)}
        gradient = CF(tuple(self.distance.Diff(c).Replace(moved) for c in own))
        return self.distance.Replace(moved), gradient

    def _check_data(self, X: Field, mesh: Mesh) -> None:
        super()._check_data(X, mesh)
        phi, gradient = self._level(X)
        everywhere = sorted(set(mesh.GetBoundaries()))
        require_finite("distance", phi, mesh, everywhere)
        if not require_finite("the gradient of distance", gradient, mesh, everywhere).any():
            raise ValueError(
                "distance has no gradient on the boundary: the signed distance to the obstacle "
                "in the coordinates x, y, z is needed"
            )


def _square(d: Field, n: Field, radius: float) -> tuple[Field, Field, Field]:
    """(a, b, c) of |d + t n|^2 - radius^2 = a t^2 + 2 b t + c."""
    return InnerProduct(n, n), InnerProduct(d, n), InnerProduct(d, d) - radius**2


def _root(discriminant: Field) -> Field:
    """The square root, 0 where there is none."""
    return sqrt(IfPos(discriminant, discriminant, 0.0))


def _quotient(numerator: Field, facing: Field, far: float) -> Field:
    """Numerator / facing where facing > 0, kept within [-far, far]; otherwise ``far``."""
    t = numerator / IfPos(facing - 1e-12, facing, 1.0)
    capped = IfPos(t - far, far, IfPos(-far - t, -far, t))
    return IfPos(facing - 1e-12, capped, far)


def _motion(motion: Sequence[Coefficient], N: int) -> CoefficientFunction:
    """The translation as a vector."""
    require_instance("motion", motion, (tuple, list, np.ndarray), f"a sequence of {N} components")
    if len(motion) != N:
        raise ValueError(f"motion={motion!r}: {N} components are needed")
    for i, component in enumerate(motion):
        require_coefficient(f"motion[{i}]", component)
    return as_vector(motion)


def _unit(name: str, value: object, N: int) -> tuple[float, ...]:
    """The vector divided by its length."""
    vector = np.array(require_vector(name, value, (N,)))
    if not vector.any():
        raise ValueError(f"{name}={value!r}: a vector other than zero is needed")
    return tuple((vector / np.linalg.norm(vector)).tolist())
