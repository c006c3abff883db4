"""Random convex problems by the exact method and by conic programming, which shares no code."""

from dataclasses import dataclass, replace

import numpy as np
from conic import FULL, minimum
from netgen.meshing import (
    Element1D,
    Element2D,
    Element3D,
    FaceDescriptor,
    MeshPoint,
    Pnt,
)
from netgen.meshing import Mesh as RawMesh
from ngsolve import BND, CF, VOL, Mesh, x

from ngepc import (
    Contact,
    Hill,
    Material,
    Overlay,
    Problem,
    Status,
    Tabulated,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.studies.work import Work

AGREE = 1e-8  # of J


def two_blocks(cells, size, gap):
    """A block above another one; their nodes on the common face match but are not shared."""
    N = len(cells)
    raw = RawMesh(dim=N)
    names = {"contact": ("below", "top"), "clamped": ("bottom", "above")}
    count = 0
    for body in range(2):
        one = block.structured_mesh(*cells, size=size, simplices=True)
        shift = np.zeros(3)
        shift[N - 1] = body * (size[-1] + gap)
        points = [
            raw.Add(
                MeshPoint(Pnt(*(np.append(v.point, [0.0] * (3 - N)) + shift).tolist()))
            )
            for v in one.vertices
        ]
        domain = body + 1
        if N == 2:
            raw.Add(FaceDescriptor(surfnr=domain, domin=domain, bc=domain))
        kind = Element2D if N == 2 else Element3D
        for element in one.Elements(VOL):
            raw.Add(kind(domain, [points[v.nr] for v in element.vertices]))
        known = {}
        for facet in one.Elements(BND):
            name = names.get(facet.mat, (f"side {facet.mat}",) * 2)[body]
            corners = [points[v.nr] for v in facet.vertices]
            if name not in known:
                count += 1
                known[name] = count
                if N == 3:
                    raw.Add(FaceDescriptor(surfnr=count, domin=domain, bc=count))
                raw.SetBCName(count - 1, name)
            if N == 2:
                raw.Add(Element1D(corners, index=known[name]))
            else:
                raw.Add(Element2D(known[name], corners))
    return Mesh(raw)


def random_material(random, yield_stress):
    """A random material: kinematic, isotropic or combined hardening, or a table."""
    mu = 1e3 * random.uniform(0.5, 2)
    elastic = {"lame_lambda": mu * random.choice([0.0, 1.0, 5.0, 50.0]), "lame_mu": mu}
    stiff = mu * 10 ** random.uniform(-2.5, 0)
    kind = random.integers(4)
    if kind == 0:
        return Material.kinematic(**elastic, yield_stress=yield_stress, hardening=stiff)
    if kind == 3:
        x_1 = random.uniform(5e-4, 2e-3)
        table = Tabulated(
            [0, x_1, 4 * x_1], yield_stress * np.array([1, 1.2, 1.4]) / np.sqrt(2 / 3)
        )
        return Material.with_law(**elastic, law=table, hardening=stiff)
    H = 2.0
    k = stiff / (H * yield_stress) ** 2
    if kind == 1:
        return Material.isotropic(
            **elastic,
            yield_stress=yield_stress,
            hardening_modulus=H,
            hardening_stiffness=k,
        )
    return Material(
        **elastic,
        yield_stress=yield_stress,
        hardening=stiff / 2,
        hardening_modulus=H,
        hardening_stiffness=k / 2,
    )


def with_sub_elements(problem, seed):
    """The problem with two or three sub-elements that yield one after the other."""
    random = np.random.default_rng([seed, 2])
    given = problem.material
    count = int(random.integers(2, 4))
    overlay = Overlay(
        random.uniform(0.2, 0.3, count).tolist(),
        (given.yield_stress * np.cumsum(random.uniform(0.5, 1.5, count))).tolist(),
    )
    material = Material(
        lame_lambda=given.lame_lambda,
        lame_mu=given.lame_mu,
        yield_stress=overlay.bounds[0],
        overlay=overlay,
    )
    return replace(problem, material=material)


def with_axes(problem, seed):
    """The problem with Hill's ellipsoid in place of the sphere, its axes turned."""
    random = np.random.default_rng([seed, 3])
    hill = Hill.r_values(
        *random.uniform(0.5, 2.5, 3).tolist(), angle=float(random.uniform(0, np.pi))
    )
    return replace(problem, material=replace(problem.material, hill=hill))


def with_another_law(problem, seed):
    """Sub-elements, Hill's ellipsoid or plane stress in place of what the problem has."""
    if problem.kinematics.size < 3:
        return problem
    if seed % 5 == 4:
        problem = with_sub_elements(problem, seed)
    if seed % 5 in (1, 3):
        problem = with_axes(problem, seed)
    thin = problem.N == 2 and (seed % 5 in (2, 3) or seed % 10 == 9)
    return replace(problem, kinematics="plane stress") if thin else problem


def random_problem(seed):
    """Plane or solid, both orders, with or without contact, friction, history, a second body."""
    random = np.random.default_rng(seed)
    N = 2 if random.random() < 0.7 else 3
    order = int(random.integers(1, 3))
    kind = ("none", "obstacle", "obstacle", "bodies")[random.integers(4)]
    most = {(2, 1): 6, (2, 2): 4, (3, 1): 3, (3, 2): 2}[N, order]
    cells = [int(k) for k in random.integers(1, most + 1, N)]
    size = random.uniform(0.5, 2.0, N).tolist()
    gap = float(random.uniform(-2e-3, 2e-3))
    down = (0.0,) * (N - 1)
    data = {}
    if kind == "bodies":
        mesh = two_blocks(cells, size, max(gap, 0.0))
        data["contact"] = Contact("above", "below")
        data["clamped"] = "bottom"
        data["prescribed"] = {"top": (*down, -float(random.uniform(1e-3, 6e-3)))}
        data["prescribed"]["top"] = (2e-4, *data["prescribed"]["top"][1:])
        loaded = "side right"
    else:
        mesh = block.structured_mesh(*cells, size=size, simplices=True)
        loaded = "right"
        if kind == "obstacle":
            data["contact"] = "contact"
            data["gap"] = gap + float(random.uniform(-2e-3, 2e-3)) * x
    plane = ("plane strain", "two-dimensional")[random.integers(2)]
    if N == 2:
        data["kinematics"] = plane
    if kind != "none" and random.random() < 0.5:
        data["friction"] = float(10 ** random.uniform(-2, 0.3))
    size_of_tensor = 2 if data.get("kinematics") == "two-dimensional" else 3
    if random.random() < 0.4:
        p = random.uniform(-1, 1, (size_of_tensor, size_of_tensor)) * 3e-4
        p = p + p.T
        if N == 2 and size_of_tensor == 3:
            p[2, :2] = p[:2, 2] = 0.0
        p -= np.trace(p) / size_of_tensor * np.eye(size_of_tensor)
        data["initial_plastic_strain"] = CF(tuple(p.ravel().tolist()), dims=p.shape)
    problem = Problem(
        mesh,
        random_material(random, float(random.uniform(0.8, 1.5))),
        traction={loaded: tuple(random.uniform(-2, 2, N).tolist())},
        body_force=tuple(random.uniform(-1, 1, N).tolist()),
        order=order,
        **data,
    )
    return with_another_law(problem, seed)


def law_of(problem):
    """The law of a problem in a word, for the table."""
    material = problem.material
    surface = "sub-elements" if material.overlay is not None else "von Mises"
    surface = "Hill" if material.hill is not None else surface
    return f"{surface}, plane stress" if problem.kinematics.thin else surface


@dataclass(eq=False)
class Cones(Work):
    """The study: ``count`` random problems, judged by J.

    Parameters
    ----------
    count, seed
        How many problems, and where their seeds begin.
    """

    count: int = 300
    seed: int = 1

    name, title = "cones", "The exact method compared with conic programming"
    columns = """problems = {group} | all = {all} | full accuracy = {full}
        | largest difference of J = {largest:.1e} | failures = {failures}"""

    def cells(self):
        """The seeds."""
        return [{"number": n} for n in range(self.seed, self.seed + self.count)]

    def solve(self, number):
        """Both energies of one problem."""
        problem = random_problem(number)
        result = semismooth_newton(problem)
        found = minimum(problem)
        difference = abs(result.primal_energy - found.energy) / abs(found.energy)
        full = found.status == FULL
        wrong = result.status is not Status.CONVERGED or (full and difference > AGREE)
        bodies = "two bodies" if problem.contact_pairs else "obstacle"
        contact = bodies if problem.contact is not None else "no contact"
        rough = ", Tresca" if problem.friction is not None else ""
        return {
            "group": f"{problem.N}D, order {problem.order}, {contact}{rough}",
            "law": law_of(problem),
            "status": result.status.label,
            "conic": found.status,
            "yields": float(result.state.at.yields.mean()),
            "difference": difference,
            "wrong": bool(wrong),
        }

    def line(self, record):
        """One line about a problem."""
        said = "DIFFERS" if record["wrong"] else ""
        return (
            f"{record['number']}: {record['group']}, {record['law']}, {record['status']}, "
            f"{record['conic']}, {record['difference']:.1e} {said}"
        )

    def table_rows(self, records):
        """A row for each kind of problem, for each law, and one for all."""
        groups = sorted({r["group"] for r in records})
        laws = sorted({r["law"] for r in records})
        rows = [self._row(g, [r for r in records if r["group"] == g]) for g in groups]
        rows += [self._row(k, [r for r in records if r["law"] == k]) for k in laws]
        return [*rows, self._row("all", records)]

    def _row(self, name, records):
        full = [r["difference"] for r in records if r["conic"] == FULL]
        return {
            "group": name,
            "all": len(records),
            "full": len(full),
            "largest": max(full, default=0.0),
            "failures": sum(r["wrong"] for r in records),
        }

    def notes(self, records):
        """Lines about the comparison, and the failures."""
        wrong = [str(r["number"]) for r in records if r["wrong"]]
        return [
            "Random problems of `tests/campaigns/cones.py`; `tests/conic.py` assembles each from "
            "mesh and data alone and Clarabel minimises J. Failures: runs that do not converge, "
            f"and energies that differ by more than {AGREE:g} where Clarabel reports full "
            "accuracy. Differences are relative.",
            *([f"- seeds {', '.join(wrong)}"] if wrong else []),
        ]
