"""One regularised problem in one word: the paper's ``Coupled``, spaces and numbers together."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from ngepc.checks.arguments import Coefficient
from ngepc.dual.parameters import DualParameters
from ngepc.dual.spaces import DualSpaces, Units
from ngepc.dual.tichonov import SurfaceGradient, Tichonov


@dataclass(frozen=True)
class Coupled:
    """The paper's regularisation: one gamma for contact, yield bound and Tichonov term.

    Parameters
    ----------
    gamma, contact_shift, plastic_shift, beta_gamma, gamma_tichonov
        As in ``DualParameters``.
    tichonov, units
        As in ``DualSpaces``.

    Raises
    ------
    TypeError, ValueError
        If an argument is out of range or of the wrong kind.
    """

    gamma: float
    tichonov: Tichonov = field(default_factory=SurfaceGradient)
    contact_shift: Coefficient = 0.0
    plastic_shift: Coefficient = 0.0
    beta_gamma: Coefficient | None = None
    units: Units = field(default_factory=Units)
    gamma_tichonov: float | None = None

    def __post_init__(self) -> None:
        _ = self.parameters, self.spaces

    @classmethod
    def of(cls, spaces: DualSpaces, parameters: DualParameters) -> Coupled:
        """Both in one."""
        return cls(**_values(spaces), **_values(parameters))

    @property
    def spaces(self) -> DualSpaces:
        """What stays along a path."""
        return DualSpaces(tichonov=self.tichonov, units=self.units)

    @property
    def parameters(self) -> DualParameters:
        """The numbers that move."""
        names = [f.name for f in fields(DualParameters)]
        return DualParameters(**{name: getattr(self, name) for name in names})


def _values(data: DualSpaces | DualParameters) -> dict:
    return {f.name: getattr(data, f.name) for f in fields(data)}
