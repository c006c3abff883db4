"""Every public callable, every argument, every kind of nonsense: refused by name, before the work.

``USES`` holds a legal use of each callable and what of the nonsense is legal for an argument.  All
the rest must raise TypeError or ValueError with a message that names the argument and its value
and says what is needed.  ``test_bad_input`` has the finer table for problems and materials.
"""

import inspect
import io
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from ngsolve import CF

import ngepc
from ngepc import (
    Armijo,
    Coupled,
    DualParameters,
    DualSpaces,
    Fields,
    Fractional,
    FullProduct,
    NewtonOptions,
    PathOptions,
    PrimalOptions,
    Schedule,
    Status,
    SurfaceGradient,
    Units,
    augmented_lagrangian,
    cold_start,
    duality_report,
    evolve,
    export_html,
    export_vtu,
    follow_path,
    live_plot_monitor,
    load_cycle,
    lshape_problem,
    outward_normal,
    plot_field,
    plot_history,
    plot_plastic_zone,
    primal_newton,
    semismooth_newton,
    show,
    table_monitor,
    wrench_problem,
    write_report,
)
from ngepc.geometries import lshape
from ngepc.model.obstacles import Cavity, Cylinder, Plane, SignedDistance, Sphere
from ngepc.pictures import (
    UnitNames,
    beside,
    plot_active_sets,
    plot_comparison,
    plot_contact_pressure,
    plot_counts,
    plot_mesh,
    plot_progress,
)
from ngepc.pictures.export import export_series
from ngepc.pictures.monitors import ProgressLine, together, watch
from ngepc.pictures.views import View, ViewOptions, compare, slide

MESH = lshape.paper_mesh(21)
PROBLEM = lshape_problem(MESH)
QUICK = NewtonOptions(max_iterations=3, quadrature_points=9)
DUAL = semismooth_newton(PROBLEM, 10.0, options=QUICK)
PRIMAL = primal_newton(PROBLEM)
SHORT_PATH = PathOptions(gamma_start=1.0, growth=10.0, gamma_end=1.0)

NONSENSE = {
    "None": None,
    "True": True,
    "a text": "junk",
    "an empty text": "",
    "bytes": b"junk",
    "a complex number": 1j,
    "NaN": math.nan,
    "infinity": math.inf,
    "minus infinity": -math.inf,
    "zero": 0,
    "a negative number": -1,
    "a fraction": 1.5,
    "an integer too large": 10**400,
    "an object": object(),
    "a function": math.sin,
    "a class": int,
    "a set": {1},
    "an empty list": [],
    "a list": [1, "a"],
    "a mapping": {"a": 1},
    "an array of NaN": np.full(2, math.nan),
    "a vector coefficient": CF((1, 2, 3)),
    "a mesh": MESH,
}
NUMBERS = {"zero", "a negative number", "a fraction"}
TEXTS = {"a text", "an empty text"}
CALLABLE = {"a function", "a class", "a vector coefficient", "a mesh"}
"""What can be called; what it does then is up to the user, as with any function of theirs."""


@dataclass(frozen=True)
class Use:
    """A legal use of a callable.

    Parameters
    ----------
    call
        The callable.
    legal
        Arguments of a legal call; those that are named 'path' become files in a new folder.
    may
        Argument -> kinds of nonsense that are legal for it.
    skip
        Arguments that are not checked here.
    """

    call: Callable
    legal: dict = field(default_factory=dict)
    may: dict = field(default_factory=dict)
    skip: tuple = ()


POSITIVE, NOT_NEGATIVE = {"a fraction"}, {"a fraction", "zero"}
DRAWN = {"deformation_scale": NOT_NEGATIVE, "title": TEXTS, "label": TEXTS}
SHOWN = {"field": {"a vector coefficient"}, "title": TEXTS, "name": TEXTS}


