"""The upper bound by the exact method's idea, with h as a proximal parameter, beside Clarabel.

On velocities v that keep the volume and do unit power, the dissipation sum w_k |E_k v| has the dual
sum w_k s_k . E_k v over |s_k| <= 1.  One proximal step with the hardening h replaces s by the
radial return of s + E v / h, where v minimises the energy of a body that hardens by h and starts
from the stress s: this is problem (Y) of the exact method, and semismooth Newton steps solve it.  h
falls by a factor from one proximal step to the next.  The multiplier of the power is the lower end
of the bracket of the mesh: both methods stop at the same relative gap.
"""

import time
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bmat, csc_matrix, diags, vstack
from scipy.sparse.linalg import splu

from ngepc.limit.bisection import bisected_cells, fan_cells, singular_points
from ngepc.limit.bracket import bracket_on
from ngepc.limit.continuous import ContinuousVelocities
from ngepc.limit.reading import growing_names, limit_data
from ngepc.limit.yielding import FLAT
from ngepc.linalg.conic import ConicAccuracy, cone_solution
from ngepc.studies.limit_problems import LIMITS
from ngepc.studies.work import Work

GAP = 1e-3
"""Relative gap at which both methods stop."""

SHRINK = 0.25
"""Factor of h from one proximal step to the next."""

FIRST = 2.0
"""The first h; lengths and yield stresses are about one, and so is the power of the loads."""

MOST = 100
"""Largest number of Newton steps in all."""

INNER = 1e-1
"""Relative residual of a proximal step, over the gap."""

REGULAR = 1e-10


class Proximal:
    """Proximal steps for the program of the upper bound."""

    def __init__(self, flow):
        part = flow.parts[0]
        self.rows = csc_matrix(part.vectors.rows)
        self.weights = np.repeat(part.weights, part.size)
        self.size = part.size
        power = flow.power[0].rows
        self.equations = csc_matrix(vstack([flow.none.rows, power]))
        self.power = power.toarray()[0]
        self.steps = 0

    def returned(self, trial):
        """The radial return, and the sizes of the trial vectors."""
        vectors = trial.reshape(-1, self.size)
        sizes = np.linalg.norm(vectors, axis=1)
        part = 1 / np.maximum(sizes, 1.0)
        return (vectors * part[:, None]).ravel(), sizes

    def tangent(self, trial, sizes):
        """The derivative of the radial return, a block for each vector."""
        vectors = trial.reshape(-1, self.size)
        unit = vectors / np.maximum(sizes, 1e-300)[:, None]
        blocks = np.tile(np.eye(self.size), (len(sizes), 1, 1))
        flows = sizes > 1
        cut = blocks[flows] - unit[flows, :, None] * unit[flows, None, :]
        blocks[flows] = cut / sizes[flows, None, None]
        count = self.size
        rows = np.arange(len(trial)).reshape(-1, count)
        where = (
            np.repeat(rows, count, axis=1).ravel(),
            np.tile(rows, (1, count)).ravel(),
        )
        return csc_matrix((blocks.ravel(), where), shape=(len(trial), len(trial)))

    def value(self, v, s, h):
        """The energy of a proximal step."""
        trial = s + self.rows @ v / h
        sizes = np.linalg.norm(trial.reshape(-1, self.size), axis=1)
        beyond = np.maximum(sizes - 1, 0.0)
        inside = (sizes**2 - beyond**2) / 2
        return float(h * self.weights[:: self.size] @ inside)

    def step(self, v, s, h, precision):
        """The minimiser of one proximal step, its stress, and the multiplier of the power."""
        below = self.equations.shape[0]
        multiplier = 0.0
        while self.steps < MOST:
            trial = s + self.rows @ v / h
            stress, sizes = self.returned(trial)
            slope = self.rows.T @ (self.weights * stress)
            scaled = diags(self.weights / h) @ self.tangent(trial, sizes)
            hessian = self.rows.T @ scaled @ self.rows
            weak = REGULAR * diags(hessian.diagonal() + hessian.diagonal().max())
            matrix = bmat(
                [
                    [hessian + weak, self.equations.T],
                    [self.equations, -REGULAR * diags(np.ones(below))],
                ],
                format="csc",
            )
            missed = np.zeros(below)
            missed[-1] = 1.0
            missed -= self.equations @ v
            found = splu(matrix).solve(np.concatenate([-slope, missed]))
            self.steps += 1
            change = found[: len(v)]
            multiplier = -found[-1]
            part = 1.0
            decrease = float(slope @ change)
            start = self.value(v, s, h)
            feasible = np.abs(missed).max() < 1e-9
            if feasible:
                while part > 1e-4 and self.value(v + part * change, s, h) > (
                    start + 1e-4 * part * decrease
                ):
                    part /= 2
            v = v + part * change
            small = abs(decrease) < precision * abs(multiplier)
            if feasible and part == 1.0 and small:
                break
        return v, self.returned(s + self.rows @ v / h)[0], multiplier

    def solve(self):
        """Upper and lower end, and the proximal steps."""
        v = np.zeros(self.rows.shape[1])
        s = np.zeros(self.rows.shape[0])
        h = FIRST
        outer = 0
        while self.steps < MOST:
            v, s, below = self.step(v, s, h, INNER * GAP)
            sizes = np.linalg.norm((self.rows @ v).reshape(-1, self.size), axis=1)
            above = float(self.weights[:: self.size] @ sizes)
            outer += 1
            if above - below <= GAP * abs(below):
                break
            h *= SHRINK
        return above, below, outer


@dataclass(eq=False)
class ProximalSteps(Work):
    """Both solvers on the meshes of the vertical cut."""

    count: int = 4

    name = "proximal"
    title = "The upper bound of a vertical cut by proximal steps and by Clarabel"
    columns = """elements = {elements} | unknowns = {unknowns} | proximal steps = {outer}
        | Newton steps = {newton} | CPU s = {seconds:.2f} | its value = {value:.5f}
        | Clarabel steps = {steps} | CPU s = {conic_seconds:.2f}
        | its value = {conic:.5f}"""

    def cells(self):
        return [{"number": k} for k in range(self.count)]

    def mesh(self, number):
        problem = LIMITS["cut"]()
        data, _ = limit_data(problem, growing_names(problem, None)).without_units()
        centre = None
        for _ in range(number):
            bracket, _ = bracket_on(data, FLAT, centre, ConicAccuracy(1e-4))
            chosen = bracket.marks > np.median(bracket.marks)
            flow = bracket.mechanism.dissipated
            width = (bracket.upper - bracket.lower) / abs(bracket.lower)
            fans = fan_cells(data, singular_points(data), flow, width)
            data = data.on(*bisected_cells(data.cells, chosen, fans))
        return data

    def solve(self, number):
        data = self.mesh(number)
        flow = ContinuousVelocities(data, FLAT, 2).flow
        begin = time.process_time()
        found = cone_solution(flow.program(), ConicAccuracy(GAP))
        middle = time.process_time()
        proximal = Proximal(flow)
        above, _, outer = proximal.solve()
        end = time.process_time()
        cost = flow.program().cost
        return {
            "elements": len(data.cells.nodes),
            "unknowns": proximal.rows.shape[1],
            "outer": outer,
            "newton": proximal.steps,
            "seconds": end - middle,
            "value": above,
            "steps": found.steps,
            "conic_seconds": middle - begin,
            "conic": float(cost @ found.x),
        }

    def notes(self, records):
        return [f"Both stop at a relative gap of {GAP:g}; at most {MOST} Newton steps."]
