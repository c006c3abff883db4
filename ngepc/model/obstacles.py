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
from ngepc.model.elements import vertex_coordinates
from ngepc.model.normals import outward_normal

COORDINATES = (x, y, z)

Field = CoefficientFunction
"""A scalar or vector on the boundary of the body."""


class Obstacle(ABC):
    """A rigid body; ``gap`` turns it and a motion into a gap for a Problem."""

    @abstractmethod
    def dimensions(self) -> tuple[int, ...]:
        """Space dimensions N in which the obstacle makes sense."""

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
        if not isinstance(mesh, Mesh):
            raise TypeError(f"mesh={mesh!r}: an ngsolve.Mesh is needed")
        N = mesh.dim
        if N not in self.dimensions():
            legal = " or ".join(map(str, self.dimensions()))
            raise ValueError(f"{self!r} needs a mesh of dimension {legal}, this one has {N}")
        if far is None:
            far = 10 * float(np.ptp(vertex_coordinates(mesh), axis=0).max())
        far = require_number("far", far, 0, strict=True)
        X = CF(COORDINATES[:N])
        if motion is not None:
            X = X - _motion(motion, mesh)
        self._check_data(X, mesh)
        return self.along(X, outward_normal(mesh), far)

    def _check_data(self, X: CoefficientFunction, mesh: Mesh) -> None:
        """Raise ValueError where the data of the obstacle at ``X`` make no gap."""
        require_finite("motion", X, mesh, sorted(set(mesh.GetBoundaries())))


@dataclass(frozen=True)
class Plane(Obstacle):
    """The half-space behind the plane through ``point`` whose ``normal`` points at the body."""

    point: Sequence[float]
    normal: Sequence[float]

    def __post_init__(self) -> None:
        _keep(self, "point", require_vector("point", self.point, (2, 3)))
        _keep(self, "normal", _unit("normal", self.normal, (len(self.point),)))

    def dimensions(self) -> tuple[int, ...]:
        """As many as the point has coordinates."""
        return (len(self.point),)

    def along(self, X: Field, n: Field, far: float) -> Field:
        """T = (X - point) . m / (-n . m) for the plane's normal m, where n . m < 0."""
        m = CF(self.normal)
        return _quotient(InnerProduct(X - CF(self.point), m), -InnerProduct(n, m), far)


@dataclass(frozen=True)
class Sphere(Obstacle):
    """A ball, in two dimensions a disc, with ``centre`` and ``radius`` > 0."""

    centre: Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        _keep(self, "centre", require_vector("centre", self.centre, (2, 3)))
        _keep(self, "radius", require_number("radius", self.radius, 0, strict=True))

    def dimensions(self) -> tuple[int, ...]:
        """As many as the centre has coordinates."""
        return (len(self.centre),)

    def quadratic(self, X: CoefficientFunction, n: CoefficientFunction) -> tuple:
        """(a, b, c) of |X + t n - centre|^2 - radius^2 = a t^2 + 2 b t + c."""
        d = X - CF(self.centre)
        return CF(1.0), InnerProduct(d, n), InnerProduct(d, d) - self.radius**2

    def along(self, X: Field, n: Field, far: float) -> Field:
        """The smaller root, unless both are behind the surface of the body."""
        return _entry(*self.quadratic(X, n), far)


Disc = Sphere


@dataclass(frozen=True)
class Cylinder(Obstacle):
    """An infinite round cylinder around the line through ``point`` along ``axis``."""

    point: Sequence[float]
    axis: Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        _keep(self, "point", require_vector("point", self.point, (3,)))
        _keep(self, "axis", _unit("axis", self.axis, (3,)))
        _keep(self, "radius", require_number("radius", self.radius, 0, strict=True))

    def dimensions(self) -> tuple[int, ...]:
        """Three only; in a plane take a ``Sphere``."""
        return (3,)

    def quadratic(self, X: CoefficientFunction, n: CoefficientFunction) -> tuple:
        """(a, b, c) as for ``Sphere``, of the components across the axis."""
        axis = CF(self.axis)
        d = X - CF(self.point)
        d, m = (v - InnerProduct(v, axis) * axis for v in (d, n))
        return InnerProduct(m, m), InnerProduct(d, m), InnerProduct(d, d) - self.radius**2

    def along(self, X: Field, n: Field, far: float) -> Field:
        """The smaller root, unless both are behind the surface of the body."""
        return _entry(*self.quadratic(X, n), far)


