"""One time step of quasi-static elasto-plasticity with contact, (2.14): the data of a problem."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ngsolve import CF, CoefficientFunction, Mesh

from ngepc.checks.arguments import Coefficient, boundary_names, is_number
from ngepc.model import checks
from ngepc.model.material import Material
from ngepc.model.normals import outward_normal
from ngepc.model.tensors import deviator

Vector = CoefficientFunction | Sequence[Coefficient]
"""A vector-valued CoefficientFunction, or a sequence of N numbers and scalar coefficients."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Minimise J(u, p) of (2.14) subject to u.n <= gap on the contact boundary.

    ``p`` in (2.14) is the plastic strain gained in this step; the total is
    ``initial_plastic_strain`` + p.  A change is ``dataclasses.replace(problem, gap=0.2)``.

    Parameters
    ----------
    mesh
        NGSolve mesh in N = 2 or 3 dimensions.  For N = 2 all tensors are 2 x 2 (reading.md).
    material
        Material data.
    clamped
        Names of the boundaries with u = 0 (Gamma_d), 'a' or 'a|b'; None if there is none.
    traction
        Boundary name -> surface load g (force per area), a vector.  It may act on any boundary
        that is not clamped.
    contact
        Names of the possible contact boundary (Gamma_c); None if there is none.
    gap
        psi: distance to the obstacle along the outer normal (length), a number, a scalar
        coefficient, or a mapping of boundary name -> either.  Negative where it pushes in.
    body_force
        f (force per volume), a vector; None for none.
    initial_plastic_strain
        p_0, a symmetric trace-free N x N coefficient; None for zero.
    initial_hardening
        alpha_0: the scalar alpha_1 >= 0 (isotropic), the symmetric N x N back stress alpha_2
        (kinematic), or the pair (alpha_1, alpha_2) (combined); None for zero.
    prescribed
        Boundary name -> N displacement components, None for a free one: {'left': (0, None)}
        is a roller.
    friction
        Tresca's bound F >= 0 on the tangential traction on the contact boundary (stress), a
        number or scalar coefficient; it acts also where the gap is open.  None for none.
    initial_displacement
        u_0 at the begin of the step (length), a vector, for friction alone: what slips in this
        step is u - u_0.  None for zero.

    Raises
    ------
    TypeError, ValueError
        For data that are not legal, naming the argument, the value and the legal range.
    """

    mesh: Mesh
    material: Material
    clamped: str | Sequence[str] | None = "clamped"
    traction: Mapping[str, Vector] | None = None
    contact: str | Sequence[str] | None = None
    gap: Coefficient | Mapping[str, Coefficient] | None = None
    body_force: Vector | None = None
    initial_plastic_strain: CoefficientFunction | None = None
    initial_hardening: Coefficient | tuple | None = None
    prescribed: Mapping[str, Sequence[Coefficient | None]] | None = None
    friction: Coefficient | None = None
    initial_displacement: Vector | None = None

    def __post_init__(self) -> None:
        checks.check_problem(self)

    @property
    def N(self) -> int:
        """Space dimension, 2 or 3."""
        return self.mesh.dim

    @property
    def normal(self) -> CoefficientFunction:
        """The outer unit normal n; ``specialcf.normal`` points inward on some CSG2d edges."""
        return outward_normal(self.mesh)

    @property
    def clamped_names(self) -> tuple[str, ...]:
        """Names of Gamma_d."""
        return () if self.clamped is None else boundary_names("clamped", self.clamped, self.mesh)

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of Gamma_c, empty without contact."""
        return () if self.contact is None else boundary_names("contact", self.contact, self.mesh)

    @property
    def tractions(self) -> dict[str, CoefficientFunction]:
        """Single boundary name -> g as a vector-valued coefficient."""
        return {
            name: as_vector(g)
            for names, g in (self.traction or {}).items()
            for name in boundary_names("traction", names, self.mesh)
        }

    @property
    def gaps(self) -> dict[str, CoefficientFunction]:
        """Single contact boundary name -> psi as a scalar coefficient."""
        if isinstance(self.gap, Mapping):
            return {name: as_scalar(self.gap[name]) for name in self.contact_names}
        return {name: as_scalar(self.gap) for name in self.contact_names}

    @property
    def psi(self) -> CoefficientFunction:
        """The gap on the whole contact boundary, zero elsewhere."""
        return self.mesh.BoundaryCF(self.gaps, default=0.0)

    @property
    def f(self) -> CoefficientFunction | None:
        """Body force as a vector-valued coefficient, or None."""
        return None if self.body_force is None else as_vector(self.body_force)

    @property
    def u_0(self) -> CoefficientFunction | None:
        """Displacement at the begin of the step as a vector-valued coefficient, or None."""
        u_0 = self.initial_displacement
        return None if u_0 is None else as_vector(u_0)

    @property
    def p_0(self) -> CoefficientFunction:
        """Initial plastic strain, an N x N coefficient."""
        if self.initial_plastic_strain is None:
            return CF((0.0,) * self.N**2, dims=(self.N, self.N))
        return self.initial_plastic_strain

    @property
    def alpha_0(self) -> tuple[CoefficientFunction, CoefficientFunction]:
        """Initial hardening (alpha_1, dev alpha_2): a scalar and an N x N coefficient."""
        scalar, back_stress = split_hardening(self.initial_hardening)
        if back_stress is None:
            back_stress = CF((0.0,) * self.N**2, dims=(self.N, self.N))
        return as_scalar(0.0 if scalar is None else scalar), deviator(back_stress, self.N)

    @property
    def effective_hardening(self) -> CoefficientFunction:
        """The scalar h in H~ p : p = h |p|^2."""
        return as_scalar(self.material.effective_hardening)

    @property
    def beta(self) -> Coefficient:
        """The yield bound, a number whenever the data are numbers."""
        scalar, _ = split_hardening(self.initial_hardening)
        return self.material.yield_bound(0.0 if scalar is None else scalar)


def as_scalar(value: Coefficient) -> CoefficientFunction:
    """A number or scalar coefficient as a CoefficientFunction."""
    return CF(float(value)) if is_number(value) else value


def as_vector(value: Vector) -> CoefficientFunction:
    """A vector coefficient from itself or from a sequence of its components."""
    return value if isinstance(value, CoefficientFunction) else CF(tuple(map(as_scalar, value)))


def split_hardening(value: object) -> tuple:
    """(alpha_1, alpha_2) from ``initial_hardening``; None for what is not given."""
    if value is None:
        return None, None
    if isinstance(value, tuple):
        return value
    if isinstance(value, CoefficientFunction) and len(value.dims) == 2:
        return None, value
    return value, None
