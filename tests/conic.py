"""Elasto-plastic contact as one conic program, assembled from mesh and data alone.

A second program to believe the first one by: shapes, strains, loads, contact rows and the law are
written down here again, from the formulas, and Clarabel's interior point method minimises

    J(u, p) = sum w (bulk/2 tr(eps)^2 + mu |dev eps - p_0 - p|^2 - mu |p_0|^2 + dev alpha : p
              + h/2 |p|^2 + cost of |p|) - loads . u + sum F w |slip|

or, with sub-elements, the sum of shares of that with a plastic strain and a bound each, or with
Hill's (p . A^-1 p)^(1/2) in place of |p| in the cost,

over u with supports and rows n . u <= gap, in plane stress also over eps_zz at each point.
Straight triangles and tetrahedra, both orders, constant loads and materials, gaps that are affine
on facets, flat contact boundaries, two bodies whose meshes match where they touch.
"""

from dataclasses import dataclass
from itertools import combinations

import clarabel
import numpy as np
from ngsolve import BND, ET, VOL
from scipy.sparse import coo_matrix, csc_matrix, diags, identity, kron, triu, vstack

from ngepc.model.elements import plastic_points

FULL = "Solved"  # Clarabel's word for full accuracy
R6 = np.sqrt(6.0)
R2 = np.sqrt(2.0)


@dataclass(frozen=True)
class Minimum:
    """What the interior point method found: J, displacements of the nodes, and its word."""

    energy: float
    u: np.ndarray
    status: str


def deviator(N, size):
    """(i, j, k, factor): coordinate k of dev eps is the sum of factor times eps_ij."""
    if N == 3:
        diagonal = [(0, 0, 0, 1 / R2), (1, 1, 0, -1 / R2)]
        diagonal += [(0, 0, 1, 1 / R6), (1, 1, 1, 1 / R6), (2, 2, 1, -2 / R6)]
        pairs = enumerate(combinations(range(3), 2), start=2)
        return diagonal + [(i, j, k, R2) for k, (i, j) in pairs], 5
    plane = [(0, 0, 0, 1 / R2), (1, 1, 0, -1 / R2), (0, 1, 1, R2)]
    if size == 2:
        return plane, 2
    return [*plane, (0, 0, 2, 1 / R6), (1, 1, 2, 1 / R6)], 3


def coordinates(tensor, N, size):
    """The same coordinates of a symmetric trace-free tensor, shape (d,)."""
    entries, d = deviator(N, size)
    found = np.zeros(d)
    for i, j, k, factor in entries:
        found[k] += factor * tensor[i, j]
    if N == 2 and size == 3:
        found[2] -= 2 / R6 * tensor[2, 2]
    return found


def tensors(N):
    """The symmetric tensors of the coordinates with three axes, orthonormal, shape (d, 3, 3)."""
    entries, d = deviator(N, 3)
    found = np.zeros((d, 3, 3))
    for i, j, k, factor in entries:
        found[k, i, j] += factor / 2
        found[k, j, i] += factor / 2
    if N == 2:
        found[2, 2, 2] = -2 / R6
    return found


def hill_square(hill, s):
    """2/3 S^2 of a stress by Hill's formula in the axes of the material."""
    cosine = np.cos(hill.angle)
    sine = np.sin(hill.angle)
    axes = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    (s11, s12, s13), (_, s22, s23), (_, _, s33) = axes.T @ s @ axes
    square = hill.F * (s22 - s33) ** 2
    square += hill.G * (s33 - s11) ** 2
    square += hill.H * (s11 - s22) ** 2
    square += 2 * hill.L * s23**2 + 2 * hill.M * s13**2 + 2 * hill.N * s12**2
    return 2 / 3 * square


def hill_form(hill, N):
    """A of s . A s = 2/3 S^2 on coordinates, by polarisation."""
    own = tensors(N)
    d = len(own)
    form = np.zeros((d, d))
    for i, j in np.ndindex(d, d):
        more = hill_square(hill, own[i] + own[j])
        less = hill_square(hill, own[i] - own[j])
        form[i, j] = (more - less) / 4
    return form