USES = {
    "Armijo": Use(Armijo),
    "NewtonOptions": Use(
        NewtonOptions, may={"tolerance": POSITIVE, "linesearch": {"None"}, "vectorised": {"True"}}
    ),
    "PathOptions": Use(
        PathOptions,
        may=dict.fromkeys(
            (
                "gamma_start",
                "growth",
                "inner_tolerance",
                "inner_scale",
                "outer_tolerance",
                "residual_tolerance",
            ),
            POSITIVE,
        ),
    ),
    "PrimalOptions": Use(PrimalOptions),
    "Units": Use(Units, may={"stress": POSITIVE, "length": POSITIVE}),
    "DualSpaces": Use(DualSpaces),
    **{
        kind.__name__: Use(
            kind,
            {"gamma": 10.0},
            {
                "gamma": POSITIVE,
                "gamma_tichonov": POSITIVE,
                "contact_shift": NOT_NEGATIVE,
                "plastic_shift": NOT_NEGATIVE,
                "beta_gamma": POSITIVE,
            },
        )
        for kind in (Coupled, DualParameters)
    },
    "Fractional": Use(Fractional),
    "FullProduct": Use(FullProduct),
    "SurfaceGradient": Use(SurfaceGradient),
    "Fields": Use(
        Fields,
        {
            "problem": PROBLEM,
            "displacement": PRIMAL.displacement,
            "plastic_increment": PRIMAL.plastic_increment,
        },
    ),
    "lame_parameters": Use(
        ngepc.lame_parameters,
        {"young": 1.0, "poisson": 0.3},
        {"young": POSITIVE, "poisson": {"zero"}},
    ),
    "lshape_problem": Use(lshape_problem, {"mesh": MESH}, {"mesh": {"a mesh"}}),
    "wrench_problem": Use(wrench_problem, {"mesh": MESH}, {"mesh": {"a mesh"}}),
    "outward_normal": Use(outward_normal, {"mesh": MESH}, {"mesh": {"a mesh"}}),
    # solvers
    "semismooth_newton": Use(
        semismooth_newton,
        {"problem": PROBLEM, "options": QUICK},
        {"gamma": POSITIVE, "monitor": CALLABLE},
    ),
    "primal_newton": Use(primal_newton, {"problem": PROBLEM}, {"monitor": CALLABLE}),
    "follow_path": Use(
        follow_path,
        {"problem": PROBLEM, "options": SHORT_PATH},
        {"checkpoint": {"a text"}}
        | dict.fromkeys(("monitor", "newton_monitor", "observer", "parameters"), CALLABLE),
    ),
    "augmented_lagrangian": Use(
        augmented_lagrangian,
        {"problem": PROBLEM, "regularisation": Coupled(10.0), "updates": 0, "options": QUICK},
        {"updates": {"zero"}},
    ),
    "duality_report": Use(duality_report, {"result": DUAL}),
    # load histories
    "Schedule": Use(
        Schedule,
        {"times": [1.0, 2.0], "changes": lambda time: {}},
        {"changes": CALLABLE, "begin": {"zero", "a negative number"}},
    ),
    "load_cycle": Use(load_cycle, {"problem": PROBLEM, "factors": [1.0]}, {"begin": NUMBERS}),
    "evolve": Use(
        evolve,
        {"problem": PROBLEM, "steps": load_cycle(PROBLEM, [1.0])},
        {
            "solver": CALLABLE,
            "monitor": CALLABLE,
            "cuts": {"zero"},
            "checkpoint": {"a text"},
        },
    ),
    "cold_start": Use(cold_start, {"solver": primal_newton}, {"solver": CALLABLE}, ("settings",)),
    # monitors
    "table_monitor": Use(table_monitor),
    "ProgressLine": Use(ProgressLine, may={"label": TEXTS}),
    "live_plot_monitor": Use(
        live_plot_monitor, may={"interval": NOT_NEGATIVE, "tolerance": POSITIVE}
    ),
    "watch": Use(watch, {"results": [DUAL], "draw": plot_mesh}, {"draw": CALLABLE}, ("results",)),
    # pictures
    "plot_field": Use(
        plot_field,
        {"source": DUAL},
        DRAWN
        | {
            "field": {"a vector coefficient"},
            "vmin": NUMBERS,
            "vmax": NUMBERS,
            "mesh_lines": {"True"},
        },
    ),
    "plot_plastic_zone": Use(
        plot_plastic_zone, {"source": DUAL}, DRAWN | {"threshold": NOT_NEGATIVE}
    ),
    "plot_comparison": Use(
        plot_comparison,
        {"sources": {"one": DUAL}},
        DRAWN | {"field": {"a vector coefficient"}, "vmin": NUMBERS, "vmax": NUMBERS},
    ),
    "plot_mesh": Use(plot_mesh, {"source": DUAL}),
    "plot_active_sets": Use(plot_active_sets, {"result": DUAL}, DRAWN),
    "plot_progress": Use(
        plot_progress, {"result": DUAL}, DRAWN | {"tolerance": POSITIVE, "runs": {"an empty list"}}
    ),
    "plot_history": Use(plot_history, {"histories": DUAL.history}, {"tolerance": POSITIVE}),
    "plot_counts": Use(plot_counts, {"counts": {"a": {10: 3}}}, {"paper": {"None"}}),
    "plot_contact_pressure": Use(plot_contact_pressure, {"sources": DUAL}),
    "beside": Use(
        lambda width=4.0, height=4.0, three=False: beside(
            lambda axes: None, width=width, height=height, three=three
        ),
        may={"width": POSITIVE, "height": POSITIVE, "three": {"True"}},
    ),
    "UnitNames": Use(UnitNames, may={"length": TEXTS, "stress": TEXTS}),
    "ViewOptions": Use(
        ViewOptions,
        may={
            "deformation_scale": NOT_NEGATIVE,
            "vmin": NUMBERS,
            "vmax": NUMBERS,
            "mesh_lines": {"True"},
            "contact_lines": {"True"},
        },
    ),
    "show": Use(show, {"source": DUAL}, SHOWN),
    "compare": Use(compare, {"sources": {"one": DUAL}}, SHOWN),
    "slide": Use(slide, {"sources": {"one": DUAL}}, SHOWN),
    # files
    "export_html": Use(
        export_html,
        {"source": DUAL, "path": "view.html"},
        SHOWN | {"path": {"a text"}, "deformation": {"True"}},
    ),
    "export_vtu": Use(export_vtu, {"source": DUAL, "path": "fields.vtu"}),
    "export_series": Use(export_series, {"sources": [DUAL], "path": "series.pvd"}),
    "write_report": Use(
        write_report,
        {"path": "page.html", "title": "title"},
        {"path": {"a text"}} | dict.fromkeys(("title", "subtitle", "footer"), TEXTS),
        ("sections",),
    ),
    "View.save": Use(
        lambda path: View("").save(path),
        {"path": "v.html"},
        {"path": {"a text"}},
    ),
    # obstacles
    "Plane": Use(Plane, {"point": (0, 0), "normal": (0, 1)}),
    "Sphere": Use(Sphere, {"centre": (0, 0), "radius": 1.0}, {"radius": POSITIVE}),
    "Cylinder": Use(
        Cylinder, {"point": (0, 0, 0), "axis": (0, 0, 1), "radius": 1.0}, {"radius": POSITIVE}
    ),
    "Cavity": Use(Cavity, {"inside": Sphere((0, 0), 1.0)}),
    "SignedDistance": Use(
        SignedDistance, {"distance": CF(1.0)}, {"gradient": {"a vector coefficient"}}
    ),
    "Obstacle.gap": Use(
        lambda mesh=MESH, motion=(0.0, 0.0), far=1.0: Sphere((0, 3), 1.0).gap(
            mesh, motion, far=far
        ),
        may={"mesh": {"a mesh"}, "far": POSITIVE | {"None"}, "motion": {"None"}},
    ),
}

