"""The table of methods and features: ``python docs/features.py`` writes ``features.md``.

It is made from the constants ``COVERS`` by which the methods refuse what they do not cover.
"""

from pathlib import Path

from ngepc.bounds import coverage as bounds
from ngepc.dual import blocks
from ngepc.goals import brackets, goal_bound, receipt
from ngepc.limit import reading, shakedown
from ngepc.local import indicators, solver
from ngepc.model import checks
from ngepc.model.features import FEATURES
from ngepc.pictures import export, sampling
from ngepc.primal import energy
from ngepc.sensitivity import gradient

PAGE = Path(__file__).with_name("features.md")

METHODS = {
    "exact": solver.COVERS,
    "primal": energy.COVERS,
    "gamma": blocks.COVERS,
    "bound": bounds.COVERS,
    "goal": goal_bound.COVERS,
    "receipt": receipt.COVERS,
    "bracket": brackets.COVERS,
    "limit load": reading.COVERS,
    "shakedown": shakedown.SHAKEDOWN_COVERS,
    "derivative": gradient.COVERS,
    "estimate": indicators.COVERS,
    "picture": sampling.COVERS,
    "VTU": export.COVERS,
    "processes": checks.SHARED_MESH_COVERS,
}
"""Column of the table -> features that the method covers."""

HEAD = """# What each method covers

Each method lists the features that it covers. A problem with any other feature is refused
before any work, and the error names the feature. `problem.features` says which features a
problem has.

- **exact**: `semismooth_newton`, `evolve`, `material_point`, and the certificate of a result
- **primal**: `primal_newton`, the second, independent solver
- **gamma**: the paper's regularised method, `semismooth_newton(problem, gamma=...)`,
  `follow_path`, `duality_report`
- **bound**: `error_bound`, `solve_to`: the guaranteed bounds of the error
- **goal**: `goal_bound`, `solve_to(goal=...)`, `verdict`
- **receipt**: `write_receipt`
- **bracket**: `contact_force_bracket`, `displacement_bracket`, `evolve(error=...)`
- **limit load**: `limit_load`, with obstacles that touch
- **shakedown**: `shakedown_load`
- **derivative**: `gradient`, `tangent`, `calibrate`
- **estimate**: `error_indicators`
- **picture**: `plot_field`, `plot_plastic_zone`, `write_report`; **VTU**: `export_vtu`
- **processes**: a mesh that several processes share

"""

TAIL = """
A method may cover two features but not both at once. These pairs are refused, too:

- Plane stress, Hill's criterion and sub-elements have bounds on quadrilaterals if these are
  parallelograms and `order=1`. Hill's criterion and sub-elements have none on hexahedra.
  `solve_to`, `verdict` and `evolve(error=...)` cut such elements into simplices first.
- Bounds on hexahedra need flat faces, and `order=1` with friction. If an obstacle is not affine
  on faces (quadratic for order 2), the bound is one for a displacement that is moved clear of it.
- Bounds of bodies of revolution need triangles, polynomial loads and supports of every part.
  They cover rigid obstacles without friction, no springs, no Hill's criterion and no sub-elements.
- Bounds, goals and brackets of two bodies, and of parts that contact alone holds, are for plane
  problems without friction. The first boundary of a pair must be straight, and the bodies are not
  tied.
- `evolve(error=...)` with Hill's criterion, sub-elements or bodies of revolution, which it covers
  too, needs triangles or tetrahedra and `order=1`. Other quadrilaterals and hexahedra are cut into
  these, with displacements of order 2.
- Goals with Hill's criterion need kinematic hardening alone: no isotropic hardening, law or rate.
- Receipts of rollers are for those along an axis. They need
  obstacles that are affine on each facet of the contact boundary, and supports that hold each
  component on a side of the boundary across it, or all components on some side.

Bounds and brackets need coefficients that are constant on each element. "Guaranteed" means
proved for data that are numbers, finite element functions or polynomials on each element, and for
gaps that are formulas in the coordinates, spheres and discs for example (not for bodies of
revolution). For other data the bound depends on samples, and `guaranteed` is False.

This page is made by `python docs/features.py`, and a test compares it with the methods. Another
test runs each method on a problem with each feature: the result agrees with an independent
computation, or the method refuses the problem by name.
"""


def page() -> str:
    """The text of the page."""
    names = list(METHODS)
    rows = [["feature", *names], ["---"] + [":-:"] * len(names)]
    for feature in FEATURES:
        marks = ["x" if feature in METHODS[name] else "" for name in names]
        rows.append([feature, *marks])
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"{HEAD}{table}\n{TAIL}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
