"""Laws of friction beyond a given bound."""

from dataclasses import dataclass

from ngepc.checks.arguments import (
    Coefficient,
    is_number,
    require_coefficient,
    require_number,
)


@dataclass(frozen=True)
class Coulomb:
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

    coefficient: Coefficient

    def __post_init__(self) -> None:
        require_coefficient("coefficient", self.coefficient)
        if is_number(self.coefficient):
            require_number("coefficient", self.coefficient, 0)