CELLS = [
    (name, parameter.name)
    for name, use in USES.items()
    for parameter in inspect.signature(use.call).parameters.values()
    if parameter.name not in use.skip
    and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
]


def nonsense_for(name, argument):
    """Kinds of nonsense that are not legal for an argument."""
    use = USES[name]
    optional = inspect.signature(use.call).parameters[argument].default is None
    legal = use.may.get(argument, set()) | ({"None"} if optional else set())
    return [kind for kind in NONSENSE if kind not in legal]


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield
    assert not [p for p in tmp_path.iterdir() if p.name == "junk"]


@pytest.mark.parametrize("name", set(USES) - {"watch"})  # it shows pictures in notebooks only
def test_the_legal_use_is_legal(name):
    USES[name].call(**USES[name].legal)


@pytest.mark.parametrize(("name", "argument"), CELLS)
def test_nonsense_is_refused_by_name(name, argument, tmp_path):
    use = USES[name]
    for kind in nonsense_for(name, argument):
        value = NONSENSE[kind]
        with pytest.raises((TypeError, ValueError)) as caught:
            use.call(**{**use.legal, argument: value})
        message = str(caught.value)
        assert argument in message, (kind, message)
        assert names_the_value(message, value), (kind, message)
        assert any(word in message for word in NEED), (kind, message)
    assert list(tmp_path.iterdir()) == []  # refused before anything was written


