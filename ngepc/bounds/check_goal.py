"""Check a receipt of a goal: a force or a displacement lies in an interval.  numpy alone.

    python check_goal.py receipt.npz

The file has all of a receipt of the energy, which ``check_receipt`` checks (paragraphs 1 to 5 and
the symbols are there), and an adjoint pair.

6. A goal is Q = int F . u + int G . u + int c P - int t . V of the solution (u, P, t).  Let z = V
   where the body is held, T a stress in equilibrium with F, G and -q n on the obstacle, L > 0 with
   |q| <= L P, |c - z . n| <= L (psi - u . n), and s = 2 mu (e - p_0) - a.  Then
     Q <= int [F . u + G . u + f . z + g . z - B tr eps(u) tr eps(z) - a : eps(z)]
          + int (m_T - B tr eps(z) + L (m - B tr eps(u)))^2/(4 L B) + int [X(p, w) - p : s]
          + int (q + L P)(psi - u . n) + (b_T + L b) (2 G)^(1/2),
     p = (d_T + L (d - a))/(2 mu),  w = L s/(2 mu) - dev eps(z),  k = L/(2 mu),
     X = sup over t of  p : t + w : N - k t : N,  N = the radial return of t; X is convex.
   Proof: for the solution (v, Y) add  (T, eps(v - u)) = goal's load on v - u,  (Y, eps(z)) = load
   on z,  and subtract  L (Y - S, eps(v - u)).  -Q has the same bound with -z, -T, -q, -c.
7. With y = p + w, v = M p + h w, M = 2 mu + h:  where |t| <= beta, X is the sup of y : t - k |t|^2,
   beta |y| - k beta^2 + ([2 k beta - |y|]_+)^2/(4 k) <= |y|^2/(4 k).  Beyond, t and N have sizes
   beta + M g, beta + h g with a plastic strain g > 0 and the direction of beta y + g v:
     X = sup of F(g) = |beta y + g v| - K(g),  K = k (beta + M g)(beta + h g),
   and |beta y + g v| <= beta |y| + g |v| gives a first bound.  Where K flows another is better:
   take any number r > 0 and a direction; y_n, v_n are parts along it, no less than Y, V > 0, and
   y', v' parts across.  With e = beta y' + r v', D = beta Y + r V, x = g - r
     |beta y + g v| <= beta y_n + g v_n + |e + x v'|^2/(2 (D + x V)).
   For g >= c r, D' = beta Y + c r V:  1/(D + x V) <= 1/D + [-x]_+ V/(D D'), and the last term is at
   most  |e|^2/(2 D) + x e : v'/D + |x| V |e|^2/(2 D D') + x^2 (|v'|^2/(2 D') + V |e| |v'|/(D D')).
   This is a parabola in x, whose largest value is in the code.  For g < c r
     F(g) <= (1 - g/r) F(0) + (g/r) F(r) + k M h g (r - g) <= F(r) + [c k M h r^2 + F(0) - F(r)]_+,
   as norms are convex, and F(r) - F(0) >= r V - beta ((Y^2 + |y'|^2)^(1/2) - Y) - K(r) + K(0).
"""

import json
import sys
from collections.abc import Callable, Mapping

import numpy as np
from numpy import einsum, ndarray

try:
    from ngepc.bounds import check_receipt as energy
except ImportError:  # the two files alone, in one folder
    import check_receipt as energy

Body = energy.Body
inner = energy.inner
size = energy.size
TABLE = (  # z, T, q, F, G, V, c of 6
    "z f8 NU, tau f8 kcvK, tau_passed f8 S, goal_force f8 NK, goal_pressure f8 tB, "
    "goal_traction f8 tNB, goal_motion f8 tNB, goal_contact f8 B"
)
PART = 0.25  # c of 7
WIDE = 10000  # products of conditions of what numbers of 7 are divided by


def parted(N: int, law: ndarray) -> ndarray:
    """Numbers for the parts of simplices; the last one is the volume."""
    law = np.tile(law, 2**N)
    law[-1] /= 2**N
    return law


def above(r: Body, density: Callable, x: ndarray, law: ndarray) -> ndarray:
    """Integrals of a function from above; the file says which simplices are cut."""
    found = []
    while x.shape[2]:
        on = r.cut[: x.shape[2]]
        energy.need(on.shape == (x.shape[2],), "cut: too short")
        r.cut = r.cut[x.shape[2] :]
        uncut = np.flatnonzero(~on)
        on = np.flatnonzero(on)
        here = law.take(uncut, axis=1)
        found.append(here[-1] * density(r.N, x.take(uncut, axis=2), here))
        x = energy.subdivided(r.N, x.take(on, axis=2))
        law = parted(r.N, law.take(on, axis=1))
    return np.concatenate(found)


