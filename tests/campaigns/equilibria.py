"""Random elastic blocks with friction: all equilibria by enumeration, compared with the solvers.

Only ``Problem`` is taken from the package: stiffness and loads are assembled by forms of NGSolve,
the rows are the vertices of the top with the normal (0, 1), and each set of closed rows with each
choice of sticking and slipping rows is solved separately.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from ngsolve import (
    BND,
    CF,
    BilinearForm,
    InnerProduct,
    LinearForm,
    Sym,
    Trace,
    VectorH1,
    ds,
    dx,
    grad,
    sin,
    x,
)

from ngepc import Coulomb, Material, Problem, Status, semismooth_newton
from ngepc.geometries import block
from ngepc.studies.work import Work

LOOSE = 1e-9  # tolerance of the conditions, relative to the largest force
DIFFERENT = 1e-6  # relative distance in the energy norm of two different equilibria
CLOSE = 1e-6  # of the largest force: forces of a solver and of the enumeration

LAWS = ("Coulomb", "Coulomb with a limit", "Tresca")


def random_problem(seed, law):
    """An elastic block of 3 to 8 rows on its base, pushed and pressed; its friction is strong."""
    random = np.random.default_rng(seed)
    cells = int(random.integers(2, 5 if law == "Coulomb with a limit" else 8))
    height = float(random.choice([0.3, 0.5, 1.0, 2.0]))
    layers = int(random.integers(1, 7))
    nu = float(random.choice([0.0, 0.3, 0.45, 0.49, 0.499]))
    material = Material.kinematic(
        lame_lambda=2 * nu / (1 - 2 * nu), lame_mu=1.0, yield_stress=1e6, hardening=1.0
    )
    mean, wave = random.uniform(-1e-3, 1e-3, 2).tolist()
    phase = float(random.uniform(0, 6))
    mu = float(10 ** random.uniform(-0.7, 1.0))
    limit = float(10 ** random.uniform(-4, -2))
    friction = {
        "Coulomb": Coulomb(mu),
        "Coulomb with a limit": Coulomb(mu, limit=limit),
        "Tresca": limit,
    }[law]
    push = random.uniform(-2e-3, 2e-3, 4)
    return Problem(
        block.structured_mesh(cells, layers, size=(1, height), simplices=True),
        material,
        "clamped",
        {"right": tuple(push[:2].tolist())},
        "contact",
        mean + wave * sin(5 * x + phase),
        body_force=tuple(push[2:].tolist()),
        order=1,
        friction=friction,
    )


class Block:
    """Compliance, free gaps and friction bounds of the rows, assembled independently."""

    def __init__(self, problem):
        mesh = problem.mesh
        material = problem.material
        space = VectorH1(mesh, order=1, dirichlet="clamped")
        u, v = space.TnT()
        eps = Sym(grad(u))
        stress = 2 * material.lame_mu * eps
        energy = InnerProduct(stress, Sym(grad(v)))
        energy += material.lame_lambda * Trace(grad(u)) * Trace(grad(v))
        K = BilinearForm(energy * dx).Assemble().mat
        load = LinearForm(space)
        load += CF(problem.body_force) * v * dx
        load += CF(problem.traction["right"]) * v * ds("right")
        load.Assemble()
        inverse = K.Inverse(space.FreeDofs(), "sparsecholesky")
        top = sorted(
            {w.nr for e in mesh.Boundaries("contact").Elements() for w in e.vertices}
        )
        places = np.array([mesh.vertices[nr].point for nr in top])
        number = np.array(top)
        rows = np.concatenate([mesh.nv + number, number])  # u_y, then u_x
        answers = []
        force = load.vec.CreateVector()
        answer = load.vec.CreateVector()
        for row in rows:
            force[:] = 0
            force[int(row)] = 1.0
            answer.data = inverse * force
            answers.append(answer.FV().NumPy()[rows].copy())
        answer.data = inverse * load.vec
        free = answer.FV().NumPy()[rows]
        m = len(top)
        gaps = [problem.gap(mesh(*place, VOL_or_BND=BND)) for place in places]
        self.m = m
        self.S = np.array(answers)
        self.gaps = np.append(gaps, np.zeros(m)) - free  # open gaps, minus slips
        length = np.zeros(m)
        order = np.argsort(places[:, 0])
        steps = np.diff(places[order, 0])
        length[order[:-1]] += steps / 2
        length[order[1:]] += steps / 2
        law = problem.friction
        coulomb = isinstance(law, Coulomb)
        limit = law.limit if coulomb else law
        self.mu = law.coefficient if coulomb else np.inf
        self.limit = np.full(m, np.inf) if limit is None else limit * length

    def bound(self, n):
        """The bound of friction."""
        return self.limit if np.isinf(self.mu) else np.minimum(self.mu * n, self.limit)

    def excess(self, forces):
        """Largest violation of the law by forces, relative to the largest force."""
        n, t = np.split(forces, 2)
        open_gap, back = np.split(self.gaps + self.S @ forces, 2)
        soft = self.S.diagonal()
        size = max(np.abs(forces).max(), np.abs(self.gaps / soft).max())
        bound = self.bound(n)
        pressing = np.abs(n - np.maximum(n - open_gap / soft[: self.m], 0))
        trial = t - back / soft[self.m :]
        rubbing = np.abs(t - np.clip(trial, -bound, bound))
        return max(pressing.max(), rubbing.max()) / size if size > 0 else 0.0

    def equilibria(self):
        """All forces that satisfy the law, without duplicates."""
        found = []
        for closed in product((False, True), repeat=self.m):
            rows = np.flatnonzero(closed)
            kinds = (
                ("stick", 1, -1) if np.isinf(self.limit[0]) else ("stick", 1, -1, 2, -2)
            )
            for states in product(kinds, repeat=len(rows)):
                forces = self.solved(rows, states)
                fits = forces is not None and self.excess(forces) <= LOOSE
                if fits and all(self.apart(forces, other) for other in found):
                    found.append(forces)
        return found

    def solved(self, rows, states):
        """The forces for given states of the rows; None unless there is exactly one solution."""
        m = self.m
        sticks = rows[[state == "stick" for state in states]]
        unknown = np.append(rows, m + sticks)
        # t = along n + given for the rows that slip
        along = np.zeros((2 * m, 2 * m))
        given = np.zeros(2 * m)
        for row, state in zip(rows, states, strict=True):
            if state in (1, -1):
                along[m + row, row] = state * self.mu
            elif state in (2, -2):
                given[m + row] = np.sign(state) * self.limit[row]
        spread = (np.eye(2 * m) + along)[:, unknown]
        left = self.gaps + self.S @ given
        try:
            x = np.linalg.solve(self.S[unknown] @ spread, -left[unknown])
        except np.linalg.LinAlgError:
            return None
        forces = spread @ x + given
        pulls = forces[:m].min() < -LOOSE * np.abs(forces).max(initial=0)
        return None if pulls else forces

    def apart(self, one, two):
        """Whether two equilibria differ."""
        change = one - two
        size = np.maximum(np.abs(one), np.abs(two))
        return change @ self.S @ change > DIFFERENT**2 * (self.S.diagonal() @ size**2)


def judged(problem):
    """What is wrong with the solvers' results, and the number of equilibria."""
    body = Block(problem)
    convex = np.isinf(body.mu)
    found = [] if convex else body.equilibria()
    wrong = []
    cold = semismooth_newton(problem)
    starts = {"cold": cold}
    if not convex:
        law = replace(problem.friction, coefficient=2 * problem.friction.coefficient)
        near = semismooth_newton(replace(problem, friction=law))
        if near.status.is_success:
            starts["from twice the coefficient"] = semismooth_newton(
                problem, start=near
            )
    for name, result in starts.items():
        forces = forces_of(body, result)
        if result.status.is_success and body.excess(forces) > 1e-7:
            wrong.append(f"{name}: {body.excess(forces):.2g} off an equilibrium")
        expected = {0: None, 1: Status.CONVERGED}.get(len(found), Status.NOT_UNIQUE)
        expected = Status.CONVERGED if convex else expected
        if expected is None:
            if result.status.is_success:
                wrong.append(f"{name}: {result.status.label} without an equilibrium")
        elif result.status is not expected:
            wrong.append(f"{name}: {result.status.label}, {len(found)} equilibria")
    return wrong, len(found)


