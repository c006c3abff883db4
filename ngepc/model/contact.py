"""What acts between bodies besides a gap: pairs that touch or are glued, and Coulomb's friction."""

from __future__ import annotations

from dataclasses import dataclass

from ngepc.checks.declared import Declared, Flag, NotNegativeDatum, Text


@dataclass(frozen=True)
class Contact(Declared):
    """Two parts of the boundary that may touch, with small sliding; their gap is that of the mesh.

    The conditions of contact stand on the first one: choose the finer or the softer side, and the
    one that lies within the other.  Bodies that share nodes are refused.

    Parameters
    ----------
    first, second
        Boundary names, 'a' or 'a|b'.
    tied
        Whether the two are glued: no gap opens, nothing slips, also where they do not touch.

    Raises
    ------
    TypeError
        If a name is no text, or ``tied`` neither True nor False.
    """

    first: Text
    second: Text
    tied: Flag = False


@dataclass(frozen=True)
class Coulomb(Declared):
    """Coulomb's law: the tangential traction is at most the coefficient times the pressure.

    For large coefficients there may be several solutions, which the status NOT_UNIQUE says, or none
    that a load step reaches from the last one.

    Parameters
    ----------
    coefficient
        mu >= 0, a number or a scalar coefficient (1).

    Raises
    ------
    TypeError, ValueError
        If it is neither, negative, infinite or NaN.
    """

    coefficient: NotNegativeDatum
