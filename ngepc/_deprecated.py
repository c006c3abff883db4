"""Names and modules of the previous version, kept for one version with a DeprecationWarning.

Each old name gives the object that has taken its place.  ``install`` makes old modules
importable, ``old_names`` is the ``__getattr__`` of modules that have lost names, ``renamed`` makes
the old attribute of a class.
"""

import importlib
import sys
import warnings
from collections.abc import Callable
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED = {
    "ngepc.Between": "ngepc.goals.brackets.Bracket",
    "ngepc.bounds.adaptive.BoundedResult": "ngepc.goals.refinement.BoundedResult",
    "ngepc.bounds.adaptive.Refinement": "ngepc.goals.refinement.Refinement",
    "ngepc.bounds.adaptive.solve_to": "ngepc.goals.adaptive.solve_to",
    "ngepc.bounds.bound.bound_data_of": "ngepc.bounds.of_state.bound_data_of",
    "ngepc.bounds.bound.setting_of": "ngepc.bounds.of_state.bound_data_of",
    "ngepc.bounds.goal_bound.GoalBound": "ngepc.goals.goal_interval.GoalBound",
    "ngepc.bounds.goal_bound.goal_bound": "ngepc.goals.goal_bound.goal_bound",
    "ngepc.bounds.goal_terms.ContactForceOn": "ngepc.goals.kinds.ContactForceOn",
    "ngepc.bounds.goal_terms.LoadWork": "ngepc.goals.kinds.LoadWork",
    "ngepc.bounds.goal_terms.MeanDisplacement": "ngepc.goals.kinds.MeanDisplacement",
    "ngepc.bounds.goals.Between": "ngepc.goals.brackets.Bracket",
    "ngepc.bounds.goals.Bracket": "ngepc.goals.brackets.Bracket",
    "ngepc.bounds.goals.contact_force_bracket": "ngepc.goals.brackets.contact_force_bracket",
    "ngepc.bounds.goals.displacement_bracket": "ngepc.goals.brackets.displacement_bracket",
    "ngepc.bounds.plane.PlaneSetting": "ngepc.bounds.plane.PlaneBoundData",
    "ngepc.bounds.receipt.write_receipt": "ngepc.goals.receipt.write_receipt",
    "ngepc.bounds.setting.Effort": "ngepc.bounds.data.Effort",
    "ngepc.bounds.setting.Setting": "ngepc.bounds.data.BoundData",
    "ngepc.bounds.setting.factorise": "ngepc.bounds.balance.factorise",
    "ngepc.bounds.setting.stress_coordinates": "ngepc.bounds.coordinates.stress_coordinates",
    "ngepc.bounds.solid.SolidSetting": "ngepc.bounds.solid.SolidBoundData",
    "ngepc.bounds.transfer.bisected": "ngepc.bounds.copies.bisected",
    "ngepc.bounds.verdicts.Verdict": "ngepc.goals.verdicts.Verdict",
    "ngepc.bounds.verdicts.confidence": "ngepc.goals.confidence.confidence",
    "ngepc.bounds.verdicts.verdict": "ngepc.goals.verdicts.verdict",
    "ngepc.discretisation.balance.Balance": "ngepc.discretisation.body.Iterate",
    "ngepc.discretisation.balance.Floating": "ngepc.discretisation.floating.Floating",
    "ngepc.discretisation.balance.Frame": "ngepc.discretisation.body.DiscreteBody",
    "ngepc.discretisation.law.VonMisesLaw": "ngepc.discretisation.von_mises_law.VonMisesLaw",
    "ngepc.discretisation.stiffness.ElementStiffness": (
        "ngepc.discretisation.element_stiffness.ElementStiffness"
    ),
    "ngepc.dual.algorithm.note": "ngepc.dual.algorithm.record",
    "ngepc.dual.blocks.elastic_terms": "ngepc.dual.saddle.elastic_terms",
    "ngepc.dual.blocks.load_terms": "ngepc.dual.saddle.load_terms",
    "ngepc.dual.functional.Iterate": "ngepc.dual.functional.DualIterate",
    "ngepc.dual.functional.RadialLaw": "ngepc.dual.saddle.RadialLaw",
    "ngepc.dual.newton.NewtonOptions": "ngepc.results.options.NewtonOptions",
    "ngepc.dual.newton.prepared": "ngepc.dual.solver.prepared",
    "ngepc.dual.newton.semismooth_newton": "ngepc.methods.newton.semismooth_newton",
    "ngepc.evolution.result.EvolutionFile": "ngepc.evolution.file.EvolutionFile",
    "ngepc.local.result.error_indicators": "ngepc.local.indicators.error_indicators",
    "ngepc.model.given.Given": "ngepc.model.data.ProblemData",
    "ngepc.model.given.as_scalar": "ngepc.model.data.as_scalar",
    "ngepc.model.material.lame_parameters": "ngepc.model.tensile.lame_parameters",
    "ngepc.pictures.export.in_space": "ngepc.pictures.vtu.in_space",
    "ngepc.pictures.monitors.progress_line": "ngepc.results.progress.progress_line",
    "ngepc.pictures.wording.flat_rows": "ngepc.pictures.rows.flat_rows",
    "ngepc.results.iteration.drowned": "ngepc.results.ending.limited_by_rounding",
    "ngepc.results.iteration.stuck": "ngepc.results.ending.no_descent",
    "ngepc.sensitivity.gradient.TangentResult": "ngepc.sensitivity.tangent.TangentResult",
    "ngepc.sensitivity.gradient.tangent": "ngepc.sensitivity.tangent.tangent",
    "ngepc.sensitivity.radial.Data": "ngepc.sensitivity.equations.Data",
    "ngepc.sensitivity.radial.Tape": "ngepc.sensitivity.equations.Tape",
}
"""Old full name -> new full name."""