def forces_of(body, result):
    """The forces of a result in the order of ``Block``: its tangents are (-1, 0)."""
    rows = result.rows
    order = np.argsort(rows.nodes)
    t = result.nodal_friction_forces[order, 0] * rows.tangents[order, 0, 0]
    return np.append(result.nodal_contact_forces[order], t)


@dataclass(eq=False)
class Equilibria(Work):
    """The study: ``count`` random blocks with Coulomb's law, and as many with each other law.

    Parameters
    ----------
    count, seed, rows
        How many problems of each law, where their seeds begin, and the laws.
    """

    count: int = 500
    seed: int = 1
    rows: tuple[str, ...] = LAWS

    name, title = "equilibria", "Friction on few rows compared with enumeration"
    columns = """law = {law} | problems = {problems} | none = {none} | one = {one}
        | several = {several} | most = {most} | failures = {failures}"""

    def cells(self):
        """The problems by law and seed."""
        seeds = range(self.seed, self.seed + self.count)
        return [{"law": law, "number": n} for law in self.rows for n in seeds]

    def solve(self, law, number):
        """The verdict on one problem."""
        try:
            wrong, count = judged(random_problem(number, law))
        except Exception as error:  # any exception is a failure
            wrong, count = [f"{type(error).__name__}: {error}"], 0
        return {"equilibria": count, "wrong": wrong}

    def line(self, record):
        """One line about a problem."""
        said = "; ".join(record["wrong"])
        return f"{record['law']} {record['number']}: {record['equilibria']}  {said}"

    def table_rows(self, records):
        """A row for each law."""
        found = []
        for law in self.rows:
            mine = [r for r in records if r["law"] == law]
            counts = np.array([r["equilibria"] for r in mine])
            by_number = (
                law != "Tresca"
            )  # convex: one, which the conditions alone identify
            found.append(
                {
                    "law": law,
                    "problems": len(mine),
                    "none": int((counts == 0).sum()) if by_number else 0,
                    "one": int((counts == 1).sum()) if by_number else len(mine),
                    "several": int((counts > 1).sum()) if by_number else 0,
                    "most": int(counts.max(initial=0)) if by_number else 1,
                    "failures": sum(bool(r["wrong"]) for r in mine),
                }
            )
        return found

    def notes(self, records):
        """What was drawn, and the failures."""
        wrong = [r for r in records if r["wrong"]]
        return [
            "Random elastic blocks with 3 to 8 rows (5 with a limit), Poisson's ratios up to "
            "0.499, coefficients from 0.2 to 10. A separate program tries every contact state. A "
            "failure is a status that does not agree with the number of equilibria (cold start, or "
            "start from the solution with twice the coefficient), or forces that are no "
            "equilibrium.",
            *[f"- {r['law']} {r['number']}: {'; '.join(r['wrong'])}" for r in wrong],
        ]
