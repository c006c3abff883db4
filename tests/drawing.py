"""Pictures that are drawn quickly, for tests of what is around them."""

import pytest
from matplotlib.axis import Axis
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ngepc.pictures import stills
from ngepc.pictures.style import RC


def leave_out_layout(patch: pytest.MonkeyPatch) -> None:
    """Pictures are neither laid out nor have ticks."""
    patch.setattr(Axis, "draw", lambda axis, renderer: None)
    patch.setattr(ConstrainedLayoutEngine, "execute", lambda engine, figure: None)


def draw_quickly(patch: pytest.MonkeyPatch) -> None:
    """Pictures are coarse, too."""
    leave_out_layout(patch)
    patch.setattr(stills, "SIDE", 400)
    patch.setitem(RC, "savefig.dpi", 40)