class Nodes:
    """Vertices, for order two the middles of the edges as well, of cells and facets."""

    def __init__(self, mesh, order):
        self.mesh = mesh
        self.order = order
        self.N = mesh.dim
        self.x = np.array([v.point for v in mesh.vertices])
        self.cells = np.array([[v.nr for v in e.vertices] for e in mesh.Elements(VOL)])
        self.middle = {}
        if order == 2:
            for cell in self.cells.tolist():
                for pair in combinations(sorted(cell), 2):
                    self.middle.setdefault(pair, len(self.x) + len(self.middle))
            ends = np.array([*self.middle])
            self.x = np.vstack([self.x, self.x[ends].mean(axis=1)])
        self.of_cells = np.array([self.of(cell) for cell in self.cells.tolist()])

    def of(self, corners):
        """The nodes of a simplex: its corners, then the middles of their pairs."""
        if self.order == 1:
            return list(corners)
        pairs = combinations(corners, 2)
        return [*corners, *(self.middle[tuple(sorted(pair))] for pair in pairs)]

    def facets(self, name):
        """The corners of the facets of boundaries 'a|b', (facets, N)."""
        region = self.mesh.Boundaries(name)
        return [[v.nr for v in e.vertices] for e in region.Elements()]

    def slopes(self, lam):
        """Derivatives of the shape functions by barycentric coordinates, (nodes, N + 1)."""
        one = np.eye(len(lam))
        if self.order == 1:
            return one
        corners = [(4 * lam[i] - 1) * one[i] for i in range(len(lam))]
        pairs = combinations(range(len(lam)), 2)
        return np.array(
            [*corners, *(4 * (lam[i] * one[j] + lam[j] * one[i]) for i, j in pairs)]
        )

    def means(self, k):
        """Means of the shape functions over a simplex with k corners, (nodes,)."""
        if self.order == 1:
            return np.full(k, 1 / k)
        dim = k - 1
        vertex = 2 * 2 / ((dim + 1) * (dim + 2)) - 1 / (dim + 1)
        pair = 4 / ((dim + 1) * (dim + 2))
        return np.append(np.full(k, vertex), np.full(k * (k - 1) // 2, pair))


def measures(x):
    """Length, area or volume of simplices with corners (n, k, N)."""
    sides = x[:, 1:] - x[:, :1]
    gram = np.einsum("nic,njc->nij", sides, sides)
    factorial = {1: 1, 2: 2, 3: 6}[sides.shape[1]]
    return np.sqrt(np.linalg.det(gram)) / factorial


class Program:
    """The conic program of a problem."""

    def __init__(self, problem):
        self.problem = problem
        self.nodes = Nodes(problem.mesh, problem.order)
        self.N = problem.N
        self.size = problem.kinematics.size
        self.unknowns = self.N * len(self.nodes.x)
        self.blocks = []  # (rows by all unknowns, right side, cone)
        self.columns = 0
        self.quadratic = []  # (matrix of the form by all unknowns)
        self.linear = []  # (first column, coefficients)

    def new(self, count):
        """The numbers of further unknowns."""
        first = self.columns
        self.columns += count
        return first + np.arange(count)

    def strains(self):
        """Matrices from u to tr eps and to the coordinates of dev eps at all points; weights."""
        nodes = self.nodes
        N = self.N
        shape = ET.TRIG if N == 2 else ET.TET
        rule = plastic_points(self.problem.mesh, nodes.order)[shape]
        x = nodes.x[nodes.cells]
        # barycentric coordinates: lam = inverse of (1; x) times (1; point)
        corners = np.concatenate([np.ones((*x.shape[:2], 1)), x], axis=2)
        by_x = np.linalg.inv(corners).swapaxes(1, 2)[:, :, 1:]
        volume = measures(x)
        entries, d = deviator(N, self.size)
        count = len(nodes.cells) * len(rule.points)
        trace = ([], [], [])
        shear = ([], [], [])
        weights = np.zeros(count)
        total = sum(rule.weights)
        for q, (point, weight) in enumerate(
            zip(rule.points, rule.weights, strict=True)
        ):
            point = np.array(point[:N])
            lam = np.append(point, 1 - point.sum())  # NGSolve's reference corners
            here = np.arange(len(nodes.cells)) * len(rule.points) + q
            weights[here] = volume * weight / total
            slopes = np.einsum("ab,nbc->nac", nodes.slopes(lam), by_x)
            for a in range(slopes.shape[1]):
                column = N * nodes.of_cells[:, a]
                for c in range(N):
                    add(trace, here, column + c, slopes[:, a, c])
                for i, j, k, factor in entries:
                    if i == j:
                        add(shear, d * here + k, column + i, factor * slopes[:, a, i])
                    else:
                        half = factor / 2
                        add(shear, d * here + k, column + i, half * slopes[:, a, j])
                        add(shear, d * here + k, column + j, half * slopes[:, a, i])
        n = self.unknowns
        return matrix(trace, (count, n)), matrix(shear, (d * count, n)), weights, d

    def loads(self):
        """Forces of constant body forces and tractions on u."""
        nodes = self.nodes
        force = np.zeros((len(nodes.x), self.N))
        if self.problem.body_force is not None:
            volume = measures(nodes.x[nodes.cells])
            share = nodes.means(self.N + 1)
            given = np.array(self.problem.body_force, dtype=float)
            spread = volume[:, None, None] * share[:, None] * given
            np.add.at(force, nodes.of_cells, spread)
        for name, given in (self.problem.traction or {}).items():
            facets = nodes.facets(name)
            area = measures(nodes.x[facets])
            share = nodes.means(self.N)
            at = np.array([nodes.of(f) for f in facets])
            spread = area[:, None, None] * share[:, None] * np.array(given, dtype=float)
            np.add.at(force, at, spread)
        return force.ravel()

    def supports(self):
        """Numbers of held components of u and their values."""
        held = {}
        given = dict(self.problem.prescribed or {})
        if self.problem.clamped:
            given[self.problem.clamped] = (0.0,) * self.N
        for name, values in given.items():
            for facet in self.nodes.facets(name):
                for node in self.nodes.of(facet):
                    for c, value in enumerate(values):
                        if value is not None:
                            held[self.N * node + c] = float(value)
        return np.array([*held], dtype=int), np.array([*held.values()])

    def rows(self, held):
        """Normal rows, gaps, weights, and tangential rows of each, as matrices on u."""
        pairs = self.problem.contact_pairs
        names = [pair.first for pair in pairs] or self.problem.contact_names
        twins = {}
        for pair in pairs:
            twins |= self.twins(pair)
        found = {}  # node -> [weight, its matrix row on scalar functions, normal]
        for name in names:
            for facet in self.nodes.facets(name):
                at = self.nodes.of(facet)
                area = float(measures(self.nodes.x[None, facet])[0])
                normal = self.outward(facet)
                share = area / len(at)  # Bernstein polynomials have one integral
                for node in at:
                    one = found.setdefault(node, [0.0, self.coefficient(node), normal])
                    one[0] += share
        gap = self.problem.gap
        rows = []
        for node, (weight, scalar, normal) in found.items():
            if twins:
                scalar = scalar | {twins[k]: -v for k, v in scalar.items()}
                value = self.apart(node, twins, normal)
            else:
                value = self.value(gap, node, scalar)
            entries = [
                (self.N * k + c, v) for k, v in scalar.items() for c in range(self.N)
            ]
            axis = int(np.abs(normal).argmax())
            free = [j for j, _ in entries if j % self.N == axis and j not in held]
            if free:
                rows.append((weight, scalar, normal, value))
        n = self.unknowns
        across = ([], [], [])
        along = ([], [], [])
        for r, (_, scalar, normal, _) in enumerate(rows):
            axis = int(np.abs(normal).argmax())
            others = [c for c in range(self.N) if c != axis]
            for k, v in scalar.items():
                add(across, [r], [self.N * k + axis], [v * normal[axis]])
                for t, c in enumerate(others):
                    add(along, [(self.N - 1) * r + t], [self.N * k + c], [v])
        gaps = np.array([value for *_, value in rows])
        weights = np.array([weight for weight, *_ in rows])
        m = len(rows)
        return (
            matrix(across, (m, n)),
            gaps,
            weights,
            matrix(along, ((self.N - 1) * m, n)),
        )

    def coefficient(self, node):
        """The Bernstein coefficient of a node: that of a middle is 2 u_m - (u_a + u_b)/2."""
        ends = next((e for e, k in self.nodes.middle.items() if k == node), None)
        if ends is None:
            return {node: 1.0}
        return {node: 2.0, ends[0]: -0.5, ends[1]: -0.5}

    def value(self, gap, node, scalar):
        """An affine gap at a node, whose Bernstein coefficients are its values."""
        place = self.nodes.x[node]
        if isinstance(gap, (int, float)):
            return float(gap)
        return float(gap(self.problem.mesh(*place, VOL_or_BND=BND)))

    def outward(self, facet):
        """The unit outer normal of a facet, along an axis."""
        cell = next(c for c in self.nodes.cells.tolist() if set(facet) <= set(c))
        inside = self.nodes.x[cell].mean(axis=0)
        x = self.nodes.x[facet]
        axis = int(np.ptp(x, axis=0).argmin())
        normal = np.zeros(self.N)
        normal[axis] = np.sign(x[0, axis] - inside[axis])
        return normal

    def twins(self, pair):
        """Node of the first boundary -> the node of the second one that faces it."""
        one, two = (
            sorted({k for f in self.nodes.facets(name) for k in self.nodes.of(f)})
            for name in (pair.first, pair.second)
        )
        facet = self.nodes.facets(pair.first)[0]
        axis = int(np.abs(self.outward(facet)).argmax())
        others = [c for c in range(self.N) if c != axis]
        far = self.nodes.x[two][:, others]
        found = {}
        for node in one:
            away = np.abs(far - self.nodes.x[node, others]).max(axis=1)
            assert away.min() < 1e-9
            found[node] = two[int(away.argmin())]
        return found

    def apart(self, node, twins, normal):
        """The gap between two flat bodies at a node."""
        return float((self.nodes.x[twins[node]] - self.nodes.x[node]) @ normal)

    def solved(self):
        """The minimum, by Clarabel to full accuracy if it can."""
        problem = self.problem
        material = problem.material
        N = self.N
        trace, shear, w, d = self.strains()
        points = len(w)
        mu = material.lame_mu
        bulk = material.lame_lambda + 2 * mu / self.size
        hill = material.hill
        h = material.effective_hardening if hill is None else material.hardening
        held, values = self.supports()
        across, gaps, rubbing, along = self.rows(set(held.tolist()))
        tresca = problem.friction is not None

        u = self.new(self.unknowns)
        overlay = material.overlay
        subs = [(1.0, None)]  # share of the elasticity, bound of its stress
        if overlay is not None:
            subs = list(zip(overlay.shares, overlay.bounds, strict=True))
        strains = [self.new(d * points) for _ in subs]
        p = strains[0]
        sizes = [self.new(points) for _ in subs]  # >= |p|
        g = sizes[0]
        slips = self.new(len(gaps) if tresca else 0)  # >= |slip|
        thin = problem.kinematics.thin
        free = self.new(points if thin else 0)  # eps_zz in plane stress
        law = material.law
        bends = list(law.plastic_strain) if law is not None else []
        parts = self.new(points * len(bends))  # of PEEQ, segment by segment
        n = self.columns

        each = np.repeat(w, d)
        to_u = select(u, n)
        to_p = select(p, n)
        volumes = trace @ to_u
        shears = shear @ to_u
        if thin:
            volumes = volumes + select(free, n)
            shears = shears + self.across(free, d, n)
        quadratic = volumes.T @ diags(w * bulk) @ volumes
        rests = [(1 - sum(s for s, _ in subs), shears)]
        for (share, _), columns in zip(subs, strains, strict=True):
            rests.append((share, shears - select(columns, n)))
        for share, rest in rests:
            quadratic += rest.T @ diags(share * 2 * mu * each) @ rest
        quadratic += to_p.T @ diags(h * each) @ to_p
        linear = np.zeros(n)
        linear[u] = -self.loads()
        before = np.zeros(d)
        if problem.initial_plastic_strain is not None:
            before = coordinates(tensor_of(problem, problem.p_0), N, self.size)
        for share, rest in rests:
            linear -= share * 2 * mu * rest.T @ (each * np.tile(before, points))
        _, back = problem.alpha_0
        if problem.initial_hardening is not None:
            given = coordinates(tensor_of(problem, back), N, self.size)
            linear[p] += each * np.tile(given, points)
        if law is None:
            linear[g] = w * float(problem.beta)
        if hill is not None:
            H = material.hardening_modulus * material.yield_stress
            grows = H**2 * material.hardening_stiffness  # of the bound with g
            quadratic += select(g, n).T @ diags(w * grows) @ select(g, n)
        if overlay is not None:
            for (share, bound), size in zip(subs, sizes, strict=True):
                linear[size] = w * share * bound
        if tresca:
            linear[slips] = rubbing * float(problem.friction)

        zero = [(select(u[held], n), values)]
        least = [(across @ to_u * -1, -gaps)]  # -n.u >= -gap
        for k, start in enumerate(bends):
            mine = parts[k * points : (k + 1) * points]
            rise = 0.0
            least.append((select(mine, n), np.zeros(points)))
            if k + 1 < len(bends):
                width = bends[k + 1] - start
                rise = (law.stress_there[k + 1] - law.stress_there[k]) / width
                least.append((-1 * select(mine, n), np.full(points, -width)))
            linear[mine] = w * law.stress_there[k]
            quadratic += select(mine, n).T @ diags(w * rise) @ select(mine, n)
        if bends:
            whole = sum(
                select(parts[k * points : (k + 1) * points], n)
                for k in range(len(bends))
            )
            zero.append((whole - np.sqrt(2 / 3) * select(g, n), np.zeros(points)))

        measure = identity(d * points, format="csr")
        if hill is not None:
            lower = np.linalg.cholesky(hill_form(hill, N))
            measure = kron(identity(points), np.linalg.inv(lower), format="csr")
        cones = [
            (self.stacked(size, measure @ select(columns, n), d, n), points, d + 1)
            for size, columns in zip(sizes, strains, strict=True)
        ]
        if tresca:
            slipped = along @ to_u
            cones.append((self.stacked(slips, slipped, N - 1, n), len(gaps), N))
        # tolerances are absolute for small numbers: a second time with J of the size of one
        scale = 1 / max(
            abs(solve(quadratic, linear, zero, least, cones).obj_val), 1e-300
        )
        found = solve(scale * quadratic, scale * linear, zero, least, cones)
        where = np.array(found.x)[u].reshape(-1, N)
        return Minimum(found.obj_val / scale, where, str(found.status))

    def across(self, free, d, n):
        """The coordinates of the deviator of eps_zz, from its unknowns at the points."""
        rows = d * np.arange(len(free)) + 2
        value = np.full(len(free), -2 / R6)
        return coo_matrix((value, (rows, free)), shape=(d * len(free), n)).tocsr()

    def stacked(self, tops, vectors, size, n):
        """Rows (top, vector) of each cone, one after the other."""
        count = len(tops)
        order = np.concatenate(
            [
                np.arange(count)[:, None],
                count + np.arange(count * size).reshape(count, size),
            ],
            axis=1,
        ).ravel()
        return vstack([select(tops, n), vectors], format="csr")[order]


def tensor_of(problem, value):
    """A constant tensor."""
    place = problem.mesh(
        *np.array([v.point for v in problem.mesh.vertices])[:1].mean(axis=0)
    )
    size = problem.kinematics.size
    return np.array(value(place)).reshape(size, size)


def add(entries, rows, columns, values):
    """Put numbers into a list of rows, columns and values."""
    for one, more in zip(entries, (rows, columns, values), strict=True):
        one.append(np.asarray(more))


def matrix(entries, shape):
    """A sparse matrix of such a list."""
    if not entries[0]:
        return csc_matrix(shape)
    rows, columns, values = (np.concatenate(part) for part in entries)
    return coo_matrix((values, (rows, columns)), shape=shape).tocsr()


def select(columns, n):
    """The matrix that picks some of n unknowns."""
    count = len(columns)
    ones = np.ones(count)
    return coo_matrix((ones, (np.arange(count), columns)), shape=(count, n)).tocsr()


def solve(quadratic, linear, zero, least, cones):
    """Minimise 1/2 x.Qx + c.x with Zx = z, Lx >= l and the cones."""
    Z = vstack([A for A, _ in zero])
    L = vstack([A for A, _ in least])
    A = vstack([Z, -L, *(-C for C, _, _ in cones)]).tocsc()
    right = np.concatenate(
        [
            *(b for _, b in zero),
            *(-b for _, b in least),
            *(np.zeros(C.shape[0]) for C, _, _ in cones),
        ]
    )
    kinds = [clarabel.ZeroConeT(Z.shape[0]), clarabel.NonnegativeConeT(L.shape[0])]
    for _, count, size in cones:
        kinds += [clarabel.SecondOrderConeT(size)] * count
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = 1e-9
    settings.tol_feas = 1e-10
    Q = triu(quadratic).tocsc()
    return clarabel.DefaultSolver(Q, linear, A, right, kinds, settings).solve()


def minimum(problem):
    """The minimum of J of a problem, by conic programming."""
    return Program(problem).solved()
