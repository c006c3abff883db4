"""Every public callable, every argument, every kind of nonsense: refused by name, before the work.

``USES`` holds a legal use of each callable and what of the nonsense is legal for an argument.  All
the rest must raise TypeError or ValueError with a message that names the argument and its value
and says what is needed.  ``test_bad_input`` has the finer tables for problems and materials.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import pytest
from ngsolve import CF
from nonsense import (
    CALLABLE,
    COEFFICIENTS,
    MESH,
    NONSENSE,
    NOT_NEGATIVE,
    NOTHING,
    NUMBERS,
    POSITIVE,
    TEXTS,
    UNSEEN,
    Use,
)

import ngepc
from ngepc import (
    Armijo,
    Contact,
    Coulomb,
    Coupled,
    Curve,
    Direction,
    DisplacementAt,
    DualSpaces,
    Edge,
    Fields,
    FullProduct,
    Material,
    NewtonOptions,
    Norton,
    PathOptions,
    Point,
    PrimalOptions,
    Problem,
    PyAMG,
    Reaction,
    Refinement,
    Roller,
    Schedule,
    Status,
    SurfaceGradient,
    Swift,
    SymbolicForms,
    Tabulated,
    Units,
    Voce,
    calibrate,
    cold_start,
    contact_force_bracket,
    displacement_bracket,
    duality_report,
    error_bound,
    error_indicators,
    evolve,
    export_vtu,
    follow_path,
    gradient,
    live_plot_monitor,
    load_cycle,
    lshape_problem,
    misfit,
    outward_normal,
    plot_field,
    plot_history,
    plot_plastic_zone,
    primal_newton,
    progress_line,
    semismooth_newton,
    show,
    solve_to,
    tangent,
    wrench_problem,
    write_report,
)
from ngepc.geometries import block, lshape, ring
from ngepc.model.obstacles import Cylinder, Obstacle, Plane, SignedDistance, Sphere
from ngepc.pictures import (
    UnitNames,
    beside,
    plot_active_sets,
    plot_contact_pressure,
    plot_counts,
    plot_mesh,
)
from ngepc.pictures.views import View, viewer_installed

PROBLEM = lshape_problem(MESH)
STEEL = {
    "lame_lambda": 1000.0,
    "lame_mu": 800.0,
    "yield_stress": 5.0,
    "hardening": 100.0,
}
BLOCK = {
    "mesh": MESH,
    "material": Material(**STEEL),
    "contact": "contact",
    "gap": 0.1,
    "friction": 0.1,
}
QUICK = NewtonOptions(max_iterations=3, quadrature_points=9)
DUAL = semismooth_newton(PROBLEM, 10.0, options=QUICK)
PRIMAL = primal_newton(PROBLEM)
SOLVED = semismooth_newton(PROBLEM)
FREE = replace(PROBLEM, contact=None, gap=None)
RAMP = load_cycle(FREE, [1.0])
CURVE = {"schedule": RAMP, "functional": "primal_energy", "measured": [-0.2]}
HISTORY = ngepc.evolve(FREE, RAMP)
LIMIT = ngepc.limit_load(FREE, 0.9, max_cells=200)
CYCLES = ngepc.shakedown_load(FREE, [{"load": 1.0}], 0.9, max_cells=200)
WORK = ngepc.LoadWork(body_force=(0.0, 1.0))
VERDICT = {"at_most": NUMBERS, "at_least": NUMBERS, "seconds": POSITIVE}
SHORT_PATH = PathOptions(gamma_start=1.0, growth=10.0, gamma_end=1.0)

DRAWN = {"deformation_scale": NOT_NEGATIVE}
RANGE = {"vmin": NUMBERS, "vmax": NUMBERS}
FIELD = {"field": COEFFICIENTS}

STILL_UNCHECKED = {"PETSc"}
"""Public callables whose arguments are not all refused by name today; it may only shrink."""

USES = {
    # the problem
    "Point": Use(Point, {"where": "tip"}, {"where": TEXTS}),
    "Edge": Use(Edge, {"name": "rim"}),
    "Roller": Use(Roller),
    "Contact": Use(Contact, {"first": "left", "second": "right"}),
    "Problem": Use(
        Problem,
        BLOCK,
        {
            "clamped": NOTHING,
            "gap": NUMBERS,
            "initial_hardening": NOT_NEGATIVE | {"a coefficient of nine"},
            "friction": NOT_NEGATIVE,
            "initial_accumulated": NOT_NEGATIVE,
            "initial_strain": NUMBERS | {"a coefficient of nine"},
        },
    ),
    "Material": Use(Material, STEEL, {"law": NOTHING, "rate": NOTHING}),
    "Voce": Use(Voce, {"yield_stress": 1.0, "saturation": 1.0, "rate": 1.0}),
    "Swift": Use(Swift, {"yield_stress": 1.0, "offset": 1.0, "exponent": 1.0}),
    "Norton": Use(Norton, {"overstress": 1.0}),
    "plot_material": Use(
        ngepc.plot_material,
        {"materials": Material(**STEEL)},
        {"strain": NOTHING | {"a fraction"}},
    ),
    "Hill": Use(ngepc.Hill, {"F": 0.5, "L": 1.5, "angle": 0.1}),
    "Overlay": Use(ngepc.Overlay, {"shares": [0.5, 0.2], "bounds": [1.0, 2.0]}),
    "material_point": Use(ngepc.material_point, {"material": Material(**STEEL)}),
    "Tabulated": Use(Tabulated, {"plastic_strain": [0], "stress_there": [1.0]}),
    "Coulomb": Use(Coulomb, {"coefficient": 0.3}),
    "lame_parameters": Use(
        ngepc.lame_parameters,
        {"young": 1.0, "poisson": 0.3},
        {"young": POSITIVE | UNSEEN, "poisson": {"zero"} | UNSEEN},
    ),
    "lshape_problem": Use(lshape_problem, {"mesh": MESH}),
    "wrench_problem": Use(wrench_problem, {"mesh": MESH}),
    "outward_normal": Use(outward_normal, {"mesh": MESH}),
    # bodies
    "lshape.mesh": Use(lshape.mesh, {"maxh": 0.5}),
    "lshape.paper_mesh": Use(lshape.paper_mesh, {"nodes": 21}),
    "block.mesh": Use(block.mesh, {"maxh": 0.5}),
    "block.with_hole": Use(block.with_hole, {"maxh": 0.5}, {"radius": NOTHING}),
    "block.structured_mesh": Use(block.structured_mesh, {"nx": 1, "ny": 1}),
    "ring.quarter_mesh": Use(ring.quarter_mesh, {"maxh": 0.5}),
    # options
    "Armijo": Use(Armijo),
    "NewtonOptions": Use(NewtonOptions),
    "PathOptions": Use(PathOptions, may={"gamma_end": NOTHING}),
    "PrimalOptions": Use(PrimalOptions),
    "Units": Use(Units),
    "DualSpaces": Use(DualSpaces),
    "Coupled": Use(Coupled, {"gamma": 10.0}),
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
    # solvers
    "RepeatedSolver": Use(ngepc.RepeatedSolver),
    "semismooth_newton": Use(semismooth_newton, {"problem": PROBLEM, "options": QUICK}),
    "primal_newton": Use(primal_newton, {"problem": PROBLEM}),
    "follow_path": Use(follow_path, {"problem": PROBLEM, "options": SHORT_PATH}),
    "duality_report": Use(duality_report, {"result": DUAL}),
    # derivatives
    "Direction": Use(Direction, {"datum": "gap"}, skip=("change",)),
    "DisplacementAt": Use(DisplacementAt, {"point": (0.5, 0.5), "component": 0}),
    "Reaction": Use(Reaction, {"support": "clamped", "component": 0}),
    "Curve": Use(Curve, CURVE, {"noise": {"a fraction"}}),
    "calibrate": Use(
        calibrate,
        {"problem": FREE, "curves": Curve(**CURVE), "start": {"hardening": 90.0}},
    ),
    "gradient": Use(
        gradient,
        {"result": SOLVED, "functional": "primal_energy", "parameters": "hardening"},
        {"step": {"zero", "a negative number"}},
    ),
    "tangent": Use(tangent, {"result": SOLVED, "parameters": "hardening"}),
    "error_bound": Use(error_bound, {"result": SOLVED}),
    "error_indicators": Use(error_indicators, {"result": SOLVED}),
    "contact_force_bracket": Use(contact_force_bracket, {"result": SOLVED}),
    "displacement_bracket": Use(
        displacement_bracket, {"result": SOLVED, "body_force": (0.0, 1.0)}
    ),
    "Refinement": Use(Refinement),
    "solve_to": Use(solve_to, {"problem": FREE, "goal": WORK, "percent": 90.0}),
    "goal_bound": Use(ngepc.goal_bound, {"result": SOLVED, "goal": "contact_force"}),
    "confidence": Use(ngepc.confidence, {"result": SOLVED}),
    "write_receipt": Use(
        ngepc.write_receipt,
        {"result": SOLVED, "path": "receipt.npz"},
        {"path": NOTHING},
    ),
    "verdict": Use(
        ngepc.verdict, {"problem": FREE, "goal": WORK, "at_most": 1e3}, VERDICT
    ),
    "ContactForceOn": Use(ngepc.ContactForceOn, {"boundary": "contact"}),
    "MeanDisplacement": Use(
        ngepc.MeanDisplacement, {"boundary": "load", "component": 1}
    ),
    "LoadWork": Use(
        ngepc.LoadWork,
        {"body_force": (0.0, 1.0)},
        {"body_force": {"a vector coefficient"}, "traction": NOTHING},
    ),
    "shakedown_load": Use(
        ngepc.shakedown_load,
        {"problem": FREE, "vertices": [{"load": 1.0}], "relative_width": 0.9},
    ),
    "limit_load": Use(ngepc.limit_load, {"problem": FREE, "relative_width": 0.9}),
    "PyAMG": Use(PyAMG),
    "SymbolicForms": Use(SymbolicForms),
    "misfit": Use(
        misfit, {"observed": PRIMAL.displacement}, {"observed": COEFFICIENTS}
    ),
    "Response": Use(
        ngepc.Response,
        {"problem": FREE, "functional": "primal_energy", "parameters": ["hardening"]},
    ),
    # load histories
    "Schedule": Use(
        Schedule,
        {"times": [1.0, 2.0], "changes": lambda time: {}},
        {"begin": {"zero", "a negative number"}},
    ),
    "load_cycle": Use(load_cycle, {"problem": PROBLEM, "factors": [1.0]}),
    "evolve": Use(
        evolve,
        {"problem": PROBLEM, "steps": load_cycle(PROBLEM, [1.0])},
        {"cuts": {"zero"}, "solver": CALLABLE},
    ),
    "cold_start": Use(
        cold_start, {"solver": primal_newton}, {"solver": CALLABLE}, ("settings",)
    ),
    # monitors
    "progress_line": Use(
        lambda label="": progress_line(label).__enter__(), may={"label": TEXTS}
    ),
    "live_plot_monitor": Use(live_plot_monitor, may={"interval": NOT_NEGATIVE}),
    # pictures
    "plot_field": Use(plot_field, {"source": DUAL}, DRAWN | RANGE | FIELD),
    "plot_plastic_zone": Use(
        plot_plastic_zone, {"source": DUAL}, DRAWN | {"threshold": NOT_NEGATIVE}
    ),
    "plot_field, several": Use(
        plot_field, {"source": {"one": DUAL}}, DRAWN | RANGE | FIELD
    ),
    "plot_mesh": Use(plot_mesh, {"source": DUAL}, {"source": {"a mesh"}}),
    "plot_curve": Use(
        ngepc.plot_curve,
        {"history": HISTORY},
        {"xlabel": TEXTS, "ylabel": TEXTS, "history": NOTHING},
        ("x", "y"),
    ),
    "plot_interval": Use(
        ngepc.plot_interval,
        {"run": ngepc.solve_to(FREE, goal=WORK, percent=90.0)},
        {"limit": NUMBERS},
    ),
    "plot_bracket": Use(ngepc.plot_bracket, {"limit": LIMIT}, {"exact": NUMBERS}),
    "plot_mechanism": Use(ngepc.plot_mechanism, {"limit": LIMIT}),
    "plot_residual_stress": Use(ngepc.plot_residual_stress, {"limit": CYCLES}),
    "lab": Use(lambda problem: ngepc.lab(problem, load=(0, 1)), {"problem": PROBLEM}),
    "plot_active_sets": Use(plot_active_sets, {"result": DUAL}, DRAWN),
    "plot_history": Use(plot_history, {"histories": DUAL.history}),
    "plot_counts": Use(plot_counts, {"counts": {"a": {10: 3}}}),
    "plot_contact_pressure": Use(plot_contact_pressure, {"sources": DUAL}),
    "beside": Use(
        lambda width=4.0, height=4.0: beside(
            lambda axes: None, width=width, height=height
        ),
        may={"width": POSITIVE, "height": POSITIVE},
    ),
    "UnitNames": Use(UnitNames),
    "show": Use(show, {"source": DUAL}, DRAWN | RANGE | FIELD | {"source": {"a mesh"}}),
    # files
    "export_vtu": Use(
        export_vtu, {"source": DUAL, "path": "fields.vtu"}, {"path": NOTHING}
    ),
    "export_vtu, several": Use(
        export_vtu, {"source": {0.5: DUAL}, "path": "series.pvd"}, {"path": NOTHING}
    ),
    "write_report": Use(
        write_report, {"path": "page.html", "title": "title"}, skip=("sections",)
    ),
    "View.save": Use(
        lambda path: View("").save(path), {"path": "v.html"}, {"path": {"a text"}}
    ),
    # obstacles
    "Plane": Use(Plane, {"point": (0, 0), "normal": (0, 1)}),
    "Sphere": Use(Sphere, {"centre": (0, 0), "radius": 1.0}),
    "Cylinder": Use(Cylinder, {"point": (0, 0, 0), "axis": (0, 0, 1), "radius": 1.0}),
    "SignedDistance": Use(SignedDistance, {"distance": CF(1.0)}, {"distance": UNSEEN}),
    "Obstacle.gap": Use(
        lambda mesh=MESH, motion=(0.0, 0.0), far=1.0: Sphere((0, 3), 1.0).gap(
            mesh, motion, far=far
        ),
        may={"mesh": {"a mesh"}, "far": POSITIVE | {"None"}, "motion": {"None"}},
    ),
}


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("name", USES)
def test_nonsense_is_refused_by_name(name, tmp_path):
    """Any argument, any kind; nothing is written or drawn before; what is legal is accepted."""
    if name == "show" and not viewer_installed():
        pytest.skip("the offline viewer is not installed")
    use = USES[name]
    assert use.failures() == []
    assert list(tmp_path.iterdir()) == []
    assert plt.get_fignums() == []
    use.call(**use.legal)


def test_the_count_of_cases_is_what_reliability_says():
    assert len(USES) >= 60
    assert sum(len(list(use.cases())) for use in USES.values()) >= 5_500


def test_every_public_callable_is_here():
    returned = {
        "BoundedResult", "Bracket", "Calibration", "DualResult", "ErrorBound", "Evolution",
        "ExactResult", "Gradient", "HardeningLaw", "Kinematics", "PathResult", "PointHistory",
        "PrimalResult", "RateLaw", "SolverError", "Status", "TangentResult", "GoalBound",
        "LimitLoad", "LimitRecord", "LimitStatus", "ShakedownLoad", "Verdict", "DistanceBound",
    }  # fmt: skip
    public = {n for n in ngepc.__all__ if not n.startswith("_")}
    public |= {
        cls.__name__
        for cls in Obstacle.__subclasses__()
        if cls.__module__.startswith("ngepc.")
    }
    unchecked = returned | STILL_UNCHECKED
    assert public - set(USES) - unchecked == set(), "add a Use of each to USES"
    assert unchecked - public | unchecked & set(USES) == set(), "take these out"


@pytest.mark.parametrize(
    ("call", "failure"),
    [
        (lambda size: None, "accepted"),
        (lambda size: 1 / 0, "ZeroDivisionError"),
        (lambda size: int("b"), "the argument is not named"),
    ],
)
def test_failures_are_made(call, failure):
    found = Use(call, {"size": 1}).failures()
    assert len(found) == len(NONSENSE)
    assert all(failure in line for line in found)


# What functions of the user return is checked too


def test_solver_that_returns_nonsense_is_named():
    with pytest.raises(TypeError, match=r"solver=.*returned 5.*is needed"):
        evolve(PROBLEM, load_cycle(PROBLEM, [1.0]), lambda problem, start: 5)


def test_changes_that_are_no_mapping_are_named_before_the_first_step():
    with pytest.raises(
        TypeError, match=r"changes at time 2 are 2\.0: a mapping is needed"
    ):
        evolve(PROBLEM, Schedule([1.0, 2.0], lambda t: {} if t < 2 else t))


@pytest.mark.parametrize(
    ("sections", "message"),
    [
        (
            [("heading", "a text")],
            r"sections\[0\]=.*a pair of a heading and a list of contents",
        ),
        ([("heading", ["fine"]), "junk"], r"sections\[1\]='junk'"),
        ([(3, ["fine"])], r"sections\[0\]\[0\]=3: a text is needed"),
        ([("heading", [3])], r"contents 3: text, a list of dictionaries, .* is needed"),
    ],
)
def test_sections_of_a_report_are_checked(sections, message, tmp_path):
    with pytest.raises(TypeError, match=message):
        write_report(tmp_path / "page.html", "title", *sections)
    assert list(tmp_path.iterdir()) == []


def test_a_quick_dual_result_is_what_it_says():
    """The solutions that the tables draw are honest ones."""
    assert DUAL.status in (Status.CONVERGED, Status.ITERATION_LIMIT)
    assert PRIMAL.status is Status.CONVERGED


@pytest.mark.parametrize("given", ["history", "step", "adaptive run"])
@pytest.mark.parametrize(
    "needs", [ngepc.error_bound, ngepc.contact_force_bracket, ngepc.error_indicators]
)
def test_where_the_result_is(given, needs):
    """A history and an adaptive run are no results, but have one: the message says where."""
    adaptive = ngepc.solve_to(PROBLEM, relative_error=0.9) if given[0] == "a" else None
    one, where = {
        "history": (HISTORY, r"such as its \.steps"),
        "step": (HISTORY.steps[-1], r"such as its \.solution"),
        "adaptive run": (adaptive, r"such as its \.result"),
    }[given]
    with pytest.raises(TypeError, match=where):
        needs(one)