@dataclass(frozen=True)
class Cavity(Obstacle):
    """Everything outside a Sphere (Disc) or Cylinder: a rigid ring or bore around the body."""

    inside: Sphere | Cylinder

    def __post_init__(self) -> None:
        if not isinstance(self.inside, Sphere | Cylinder):
            raise TypeError(f"inside={self.inside!r}: a Sphere, Disc or Cylinder is needed")

    def dimensions(self) -> tuple[int, ...]:
        """Those of the hollow."""
        return self.inside.dimensions()

    def along(self, X: Field, n: Field, far: float) -> Field:
        """The larger root, unless n points from the wall into the hollow."""
        a, b, c = self.inside.quadratic(X, n)
        discriminant = b * b - a * c
        t = _quotient(-b + sqrt(IfPos(discriminant, discriminant, 0.0)), a, far)
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
        if not isinstance(self.distance, CoefficientFunction):
            raise TypeError(f"distance={self.distance!r}: a CoefficientFunction is needed")
        require_coefficient("distance", self.distance)
        if self.gradient is not None:
            if not isinstance(self.gradient, CoefficientFunction):
                raise TypeError(f"gradient={self.gradient!r}: a CoefficientFunction is needed")
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

    def _level(self, X: CoefficientFunction) -> tuple[CoefficientFunction, CoefficientFunction]:
        """Phi and grad phi at ``X``."""
        own = COORDINATES[: X.dim]
        if self.gradient is not None:
            return self.distance + InnerProduct(self.gradient, X - CF(own)), self.gradient
        moved = {c: X[i] for i, c in enumerate(own)}
        gradient = CF(tuple(self.distance.Diff(c).Replace(moved) for c in own))
        return self.distance.Replace(moved), gradient

    def _check_data(self, X: CoefficientFunction, mesh: Mesh) -> None:
        super()._check_data(X, mesh)
        phi, gradient = self._level(X)
        everywhere = sorted(set(mesh.GetBoundaries()))
        require_finite("distance", phi, mesh, everywhere)
        if not require_finite("the gradient of distance", gradient, mesh, everywhere).any():
            raise ValueError(
                "distance has no gradient on the boundary: the signed distance to the obstacle "
                "in the coordinates x, y, z is needed"
            )


def _quotient(
    numerator: CoefficientFunction, facing: CoefficientFunction, far: float
) -> CoefficientFunction:
    """Numerator / facing where facing > 0, kept within [-far, far]; otherwise ``far``."""
    safe = IfPos(facing - 1e-12, facing, 1.0)
    t = numerator / safe
    capped = IfPos(t - far, far, IfPos(-far - t, -far, t))
    return IfPos(facing - 1e-12, capped, far)


def _entry(
    a: CoefficientFunction, b: CoefficientFunction, c: CoefficientFunction, far: float
) -> CoefficientFunction:
    """Smaller root of a t^2 + 2 b t + c when the roots are real and the larger one is >= 0."""
    discriminant = b * b - a * c
    root = sqrt(IfPos(discriminant, discriminant, 0.0))
    hit = IfPos(discriminant, IfPos(root - b, 1.0, -1.0), -1.0)
    return IfPos(hit, _quotient(-b - root, a, far), far)


def _motion(motion: Sequence[Coefficient], mesh: Mesh) -> CoefficientFunction:
    if not isinstance(motion, tuple | list | np.ndarray):
        raise TypeError(f"motion={motion!r}: a sequence of {mesh.dim} components is needed")
    if len(motion) != mesh.dim:
        raise ValueError(f"motion={motion!r}: {mesh.dim} components are needed")
    for i, component in enumerate(motion):
        require_coefficient(f"motion[{i}]", component)
    return CF(tuple(c if isinstance(c, CoefficientFunction) else float(c) for c in motion))


def _unit(name: str, value: object, lengths: Sequence[int]) -> tuple[float, ...]:
    vector = np.array(require_vector(name, value, lengths))
    length = np.linalg.norm(vector)
    if length == 0:
        raise ValueError(f"{name}={value!r}: a vector other than zero is needed")
    return tuple((vector / length).tolist())


def _keep(obstacle: Obstacle, name: str, value: object) -> None:
    object.__setattr__(obstacle, name, value)
