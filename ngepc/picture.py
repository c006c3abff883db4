"""A matplotlib Figure that notebooks show by themselves."""

import io

from matplotlib.figure import Figure


class Picture(Figure):
    """A Figure with a PNG representation, so that no pyplot is needed to see it."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=110)
        return stream.getvalue()
