"""What stays along a path in gamma: the space H with its product, and the reference units."""

from __future__ import annotations

from dataclasses import dataclass, field

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance
from ngepc.dual.tichonov import SurfaceGradient, Tichonov


@dataclass(frozen=True, kw_only=True)
class Units:
    """Reference units in which gamma and the tolerance are plain numbers, docs/units.md.

    Parameters
    ----------
    stress, length
        The stress and the length that count as one, in the units of the problem.  A steel part
        in Pa and m whose scaled twin has lame_mu = 1e3 and size 1 has stress = mu / 1e3 and
        length = its size.
    """

    stress: float = 1.0
    length: float = 1.0

    def __post_init__(self) -> None:
        require_number("units.stress", self.stress, 0, strict=True)
        require_number("units.length", self.length, 0, strict=True)


@dataclass(frozen=True, kw_only=True)
class DualSpaces:
    """The spaces of v = (z, q): matrices are assembled for them once.

    Parameters
    ----------
    tichonov
        The space H and its product, by default (R2).
    units
        Reference units of gamma; their length is that of the products.

    Raises
    ------
    TypeError
        If an argument is of the wrong kind.
    """

    tichonov: Tichonov = field(default_factory=SurfaceGradient)
    units: Units = field(default_factory=Units)

    def __post_init__(self) -> None:
        needed = "SurfaceGradient(), Fractional() or FullProduct()"
        require_instance("tichonov", self.tichonov, Tichonov, needed)
        require_instance("units", self.units, Units, "Units(...)")
