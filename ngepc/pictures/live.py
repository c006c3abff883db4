"""The laboratory: sliders for the data of a problem, and its solution while they move.

Each position of the sliders is a problem of its own, solved from the last solution.  Where that
takes longer than a picture should, a prediction to first order is shown before it, marked as one.
Only the newest position is asked for: positions that a slow solve has missed are left out.
"""

from __future__ import annotations

import logging
import math
import time
import webbrowser
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import require_integer
from ngepc.checks.kinds import require_function, require_instance, require_text
from ngepc.local.result import ExactResult
from ngepc.local.warm import WarmSolver
from ngepc.model.elements import cells_of, vertex_coordinates
from ngepc.model.problem import Problem
from ngepc.pictures.curves import pressure_curves
from ngepc.pictures.drawable import SIGNED, Drawable, UnitNames, drawable
from ngepc.pictures.fields import Drawing
from ngepc.pictures.live_server import LabServer, json_ready
from ngepc.pictures.sampling import Corners, colour_scale, corners_of, is_curved
from ngepc.pictures.sliders import Change, Slider, changed
from ngepc.pictures.views import (
    LINES,
    View,
    lines_of,
    pressure_peak,
    scene_of,
    show,
    viewer_script,
)
from ngepc.results.outcome import Status

log = logging.getLogger(__name__)

SCRIPT = Path(__file__).with_name("live.js").read_text(encoding="utf-8")

LONG = 0.15  # after slower solves (s) the next one shows a prediction first
CURVED = 2  # straight parts that stand for a curved edge
LAST_PORT = 65535
ROOM = 1.3  # factor by which scales of colours and pressures are extended
EXTRA = 'pip install "ngepc[notebook]"'


