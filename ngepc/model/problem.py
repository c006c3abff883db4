"""One time step of quasi-static elasto-plasticity with contact, (2.14); the paper's examples."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial

from ngsolve import Mesh

from ngepc.checks import pickling as pickling  # registers pickling of NGSolve's types
from ngepc.checks.arguments import require_integer
from ngepc.checks.kinds import require_mesh
from ngepc.checks.sentences import arguments_in_words
from ngepc.model.checks import check_problem
from ngepc.model.data import LEFT, DefaultOrder, ProblemData
from ngepc.model.elements import outward_normal
from ngepc.model.features import features_of
from ngepc.model.kinematics import TWO_DIMENSIONAL, kinematics_of, with_thickness
from ngepc.model.material import Material
from ngepc.model.mesh_checks import check_mesh

MADE = ("mesh", "kinematics", "order", "thickness")
"""Fields that are converted when a problem is made, or by which others are."""


@dataclass(frozen=True, eq=False)
class Problem(ProblemData):
    """Minimise J(u, p) of (2.14) subject to u.n <= gap on the contact boundary.

    ``p`` in (2.14) is the plastic strain gained in this step; the total is
    ``initial_plastic_strain`` + p.  A change is ``dataclasses.replace(problem, gap=0.2)``.

    NGSolve's ``mesh.BoundaryCF({name: value})`` and ``MaterialCF`` are None where the mesh has none
    of the names, and None leaves an argument out: a misspelt name means no friction.

    Parameters
    ----------
    mesh
        NGSolve mesh in N = 2 or 3 dimensions.
    material
        Material data.
    clamped
        Names of the boundaries with u = 0 (Gamma_d), 'a' or 'a|b'; None if there is none.
    traction
        Boundary name -> surface load g (force per area), a vector.  It may act on any boundary
        that is not clamped.  ``Edge(name)`` -> force per length, ``Point(where)`` -> force; on a
        body of revolution that of the whole ring.
    contact
        Names of the possible contact boundary (Gamma_c), ``Contact(first, second)`` for two bodies
        of the mesh that may touch or are tied, or a sequence of both; None if there is none.
    gap
        psi: distance to the obstacle along the outer normal (length), a number, a scalar
        coefficient, or a mapping of boundary names, 'a' or 'a|b' -> either.  Negative where the
        obstacle penetrates the undeformed body.
    body_force
        f (force per volume), a vector, or None.
    initial_plastic_strain
        p_0, a symmetric trace-free tensor, 2 x 2 or 3 x 3 as the kinematics has it; None for zero.
    initial_hardening
        alpha_0: the scalar alpha_1 >= 0 (isotropic), the symmetric back stress alpha_2
        (kinematic), or the pair (alpha_1, alpha_2) (combined); None for zero.  Of
        ``Material.cyclic`` a vector, the coordinates of the plastic strains of all sub-elements;
        None where all of them have ``initial_plastic_strain``.
    prescribed
        Boundary name, ``Edge(name)`` or ``Point(where)`` -> N displacement components, None for a
        free one: {'left': (0, None)}; or ``Roller(direction)``, a support along one direction.
    friction
        Tresca's bound F >= 0 on the tangential traction (stress), a number or scalar coefficient;
        it acts on the whole contact boundary, also where the gap is open.  Or
        ``Coulomb(mu, limit=F)``, which acts under pressure only.  None for no friction.
    initial_displacement
        u_0 at the beginning of the step (length), a vector, only for friction: the slip of this
        step is the tangential part of u - u_0.  None for zero.
    initial_accumulated
        PEEQ of the steps before, >= 0 (1), where a ``HardeningLaw`` starts; None for zero.
    kinematics
        In 2D "plane strain", "plane stress" (thin sheets, sigma_zz = 0), "two-dimensional" (the
        law of the paper with 2 x 2 tensors) or "axisymmetric" (x is the radius; forces are those
        of the whole ring); in 3D "solid".
        None for plane strain or solid.
    order
        Polynomial degree of the displacements, 1 or 2.  None for 1 with the law of the paper
        ("two-dimensional") and 2 elsewhere: displacements of order 1 are too stiff where plastic
        flow keeps the volume (docs/locking.md).  The attribute is the order that was taken.
    pressure
        Boundary name -> pressure on the body (stress), positive inward: {'top': 10} is the
        traction -10 n, with the normal of the undeformed body.
    springs
        Boundary name -> stiffness k >= 0 per area (force per volume) of an elastic foundation: one
        number resists u.n, N numbers the components.  ``Edge(name)`` -> N numbers per length,
        ``Point(where)`` -> N numbers (force per length).  They are free of force at u = 0.
    initial_strain
        eps_0, the strain that is free of stress: a number or scalar coefficient for the same
        in all directions, expansion times change of temperature for example, or a symmetric
        tensor like ``initial_plastic_strain`` but with a trace; None for zero.
    duration
        The length of the time step (time), > 0; ``evolve`` sets it.  It is needed if the material
        has a rate; None otherwise.
    thickness
        Of the body in plane strain or plane stress (length), > 0: forces, energies and stiffnesses
        of springs are those of the whole thickness; None for 1.

    Raises
    ------
    TypeError, ValueError
        For data that are not legal, naming the argument, the value and the legal range.
    """

    def __post_init__(self) -> None:
        require_mesh("mesh", self.mesh)
        self.processes.together(partial(check_mesh, self.mesh))
        kinematics = kinematics_of(self.kinematics, self.mesh.dim)
        vars(self)["kinematics"] = with_thickness(kinematics, self.thickness)
        vars(self)["order"] = self._order()
        check_problem(self)

    def _order(self) -> int:
        """The order that was given, else that of the kinematics."""
        if self.order is None or isinstance(self.order, DefaultOrder):
            return DefaultOrder(1 if self.kinematics is TWO_DIMENSIONAL else 2)
        return require_integer("order", self.order, 1, 2)

    def __repr__(self) -> str:
        """The arguments that were given; meshes and coefficients by their kind."""
        given = {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if getattr(self, field.name) is not None
        }
        given["kinematics"] = self.kinematics.name
        return f"Problem({arguments_in_words(given)})"

    @property
    def features(self) -> dict[str, tuple[str, object]]:
        """Name of each feature that the problem has -> (argument, value).

        A method that does not cover one of them refuses it by name; the page on what each method
        covers has the table.
        """
        return features_of(self)

    def changed(self, **changes: object) -> Problem:
        """The problem with other values of some fields, checked as far as they matter.

        The same as ``dataclasses.replace(problem, **changes)``, and faster, because a change of a
        load does not check the mesh again.

        Raises
        ------
        TypeError, ValueError
            For names that are no fields, and for data that are not legal.
        """
        known = {field.name for field in fields(self)}
        strange = sorted(set(changes) - known)
        if strange:
            raise TypeError(
                f"Problem has no {', '.join(strange)}: fields are {', '.join(sorted(known))}"
            )
        if any(
            changes.get(name, vars(self)[name]) is not vars(self)[name] for name in MADE
        ):
            return replace(self, **changes)
        other = self._with(changes)
        check_problem(other, self)
        return other

    def continued(self, **history: object) -> Problem:
        """The problem with history variables of earlier steps (``LEFT``), not checked again."""
        strange = sorted(set(history) - set(LEFT))
        if strange:
            raise TypeError(f"{', '.join(strange)}: fields of a history are {LEFT}")
        return self._with(history)

    def _with(self, changes: dict[str, object]) -> Problem:
        other = object.__new__(type(self))
        names = (field.name for field in fields(self))
        vars(other).update({name: vars(self)[name] for name in names} | changes)
        return other


def lshape_problem(mesh: Mesh) -> Problem:
    """Example (a): L-shape, kinematic hardening, pressure 10 from below, gap 0.1 at the top.

    Parameters
    ----------
    mesh
        A mesh of ``ngepc.geometries.lshape``; TypeError or ValueError for others.
    """
    metal = {
        "lame_lambda": 1.0e3,
        "lame_mu": 1.0e3,
        "yield_stress": 1.25,
        "hardening": 100.0,
    }
    return _paper_problem(mesh, Material.kinematic(**metal), 10.0, 0.1)


def wrench_problem(mesh: Mesh) -> Problem:
    """Example (b): screw wrench, isotropic hardening, pressure 6e-3 on the handle, gap 1.

    Parameters
    ----------
    mesh
        A mesh of ``ngepc.geometries.wrench``; TypeError or ValueError for others.
    """
    metal = {"lame_lambda": 1.15e1, "lame_mu": 7.69, "yield_stress": 0.2}
    metal |= {"hardening_modulus": 1.0e-3, "hardening_stiffness": 1.0e7}
    return _paper_problem(mesh, Material.isotropic(**metal), 6.0e-3, 1.0)


def _paper_problem(
    mesh: Mesh, material: Material, pressure: float, gap: float
) -> Problem:
    """A body of section 7, with the 2 x 2 tensors and the elements of order one of the paper."""
    require_mesh("mesh", mesh, (2,))
    load = {"load": -pressure * outward_normal(mesh)}
    flat = {"kinematics": "two-dimensional", "order": 1}
    return Problem(mesh, material, "clamped", load, contact="contact", gap=gap, **flat)
