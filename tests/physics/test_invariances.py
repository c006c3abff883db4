"""What must not matter: units, position, orientation, handedness and numbering of the mesh.

All of them to round-off: the transformed run takes the same steps.
"""

import dataclasses

import numpy as np
import pytest
from bodies import FLAT, STEEL, distorted, moved_by
from netgen.meshing import Element1D, Element2D, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import CF, Mesh, x, y

from ngepc import (
    Coulomb,
    Coupled,
    DisplacementAt,
    Material,
    NewtonOptions,
    Norton,
    Problem,
    Status,
    Units,
    error_bound,
    evolve,
    goal_bound,
    gradient,
    limit_load,
    semismooth_newton,
)
from ngepc.geometries import block, lshape
from ngepc.primal.solver import primal_newton

STRESS, LENGTH = 2e8, 0.25
NODES = 113
SHARP = NewtonOptions(tolerance=1e-12)
"""So that what is left of the residual is rounding."""


@dataclasses.dataclass(frozen=True)
class Motion:
    """A map x -> length R x + shift of the body, in units of another length and stress."""

    R: np.ndarray = dataclasses.field(default_factory=lambda: np.eye(2))
    shift: tuple = (0.0, 0.0)
    length: float = 1.0
    stress: float = 1.0

    def mesh(self, mesh):
        for point in mesh.ngmesh.Points():
            moved = self.length * self.R @ [point.p[0], point.p[1]] + self.shift
            point[0], point[1] = float(moved[0]), float(moved[1])
        return mesh

    def vector(self, components):
        a, b = components
        return tuple(float(r[0]) * a + float(r[1]) * b for r in self.R)

    def place(self):
        """The coordinates that a point had before the motion."""
        a, b = (x - self.shift[0]) / self.length, (y - self.shift[1]) / self.length
        return tuple(float(c[0]) * a + float(c[1]) * b for c in self.R.T)

    def matrix(self, A):
        return self.R @ np.asarray(A) @ self.R.T


def problem(motion=None, mesh=None):
    """A loaded L-shape with a varying gap, body force, initial strain and back stress."""
    motion = Motion() if motion is None else motion
    mesh = motion.mesh(lshape.paper_mesh(NODES)) if mesh is None else mesh
    unit = motion.stress
    material = Material(
        lame_lambda=800.0 * unit,
        lame_mu=1e3 * unit,
        yield_stress=1.25 * unit,
        hardening=80.0 * unit,
        hardening_modulus=0.5,
        hardening_stiffness=60.0 / unit,
    )
    p_0 = motion.matrix([[1e-3, 5e-4], [5e-4, -1e-3]])
    back = unit * motion.matrix([[0.1, 0.05], [0.05, -0.1]])
    X, _ = motion.place()
    load = motion.vector((1.0 + X, 9.0))
    force = motion.vector((unit / motion.length, 0.5 * unit / motion.length))
    return Problem(
        mesh,
        material,
        "clamped",
        {"load": CF(tuple(unit * g for g in load))},
        contact="contact",
        gap=motion.length * (0.05 + 0.1 * X),
        body_force=force,
        initial_plastic_strain=CF(tuple(p_0.ravel().tolist()), dims=(2, 2)),
        initial_hardening=(0.1, CF(tuple(back.ravel().tolist()), dims=(2, 2))),
        kinematics=FLAT[mesh.dim],
    )


METHODS = {
    "primal": lambda p, units: primal_newton(p),
    "coupled": lambda p, units: semismooth_newton(
        p, regularisation=Coupled(1e3, units=units), options=SHARP
    ),
}


@pytest.fixture(scope="module", params=METHODS)
def method(request):
    """The solver and its result for the body where it is."""
    solver = METHODS[request.param]
    return solver, solver(problem(), Units())


def displacements(result):
    return result.displacement.vec.FV().NumPy().reshape(2, -1).copy()


def assert_same(moved, result, motion):
    """The same steps and, turned back, the same displacements, energies and forces."""
    assert result.status is Status.CONVERGED
    assert moved.status is Status.CONVERGED
    assert moved.history.step_lengths == pytest.approx(result.history.step_lengths)
    back = motion.R.T @ displacements(moved) / motion.length
    error = np.abs(back - displacements(result)).max()
    assert error < 1e-10 * np.abs(displacements(result)).max()
    energy = motion.stress * motion.length**2
    for name in ("primal_energy", "dual_energy"):
        assert getattr(moved, name) == pytest.approx(
            energy * getattr(result, name), rel=1e-10
        )
    force = motion.stress * motion.length
    assert moved.contact_force == pytest.approx(force * result.contact_force, rel=1e-9)
    residuals = np.array(moved.history.residual_norms) / result.history.residual_norms
    assert residuals[0] == pytest.approx(residuals[1], rel=1e-8)