def lab(
    problem: Problem,
    *,
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    change: Change | None = None,
    deformation_scale: float = 1.0,
    units: UnitNames | None = None,
    title: str = "",
    **ranges: tuple[float, ...],
) -> Laboratory:
    """A live laboratory of a problem: drag a slider and see the solution with its residual.

    ``lab(problem, load=(0, 12), gap=(0, 0.2))`` as the last line of a notebook cell shows the
    deformed body, the contact pressure, the force over the displacement and the residuals of
    Newton's method, all of which move with the sliders.

    Parameters
    ----------
    problem
        The problem, with the values at which the sliders start.
    field
        What the body is coloured by, as in ``plot_field``.
    change
        For sliders of one's own: a function that makes the problem from the given one and the
        values of all sliders that have no meaning here, by name.
    deformation_scale, units, title
        Factor on the displacement, names of the units, heading.
    ranges
        Slider -> (least, most) or (least, most, step).  'load' is the size of the largest load:
        traction or pressure (stress), else body force, else prescribed displacement (length); all
        loads keep their proportions.  'gap' is the distance to the obstacle (length) where that is
        one number, 'obstacle' moves obstacles of any shape away from the body (length).  Others
        are numbers by their names: those given to ``Material.metal`` ('young', 'yield_stress',
        'plastic_modulus', ...), else those of ``Material`` and ``Problem`` ('hardening',
        'friction', ...).

    Returns
    -------
    Laboratory
        It shows itself in JupyterLab, VS Code and voila; ``serve()`` opens it in the browser.

    Raises
    ------
    TypeError, ValueError
        If a range is none, or the problem has no such number.
    ImportError
        If the viewer is not installed; the message says what to install.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_function("change", change, "a problem and values", optional=True)
    require_text("title", title)
    drawing = Drawing(deformation_scale, units)
    if not ranges:
        raise ValueError("ranges={}: at least one slider is needed: load=(0, 12)")
    sliders = [Slider.of(problem, n, r, change) for n, r in ranges.items()]
    return Laboratory(problem, tuple(sliders), change, field, drawing, title)


@dataclass(eq=False)
class Laboratory:
    """The laboratory of ``lab``; each solve starts from the last solution.

    ``frames(values)`` are the pictures for a position of the sliders as dictionaries that JSON can
    hold: the prediction, if a solve is expected to take long, and the solution.  ``last`` is the
    result of the last one, whatever its status.
    """

    problem: Problem
    sliders: tuple[Slider, ...]
    change: Change | None
    field: str | CoefficientFunction
    drawing: Drawing
    title: str = ""
    solver: WarmSolver = field(default_factory=WarmSolver, repr=False)
    trail: list[tuple[float, float]] = field(default_factory=list, repr=False)
    before: dict[str, float] = field(default_factory=dict, repr=False)
    moving: set[str] = field(default_factory=set, repr=False)
    seconds: float = 0.0  # of the last solve
    colours: ScalarMappable | None = field(default=None, repr=False)
    scale: tuple[float, float] | None = None  # of the colours; None until values differ
    peak: float = 0.0  # the contact pressure that is drawn at full height
    last: ExactResult | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        viewer_script()
        self.first = self._first()

    @property
    def start(self) -> dict[str, float]:
        """Where the sliders start."""
        return {slider.name: slider.value for slider in self.sliders}

    @property
    def setup(self) -> dict:
        """The sliders and the first picture."""
        sliders = [vars(slider) for slider in self.sliders]
        lines = [(name, LINES[name]) for name in lines_of([self.last]).names]
        return {"sliders": sliders, "frame": self.first, "lines": lines}

    @cached_property
    def script(self) -> str:
        """The module that the browser runs, viewer included."""
        own = "const module = {exports: {}}; const exports = module.exports;"
        inside = (
            f"(function(module, exports) {{ {viewer_script()}\n}})(module, exports);"
        )
        return f"{own}\n{inside}\nconst webgui = module.exports;\n{SCRIPT}"

    def frames(self, values: Mapping[str, float]) -> Iterator[dict]:
        """The pictures for a position: name of each slider -> its value; the last says 'last'."""
        values = self.start | {name: float(value) for name, value in values.items()}
        begin = time.perf_counter()
        try:
            problem = changed(self.problem, values, self.change)
            if self.seconds > LONG:
                predicted = self.solver.predict(problem)
                if predicted is not None:
                    yield self._frame(predicted, values, exact=False)
                    begin = time.perf_counter()
            result = self.solver.solve(problem)
        except (ValueError, TypeError) as error:
            yield self._failed(str(error), values)
            return
        self.seconds = time.perf_counter() - begin
        if result.status is Status.NONFINITE:
            yield self._failed(described(result), values)
            return
        self.last = result
        yield self._frame(result, values, exact=True)

    def answers(self, values: Mapping[str, float]) -> Iterator[dict]:
        """``frames`` for a page, which waits for the last one: it says what was raised."""
        try:
            yield from self.frames(values)
        except Exception as error:  # a function of the user may raise anything
            log.warning("no picture of %s", self._position(values), exc_info=error)
            why = f"{type(error).__name__}: {error}"
            yield self._failed(why, self.start | dict(values))

    def _first(self) -> dict:
        """The solution where the sliders start."""
        (*_, frame) = self.frames({})
        if frame["scene"] is None:
            raise ValueError(
                f"problem at {self._position(self.start)}: {frame['described']}"
            )
        return frame

    def _position(self, values: Mapping[str, float]) -> str:
        return ", ".join(f"{n.replace('_', ' ')} {v:.4g}" for n, v in values.items())

    def _failed(self, why: str, values: Mapping[str, float]) -> dict:
        """The text that is shown if there is no solution: the reason."""
        caption = f"{self._position(values)}: no solution"
        message = {"caption": caption, "said": why, "exact": True, "last": True}
        return message | {
            "scene": None,
            "curves": [],
            "label": "",
            "values": dict(values),
        }

    def _frame(
        self, result: ExactResult, values: Mapping[str, float], exact: bool
    ) -> dict:
        """A picture, its curves and the description of the solution."""
        fields = result.fields
        drawn = drawable(result, self.field, self.drawing.units)
        cuts = CURVED if is_curved(fields) else 1
        corners = corners_of(fields, drawn.coefficient, cuts=cuts)
        self._widen(drawn, corners)
        self.peak = max(self.peak, self._peak_of(result))
        lines = lines_of([result])._replace(peak=self.peak)
        given = self.colours, self.drawing, lines
        scene = scene_of(result, drawn, corners, *given, outline_of(result, cuts))
        position = self._position(values)
        caption = position if exact else f"{position}: predicted, solving ..."
        curves = self._curves(result, values, exact)
        return {
            "values": dict(values),
            "caption": caption,
            "said": described(result) if exact else "",
            "exact": exact,
            "last": exact,
            "scene": scene,
            "label": plain_label(drawn),
            "curves": curves,
        }

    def _widen(self, drawn: Drawable, samples: Corners) -> None:
        """Extend the scale of colours if values are outside of it; one value has no scale."""
        limits = colour_scale(samples, symmetric=drawn.colormap == SIGNED)
        low = limits.vmin
        high = limits.vmax
        if np.ptp(samples.values) == 0:
            low = high = float(samples.values.flat[0])
            if self.scale is None:
                self.colours = ScalarMappable(limits, drawn.colormap)
                return
        if self.scale is not None:
            old_low, old_high = self.scale
            if old_low <= low and high <= old_high:
                return
            low = old_low if low >= old_low else ROOM * low
            high = old_high if high <= old_high else ROOM * high
        self.scale = low, high
        self.colours = ScalarMappable(Normalize(low, high), drawn.colormap)

    def _peak_of(self, result: ExactResult) -> float:
        peak = pressure_peak([result])
        return peak if peak <= self.peak else ROOM * peak

    def _curves(
        self, result: ExactResult, values: Mapping[str, float], exact: bool
    ) -> list[dict]:
        """Contact pressure, force over displacement, residuals."""
        units = self.drawing.units
        problem = self.problem
        curves = []
        if problem.touching_names and problem.N == 2:
            found = pressure_curves(result)
            lines = [np.column_stack(line).tolist() for line in found]
            words = f"position along the contact boundary{units.of('length')}"
            title = f"contact pressure{units.of('stress')}"
            curves.append({"title": title, "x": words, "lines": lines})
        place = largest_displacement(result), force_of(result)
        if exact:
            self._follow(values, place)
        which = "contact force" if problem.touching_names else "force of the supports"
        words = f"largest displacement{units.of('length')}"
        line = sorted(self.trail)
        curves.append({"title": which, "x": words, "lines": [line], "here": place})
        if exact:
            norms = enumerate(result.history.residual_norms)
            residuals = {"title": "residual", "x": "Newton step", "log": True}
            curves.append(residuals | {"lines": [list(norms)]})
        return curves

    def _follow(self, values: Mapping[str, float], place: tuple) -> None:
        """Add a point to the curve, which begins anew if another slider moves."""
        moved = {n for n, v in values.items() if v != self.before.get(n, v)}
        if moved and self.moving and moved != self.moving:
            self.trail = self.trail[-1:]
        self.moving = moved or self.moving
        self.before = dict(values)
        self.trail.append(place)

    def _repr_mimebundle_(self, **options: object) -> object:
        """The widget, and the first picture as a view for pages without a kernel."""
        widget = self.widget()
        bundle = widget._repr_mimebundle_(**options)
        data, metadata = bundle if isinstance(bundle, tuple) else (bundle, {})
        return (data or {}) | {"text/html": self.view()._repr_html_()}, metadata

    def view(self) -> View:
        """The last solution as an interactive page without sliders."""
        scale = self.drawing.deformation_scale
        return show(self.last, self.field, deformation_scale=scale, title=self.title)

    def widget(self) -> object:
        """The anywidget; ImportError says what to install where anywidget is missing."""
        try:
            import anywidget
            import traitlets
        except ImportError as error:
            raise ImportError(f"the laboratory needs anywidget: {EXTRA}") from error

        class Live(anywidget.AnyWidget):
            """The page of the laboratory as a widget."""

            _esm = self.script
            setup = traitlets.Dict().tag(sync=True)

        def answer(widget: Live, message: dict, buffers: object) -> None:
            """Send the frames of what the page asks for."""
            for frame in self.answers(message["values"]):
                widget.send(json_ready(frame))

        widget = Live(setup=json_ready(self.setup))
        widget.on_msg(answer)
        return widget

    def serve(self, port: int = 0, *, browser: bool = True) -> LabServer:
        """Start a server on this machine alone and open the laboratory in the browser.

        Parameters
        ----------
        port
            Its number, 0 to 65535; 0 for a free one.
        browser
            Whether to open the browser.

        Returns
        -------
        LabServer
            ``run()`` answers until Ctrl-C, ``address`` is that of the page.

        Raises
        ------
        TypeError, ValueError
            If ``port`` is no such number.
        """
        server = LabServer(self, require_integer("port", port, 0, LAST_PORT))
        if browser:
            webbrowser.open(server.address)
        return server


def described(result: ExactResult) -> str:
    """A description of a solution: status, residual, duality gap, and its message."""
    gap = result.primal_energy + result.dual_energy
    plural = "" if result.iterations == 1 else "s"
    steps = f"{result.iterations} Newton step{plural}"
    parts = [
        f"{result.status.label.replace('_', ' ')} after {steps}",
        f"residual {result.residual_norm:.1e}",
    ]
    if math.isfinite(gap):
        parts.append(f"J + J* = {gap:.1e} (0 at the solution)")
    return f"{', '.join(parts)}. {result.message}".strip()


def outline_of(result: ExactResult, cuts: int) -> Corners:
    """The boundary of a plane body, whose segments are cut into parts, or the edges of a solid."""
    mesh = result.problem.mesh
    if mesh.dim == 2:
        return corners_of(result.fields, where=".*", cuts=cuts)
    ends = cells_of(mesh, 1)[0][:, :2]
    points = vertex_coordinates(mesh)[ends]
    return Corners(points, result.state.u[ends], np.zeros(ends.shape))


def largest_displacement(result: ExactResult) -> float:
    """The largest |u| at the nodes (length)."""
    return float(np.linalg.norm(result.state.u, axis=1).max())


def force_of(result: ExactResult) -> float:
    """The contact force, or the size of the reaction of the supports without contact."""
    if result.problem.touching_names:
        return result.contact_force
    return float(np.linalg.norm(result.reaction))


def plain_label(drawn: Drawable) -> str:
    """The label of a colour bar without formulas."""
    return drawn.label.split(" $")[0] + drawn.label.rpartition("$")[2]
