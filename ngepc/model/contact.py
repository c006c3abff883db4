"""Contact between two bodies of a mesh."""

from dataclasses import dataclass

from ngepc.checks.kinds import require_flag, require_text


@dataclass(frozen=True)
class Contact:
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

    first: str
    second: str
    tied: bool = False

    def __post_init__(self) -> None:
        require_text("first", self.first)
        require_text("second", self.second)
        require_flag("tied", self.tied)
