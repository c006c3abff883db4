"""What foundations and friction add to the suprema of goals.

With friction |T| <= F let s_h be the slip of u_h, T^ and rho^ minus the tangential tractions of the
stresses of bound and adjoint.  If |rho^ + lambda T^| <= lambda F, the supremum gets at most

    int F |lambda s_h - z_t| - (rho^ + lambda T^) . s_h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.contact import ContactFacets
from ngepc.bounds.foundation import Foundation


@dataclass(frozen=True, eq=False)
class SpringSquares:
    """What springs of stiffness K add to the two suprema.

    For the displacements u and z, and the tractions -K w and -K y of the stresses of bound and
    adjoint, the supremum on a facet is a . K a / (4 lambda) with a = lambda (u - w) +- (z - y).
    ``products`` (3, facets) are the integrals of the products, with K, of u - w with itself, of
    both, and of z - y with itself; ``owner`` are the cells.
    """

    products: np.ndarray
    owner: np.ndarray

    @classmethod
    def of(
        cls, foundation: Foundation, of_state: np.ndarray, of_adjoint: np.ndarray
    ) -> SpringSquares:
        """The products for u - w and z - y (facets, nodes, N)."""
        pairs = [(of_state, of_state), (of_state, of_adjoint), (of_adjoint, of_adjoint)]
        products = np.array([foundation.works(a, b) for a, b in pairs])
        return cls(products, foundation.owner)

    def parts(self, factor: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        """What the facets of each of ``count`` cells add to the upper and lower bound."""
        own, mixed, adjoint = self.products
        mean = factor * own / 4 + adjoint / (4 * factor)
        return tuple(
            np.bincount(self.owner, mean + sign * mixed / 2, minlength=count)
            for sign in (1.0, -1.0)
        )

    def width(self, factor: float) -> float:
        """The sum of both over all facets."""
        own, _, adjoint = self.products.sum(axis=1)
        return factor * own / 2 + adjoint / (2 * factor)


@dataclass(frozen=True, eq=False)
class FrictionTerms:
    """What friction adds to the two suprema.

    At the nodes of the contact facets (facets, nodes, N) ``slip`` is s_h and ``along`` is z_t; at
    their vertices (facets, N, N) ``drag`` is T^ and ``adjoint`` rho^.
    """

    contact: ContactFacets
    slip: np.ndarray
    along: np.ndarray
    drag: np.ndarray
    adjoint: np.ndarray

    def of_facets(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """What each facet adds to the upper and lower bound."""
        contact = self.contact
        dragged = factor * contact.works(self.drag, self.slip)
        pulled = contact.works(self.adjoint, self.slip)
        above = contact.friction_works_of(factor * self.slip - self.along)
        below = contact.friction_works_of(factor * self.slip + self.along)
        return above - dragged - pulled, below - dragged + pulled


@dataclass(frozen=True, eq=False)
class BoundaryTerms:
    """The parts of foundations and of friction; None without friction."""

    springs: SpringSquares
    friction: FrictionTerms | None

    def parts(self, factor: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        """What the boundary of each of ``count`` cells adds to the upper and lower bound."""
        above, below = self.springs.parts(factor, count)
        if self.friction is not None:
            owner = self.friction.contact.owner
            higher, lower = self.friction.of_facets(factor)
            above = above + np.bincount(owner, higher, minlength=count)
            below = below + np.bincount(owner, lower, minlength=count)
        return above, below

    def width(self, factor: float) -> float:
        """The sum of both over all facets."""
        width = self.springs.width(factor)
        if self.friction is not None:
            width += float(np.sum(self.friction.of_facets(factor)))
        return width