OLD_MODULES = frozenset(
    {
        "ngepc.bounds.adaptive",
        "ngepc.bounds.goal_bound",
        "ngepc.bounds.goal_terms",
        "ngepc.bounds.goals",
        "ngepc.bounds.receipt",
        "ngepc.bounds.setting",
        "ngepc.bounds.verdicts",
        "ngepc.discretisation.balance",
        "ngepc.dual.newton",
        "ngepc.model.given",
        "ngepc.sensitivity.radial",
    }
)
"""Modules that have no file any more."""


def found(old: str, stacklevel: int = 3) -> object:
    """The object that has taken the place of an old name, with a warning at the caller."""
    new = MOVED[old]
    message = f"{old} is now {new}; the old name will go in the next version"
    warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)
    module, _, name = new.rpartition(".")
    return getattr(importlib.import_module(module), name)


def old_names(module: str) -> Callable[[str], object]:
    """``__getattr__`` of a module that has lost names."""

    def look_up(name: str) -> object:
        """The new object for an old name of the module."""
        old = f"{module}.{name}"
        if old not in MOVED:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return found(old)

    return look_up


def renamed(old: str, new: str) -> property:
    """An attribute of a class that is now called ``new``."""

    def look_up(self: object) -> object:
        """The value of the attribute under its new name."""
        place = type(self).__name__
        message = f"{place}.{old} is now {place}.{new}"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(self, new)

    return property(look_up, doc=f"The old name of ``{new}``.")


class OldModules(MetaPathFinder, Loader):
    """Makes empty modules under old names, which look up their names in ``MOVED``."""

    def find_spec(
        self, fullname: str, path: object, target: object = None
    ) -> ModuleSpec | None:
        """The specification of an old module, None for all others."""
        return ModuleSpec(fullname, self) if fullname in OLD_MODULES else None

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its ``__getattr__``."""
        module.__doc__ = "A module of the version before."
        module.__getattr__ = old_names(module.__name__)


def install() -> None:
    """Let Python find old modules where it finds no file; once."""
    if not any(type(finder).__name__ == "OldModules" for finder in sys.meta_path):
        sys.meta_path.append(OldModules())