def on_parts(r: Body, c: ndarray) -> ndarray:
    """Fields on K (1 or N + 1, c, K) as fields (k, c, parts of K)."""
    if len(c) == 1:
        return np.tile(c, (r.k, 1, r.v))
    parts = np.tile(c[:, :, None], (1, 1, r.v, 1))
    own = np.arange(r.v)
    parts[own, :, own] = c.mean(axis=0)
    c = parts.reshape(*c.shape[:2], -1)
    middle = (c[[1, 0, 0]] + c[[2, 2, 1]]) / 2 if len(c) < r.k else c[:0]
    return np.concatenate([c, middle])


def along(x: ndarray, direction: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Fields along a direction on each K (k, 1, K), across it, and the least along it."""
    y = einsum("kcK,cK->kK", x, direction)[:, None]
    return y, x - y * direction, y[:, 0].min(axis=0)


def supremum(N: int, x: ndarray, law: ndarray) -> ndarray:
    """Means of X(p, w) from above by 7, for coefficients x = (p, w) and rows k, M, h, beta."""
    p, w = np.split(x, 2, axis=1)
    k, M, h, beta = law[:4]
    y = p + w
    v = M * p + h * w
    bend = k * M * h
    loss = k * beta * (M + h)
    far = np.sqrt(einsum("kcK,kcK->kK", y, y))
    steep = np.sqrt(einsum("kcK,kcK->kK", v, v))
    missing = np.maximum(2 * k * beta - far, 0.0) ** 2 / (4 * k)
    rough = (beta * (far - k * beta) + missing).mean(axis=0)
    rough = np.minimum(rough, inner(y, y, N) / (4 * k))
    rough += (np.maximum(steep - loss, 0.0) ** 2).mean(axis=0) / (4 * bend)
    on = np.flatnonzero(((steep > loss) | (far > 2 * k * beta)).any(axis=0))
    near = np.array([beta, M, h, k, bend, loss, missing.max(axis=0)]).take(on, axis=1)
    fine = along_one(N, y.take(on, axis=2), v.take(on, axis=2), near)
    rough[on] = np.minimum(rough[on], fine)
    return rough


def along_one(N: int, y: ndarray, v: ndarray, law: ndarray) -> ndarray:
    """The second bound of 7, with one g and one direction on each K; infinite if it fails."""
    beta, M, h, k, bend, loss, missing = law
    far = size(y)
    steep = size(v)
    at = v.mean(axis=0)
    g = np.maximum(np.sqrt((at**2).sum(axis=0)) - loss, 0.0) / (2 * bend)
    n = beta * y.mean(axis=0) + g * at
    n /= np.maximum(np.sqrt((n**2).sum(axis=0)), 1e-300)
    y_n, y_across, Y = along(y, n)
    v_n, v_across, V = along(v, n)
    g = np.maximum(v_n.mean(axis=(0, 1)) - loss, 0.0) / (2 * bend)
    clear = (far < 4 * Y) & (steep < 4 * V)
    Y = np.where(clear, Y, 1.0)
    V = np.where(clear, V, 1.0)
    lost = beta * (np.sqrt(Y**2 + size(y_across) ** 2) - Y)
    lost = np.maximum(lost - g * (V - loss - (1 + PART) * bend * g), 0.0)
    D = beta * Y + g * V
    least = beta * Y + PART * g * V
    e = beta * y_across + g * v_across
    off = size(e)
    turn = size(v_across)
    b = bend - turn**2 / (2 * least) - V * off * turn / (D * least)
    clear &= b > bend / 4
    c = v_across.mean(axis=0)
    X = v_n + einsum("kcK,cK->kK", e, c)[:, None] / D - loss - 2 * bend * g
    Z = off * size(v_across - c) / D + V * off**2 / (2 * D * least)
    rest = (np.sqrt(inner(X, X, N)) + Z) ** 2 / (4 * np.where(clear, b, 1.0))
    flat = k * (beta + M * g) * (beta + h * g)
    fine = (beta * y_n + g * v_n).mean(axis=(0, 1)) - flat + inner(e, e, N) / (2 * D)
    return np.where(clear, fine + rest + missing + lost, np.inf)


def check_adjoint(r: Body, factor: float) -> None:
    """The conditions of 6."""
    need = energy.need
    usual = energy.SMALLEST < factor < 1 / energy.SMALLEST
    need(usual, "factor: not positive, too large or too small")
    small = np.abs(r.goal_pressure) <= (1 - energy.EPS) * factor * r.pressure
    need(small.all(), "goal_pressure: larger than the factor times the pressure")
    most = factor * (1 - energy.EPS) * r.room
    for sign in (-1.0, 1.0):
        spare = energy.room(r, sign * r.z, sign * r.goal_motion, sign * r.goal_contact)
        energy.need_positive(r, most + spare, "z: wrong at the obstacle")


def interval(r: Body, factor: float, above: Callable) -> tuple[float, float]:
    """6: what a goal lies between."""
    N = r.N
    q = r.goal_pressure
    rest = energy.balance(r, r.tau, r.goal_force, r.goal_traction, q)
    doubt = (energy.defect(r, rest, r.tau_passed) + factor * r.b) * r.root
    trace, e, strain, missed = energy.strains(r, r.z)
    m, d = energy.split(r, r.tau.reshape(r.k, r.c, -1))
    done = energy.work(r, r.goal_force, r.goal_traction, r.u)
    gained = energy.work(r, r.body_force, r.traction, r.z)
    own = r.bulk * inner(r.trace, trace, N) + (r.back * e.mean(axis=0)).sum(axis=0)
    room = r.room[:, None]
    opened = inner(q[:, None], room, N - 1) * r.outer
    centre = np.concatenate([done[0], gained[0], -r.volume * own, opened])
    opening = inner(factor * r.pressure[:, None], room, N - 1) * r.outer
    large = factor * r.large + r.stiff * (strain + factor * r.strain)
    large += 3 * rest.size
    wrong = r.wrong * large + r.stiff * (missed + factor * r.missed)
    slack = WIDE * r.volume * r.soft / factor * large * wrong
    near = 10 * r.near * (np.abs(opening) + r.outer * size(q[:, None]) * size(room))
    always = [opening, slack, near, done[1], gained[1], [doubt]]

    trial, e, trace, own_trace = (on_parts(r, c) for c in (r.trial, e, trace, r.trace))
    law = [
        factor / (2 * r.mu),
        2 * r.mu + r.hardening,
        r.hardening,
        r.beta,
        r.volume / r.v,
    ]
    law = np.tile(law, r.v)
    mu = np.tile(r.mu, r.v)
    bulk = np.tile(r.bulk, r.v)
    ends = []
    for sign in (-1.0, 1.0):
        mean = sign * (m - bulk * trace) + factor * (r.m - bulk * own_trace)
        p = (sign * d + factor * r.shifted) / (2 * mu)
        w = factor / (2 * mu) * trial - sign * e
        inside = inner(mean, mean, N) / (4 * factor * bulk) - inner(p, trial, N)
        highest = above(r, supremum, np.concatenate([p, w], axis=1), law)
        parts = sign * centre, *always, law[-1] * inside, highest
        ends.append(sign * energy.summed(*parts))
    return tuple(ends)


def opened_goal(file: Mapping[str, ndarray], header: dict) -> Body:
    """The arrays of a receipt, and what follows from them."""
    r = energy.opened(file, header)
    if "goal" in header:
        vars(r).update(energy.unpacked(file["goal"], TABLE, vars(r)))
        r.cut = file["cut"]
        energy.need(r.cut.dtype == bool, "cut: of a wrong type")
    return r


def proved_intervals(r: Body, header: dict, above: Callable = above) -> dict:
    """What a receipt proves; ValueError where it is not admissible."""
    proved = dict(zip(("lower", "upper"), energy.energies(r), strict=True))
    if "goal" in header:
        factor = float(header["factor"])
        check_adjoint(r, factor)
        ends = interval(r, factor, above)
        proved["goal lower"], proved["goal upper"] = ends
    return proved


def check_goal(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        proved = proved_intervals(opened_goal(file, header), header)
    for name, value in proved.items():
        right = header[name] <= value if "lower" in name else value <= header[name]
        energy.need(right, f"{name}: {header[name]} claimed, {value} proved")
    text = f"least energy in ({header['lower']}, {header['upper']})"
    if "goal" not in header:
        return text
    name = header["goal"]
    energy.need(type(name) is str and name.isprintable(), "goal: no name")
    return f"{text}, {name} in ({header['goal lower']}, {header['goal upper']})"


def check_files(paths: list[str]) -> int:
    """Check files; the status is 0 if all of them show what they claim."""
    status = 0
    for path in paths:
        try:
            text = f"PASS: {check_goal(path)}"
        except Exception as error:  # whatever is wrong with a file, it does not pass
            known = isinstance(error, ValueError)
            text = f"FAIL: {error if known else repr(error)}"
            status = 1
        sys.stdout.write(f"{path}: {text}\n")
    return status


if __name__ == "__main__":
    sys.exit(check_files(sys.argv[1:]))
