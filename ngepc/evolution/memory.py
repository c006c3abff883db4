"""The history variables of a load history, passed from each step to the next one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ngepc.checks.arguments import is_number
from ngepc.checks.sentences import in_words
from ngepc.discretisation.finer import seen_material
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import PointFunctions, Points, on_children
from ngepc.discretisation.spaces import nodal
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ
from ngepc.results.fields import Fields


@dataclass(frozen=True, eq=False)
class Memory:
    """The history variables p_0 and alpha_0 of (2.15) and (2.16) at the integration points.

    ``arrays`` are coordinates of "plastic_strain" p_0 (1) and "back_stress" dev alpha_2,0 (stress),
    shape (points, d), "hardening_variable" alpha_1,0 >= 0 (1) and "accumulated", PEEQ (1), shape
    (points,); of ``Material.cyclic`` "parts" too, the plastic strains of n sub-elements, shape
    (points, n d).  ``functions`` are the points, and the polynomials through them, ``material`` is
    that of the stresses.
    """

    functions: PointFunctions
    arrays: dict[str, np.ndarray]
    material: Material

    @classmethod
    def initial(cls, problem: Problem) -> Memory:
        """The initial state that ``problem`` was given."""
        points = Points(problem.mesh, problem.kinematics, problem.order)
        alpha_1, alpha_2 = problem.alpha_0
        coordinates = problem.kinematics.coordinates
        given = {
            "plastic_strain": coordinates(problem.p_0),
            "back_stress": coordinates(alpha_2),
            "hardening_variable": alpha_1,
            "accumulated": problem.accumulated_0,
        }
        arrays = {name: points.at(v) for name, v in given.items()}
        if problem.material.overlay is not None:
            arrays |= law_of(problem, points).own_memory()
        return cls(points.functions, arrays, problem.material)

    def after_step(self, problem: Problem, fields: Fields) -> Memory:
        """The history after a step, from its displacement and its plastic strain."""
        points = self.functions.points
        p = points.at(fields.plastic_increment)
        material = problem.material
        if material.overlay is None and material.hill is None:
            return self.after(material, p)
        law = law_of(problem, points)
        u = nodal(fields.displacement.vec.FV().NumPy(), problem)
        at = law.returned(*law.beyond_initial(*points.strain(u)))
        return self.after(material, p, law.own_memory(at), at.gained)

    def after(
        self,
        material: Material,
        p: np.ndarray,
        own: Mapping[str, np.ndarray] | None = None,
        size: np.ndarray | None = None,
    ) -> Memory:
        """p_0 + p, alpha_2,0 + k p, alpha_1 + k_1 H sigma_y |p| and PEEQ after a step.

        ``own`` are additional history variables of the law, ``size`` is what takes the place of
        |p| (points,), for a yield surface that is no sphere.
        """
        points = self.functions.points
        at = points.at
        seen = seen_material(material, points)
        size = np.linalg.norm(p, axis=1) if size is None else size
        gained = {
            "plastic_strain": p,
            "back_stress": at(seen.hardening)[:, None] * p,
            "hardening_variable": at(seen.scalar_growth) * size,
            "accumulated": PEEQ * size,
        }
        before = self.with_material(material).arrays
        grown = {name: before[name] + more for name, more in gained.items()}
        return replace(self, arrays=grown | dict(own or {}), material=material)

    def with_material(self, material: Material) -> Memory:
        """The same strains with the moduli of another material.

        The plastic strain, PEEQ, alpha_2 / k and alpha_1 / k_1 are kept: the strains whose
        energy is that of hardening.  The stresses alpha_2 and alpha_1 follow the moduli k and k_1.
        ValueError where a kind of hardening comes or goes, since its strain is not known.
        """
        if material is self.material:
            return self
        points = self.functions.points
        earlier = seen_material(self.material, points)
        later = seen_material(material, points)
        moduli = {
            "back_stress": "hardening",
            "hardening_variable": "hardening_stiffness",
        }
        arrays = dict(self.arrays)
        for name, modulus in moduli.items():
            before = points.at(getattr(earlier, modulus))
            after = points.at(getattr(later, modulus))
            if ((before == 0) != (after == 0)).any():
                raise ValueError(
                    f"material={in_words(material)}: {modulus} is zero in one of two "
                    "successive steps; "
                    "all steps need the same kind of hardening"
                )
            factor = after / np.where(before > 0, before, 1.0)
            arrays[name] = (np.where(before > 0, factor, 1.0) * arrays[name].T).T
        return replace(self, arrays=arrays, material=material)

    def on(self, problem: Problem, parents: np.ndarray) -> Memory:
        """The same functions on a mesh whose simplices lie in these ones; PEEQ stays >= 0."""
        points = Points(problem.mesh, problem.kinematics, problem.order)
        before = self.functions.points
        carried = {
            k: on_children(v, before, points, parents) for k, v in self.arrays.items()
        }
        carried["accumulated"] = np.maximum(carried["accumulated"], 0.0)
        return Memory(points.functions, carried, self.material)

    def as_bounds_need_it(self) -> Memory:
        """The same history with one value of hardening on each element.

        Between the points of an element the polynomial of alpha_1 or PEEQ may be negative, and so
        may be its values at the points of smaller elements.  The mean is not.
        """
        arrays = dict(self.arrays)
        names = ["hardening_variable"]
        if self.material.law is not None:
            names.append("accumulated")
        for name in names:
            arrays[name] = self.functions.points.cell_means(arrays[name])
        return replace(self, arrays=arrays)

    def problem(self, base: Problem, changes: Mapping[str, object]) -> Problem:
        """``base`` with the changes of a step and this memory as its initial state."""
        step = base.changed(**changes)
        check_kind(base.material, step.material)
        return self.before(step)

    def before(self, step: Problem, **left: object) -> Problem:
        """A step that is checked, with this memory as its initial state, and what else is left."""
        material = step.material
        tensor = step.kinematics.tensor
        arrays = self.with_material(material).arrays
        given = {name: self.functions.function(v) for name, v in arrays.items()}
        hardening = tensor(given["back_stress"])
        if not is_zero(material.hardening_modulus):
            hardening = given["hardening_variable"], hardening
        if "parts" in given:
            hardening = given["parts"]
        return step.continued(
            initial_plastic_strain=tensor(given["plastic_strain"]),
            initial_hardening=hardening,
            initial_accumulated=given["accumulated"],
            **left,
        )


def check_kind(one: Material, other: Material) -> None:
    """Accept a material of a step with the same history variables as the other one."""
    for name in ("law", "hill", "overlay"):
        before = getattr(one, name)
        after = getattr(other, name)
        if type(before) is not type(after):
            raise ValueError(
                f"material={in_words(other)}: {name} like that of the problem is "
                f"needed, {in_words(before)}"
            )
    if one.overlay is not None and one.overlay.count != other.overlay.count:
        raise ValueError(
            f"material={in_words(other)}: {one.overlay.count} sub-elements are needed, "
            f"it has {other.overlay.count}"
        )


def is_zero(value: object) -> bool:
    """Whether a coefficient is the number 0."""
    return is_number(value) and value == 0