MOTIONS = {
    "other units": Motion(stress=STRESS, length=LENGTH),
    "tiny units": Motion(stress=1e-7, length=1e5),
    "elsewhere": Motion(shift=(3.0, -2.0)),
    "turned by 90 degrees": Motion(R=np.array([[0.0, -1.0], [1.0, 0.0]])),
    "turned by 30 degrees": Motion(
        R=np.array([[np.cos(np.pi / 6), -0.5], [0.5, np.cos(np.pi / 6)]])
    ),
    "mirrored": Motion(R=np.array([[-1.0, 0.0], [0.0, 1.0]])),
    "mirrored in the diagonal": Motion(R=np.array([[0.0, 1.0], [1.0, 0.0]])),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_motions_and_units_change_nothing(method, name):
    solver, result = method
    motion = MOTIONS[name]
    moved = solver(problem(motion), Units(stress=motion.stress, length=motion.length))
    assert_same(moved, result, motion)


@pytest.mark.parametrize(("stress", "length"), [(1e6, 1e-3), (1e6, 1e7)])
def test_units_change_no_bound(stress, length):
    """The pressure of a bound kept its resultant, but in small units not its moment."""
    first, second = (
        error_bound(primal_newton(problem(Motion(stress=s, length=size))))
        for s, size in ((1.0, 1.0), (stress, length))
    )
    assert second.total == pytest.approx(stress * length**2 * first.total, rel=1e-9)


def test_a_displacement_at_a_point_of_a_small_body():
    """Its derivative by the load is that of the same body in another unit of length."""
    found = []
    for length in (1.0, 1e-6):
        mesh = moved_by(length * np.eye(2), distorted(3))
        result = semismooth_newton(
            Problem(mesh, STEEL, traction={"right": (0.5, 0.2)}, order=1)
        )
        at = DisplacementAt((0.61 * length, 0.57 * length), 0)
        slope = gradient(result, at, ["traction"])["traction"]
        found.append(
            (slope / length, *np.divide(goal_bound(result, at).interval, length))
        )
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def numbers_in(length, stress, time):
    """Steps, and numbers without unit, of problems in units of length, stress and time.

    Coulomb's friction, springs with an interval, a history with a law of the rate, a limit load.
    """
    mesh = moved_by(length * np.eye(2), block.structured_mesh(3, 3, simplices=True))
    steel = Material.kinematic(
        lame_lambda=1e3 * stress,
        lame_mu=1e3 * stress,
        yield_stress=1.25 * stress,
        hardening=1e2 * stress,
    )
    pulled = {"right": (2.0 * stress, 1.5 * stress)}
    plain = Problem(mesh, steel, traction=pulled, order=1)
    touching = {"contact": "contact", "gap": -1e-3 * length}
    rubbing = semismooth_newton(
        dataclasses.replace(plain, **touching, friction=Coulomb(0.3))
    )
    springs = {"contact": 200.0 * stress / length}
    sprung = semismooth_newton(dataclasses.replace(plain, springs=springs))
    work = goal_bound(sprung, "work")
    rate = Norton(stress * time ** (1 / 3), 3.0)
    viscous = dataclasses.replace(plain, material=dataclasses.replace(steel, rate=rate))
    history = evolve(viscous, [(0.5 * time, {}), (time, {"traction": None})])
    limit = limit_load(plain, 0.1, max_cells=60)
    force = stress * length
    energy = force * length
    steps = rubbing.iterations, sprung.iterations, *history.column("iterations")
    return steps, [
        rubbing.contact_force / force,
        *rubbing.state.u[:, 0] / length,
        work.lower / energy,
        work.upper / energy,
        *np.divide(history.column("primal_energy"), energy),
        limit.lower,
        limit.upper,
    ]


@pytest.mark.parametrize("large", [1.0, -1.0])
def test_units_change_no_digit(large):
    """Powers of two of 10^7 and 10^14: no operation rounds otherwise."""
    steps, numbers = numbers_in(1.0, 1.0, 1.0)
    found = numbers_in(*2.0 ** (large * np.array([24, -48, 24])))
    assert found[0] == steps
    assert found[1] == pytest.approx(numbers, rel=1e-11, abs=1e-14)


def renumbered(mesh, seed):
    """The same mesh with vertices, elements and edges in random order; and the vertex numbers."""
    random = np.random.default_rng(seed)
    old = mesh.ngmesh
    points = np.asarray(old.Coordinates())
    order = random.permutation(len(points))
    new = NetgenMesh(dim=2)
    number = {}
    for place in order:
        number[int(place)] = new.Add(MeshPoint(Pnt(*points[place][:2], 0)))
    body = new.AddRegion("body", dim=2)
    elements = list(old.Elements2D())
    for k in random.permutation(len(elements)):
        vertices = [number[v.nr - 1] for v in elements[k].vertices]
        new.Add(Element2D(body, vertices))
    regions = {
        name: new.AddRegion(name, dim=1) for name in dict.fromkeys(mesh.GetBoundaries())
    }
    names = mesh.GetBoundaries()
    edges = list(old.Elements1D())
    for k in random.permutation(len(edges)):
        vertices = [number[v.nr - 1] for v in edges[k].vertices]
        new.Add(Element1D(vertices, index=regions[names[edges[k].index - 1]]))
    return Mesh(new), np.array([number[i].nr - 1 for i in range(len(points))])


def test_numbering_changes_nothing(method):
    solver, result = method
    mesh, number = renumbered(lshape.paper_mesh(NODES), seed=4)
    moved = solver(problem(mesh=mesh), Units())
    assert moved.history.step_lengths == pytest.approx(result.history.step_lengths)
    size = np.abs(displacements(result)).max()
    difference = displacements(moved)[:, number] - displacements(result)
    assert np.abs(difference).max() < 1e-10 * size
    assert moved.dual_energy == pytest.approx(result.dual_energy, rel=1e-11)
    assert moved.contact_force == pytest.approx(result.contact_force, rel=1e-9)


def test_one_thread_gives_the_same_digits_twice(method):
    solver, result = method
    again = solver(problem(), Units())
    assert (displacements(again) == displacements(result)).all()
    assert again.history.residual_norms == result.history.residual_norms
    assert again.dual_energy == result.dual_energy