NEED = ("needed", "needs", "one of", "legal", "the fields are", "give ", "asks for")
"""Words that say what is legal."""


def names_the_value(message, value):
    """The value itself, one of its entries, or for coefficients its shape."""
    texts = [repr(value), f"{value}", "has shape"]
    if isinstance(value, list | dict | np.ndarray):
        texts += [repr(entry) for entry in value]
    return any(text in message for text in texts)


def test_the_count_of_silent_acceptances_is_zero():
    """All cells together, as RELIABILITY.md states them."""
    cases = sum(len(nonsense_for(*cell)) for cell in CELLS)
    assert len(USES) >= 60
    assert cases >= 4600


def test_every_public_callable_is_here_or_in_the_table_of_bad_input():
    data = {"Status", "SolverError", "Evolution", "DualResult", "PrimalResult", "PathResult"}
    elsewhere = {"Material", "Problem"}
    callables = {n for n in ngepc.__all__ if not n.startswith("_")}
    assert callables - set(USES) == data | elsewhere


# What functions of the user return is checked too


def test_solver_that_returns_nonsense_is_named():
    with pytest.raises(TypeError, match=r"solver=.*returned 5.*is needed"):
        evolve(PROBLEM, load_cycle(PROBLEM, [1.0]), lambda problem, start: 5)


def test_changes_that_are_no_mapping_are_named_before_the_first_step():
    with pytest.raises(TypeError, match=r"changes at time 2 are 2\.0: a mapping is needed"):
        evolve(PROBLEM, Schedule([1.0, 2.0], lambda t: {} if t < 2 else t))


def test_parameters_of_a_path_that_are_none_are_named():
    with pytest.raises(TypeError, match=r"parameters\(.*=5: DualParameters.* is needed"):
        follow_path(PROBLEM, SHORT_PATH, parameters=lambda gamma: 5)


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        ([("heading", "a text")], r"sections\[0\]=.*a pair of a heading and a list of contents"),
        ([("heading", ["fine"]), "junk"], r"sections\[1\]='junk'"),
        ([(3, ["fine"])], r"sections\[0\]\[0\]=3: a text is needed"),
        ([("heading", [3])], r"contents 3: text, a list of dictionaries, .* is needed"),
    ],
)
def test_sections_of_a_report_are_checked(sections, message, tmp_path):
    with pytest.raises(TypeError, match=message):
        write_report(tmp_path / "page.html", "title", *sections)
    assert list(tmp_path.iterdir()) == []


def test_monitors_that_are_none_are_named():
    with pytest.raises(TypeError, match=r"monitors\[1\]=3: a function of a record is needed"):
        together(table_monitor(io.StringIO()), 3)


def test_a_quick_dual_result_is_what_it_says():
    """The solutions that the tables draw are honest ones."""
    assert DUAL.status in (Status.CONVERGED, Status.ITERATION_LIMIT)
    assert PRIMAL.status is Status.CONVERGED
