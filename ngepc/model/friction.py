"""Laws of friction beyond a given bound."""

from dataclasses import dataclass

from ngepc.checks.arguments import Coefficient, is_number


@dataclass(frozen=True)
class Coulomb:
    """Coulomb's law: the tangential traction is at most the coefficient times the pressure.

    For large coefficients, beyond about 1, there may be several solutions, or none that a load
    step reaches from the last one.

    Parameters
    ----------
    coefficient
        mu >= 0, a number or a scalar coefficient (1).

    Raises
    ------
    ValueError
        If it is a negative number.
    """

    coefficient: Coefficient

    def __post_init__(self) -> None:
        if is_number(self.coefficient) and not self.coefficient >= 0:
            raise ValueError(f"coefficient={self.coefficient!r}: a number >= 0 is needed")
