"""Records as one sparse nonlinear program for IPOPT: any transcription, the exact Hessian, and a second opinion.

Where the noise is estimated, IPOPT minimizes weighted squares and the weights follow from the last residuals, until
both agree (relaxation); this is the minimum of the likelihood. Whole samples of estimated delays are treated alike.
"""

import math
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.record_part import RecordPart
from greybox.compiled.transcription.method import Transcribed, Transcription
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.ipopt import CONVERGED, SMOOTHING, Outcome, checked_nlpsol

Array = NDArray[np.float64]
RELAXATIONS = 100
SAME = 1e-9  # relative change of the cost between relaxations that ends them


class WholeProblem:
    """IPOPT on one compiled problem that has records, built once."""

    def __init__(self, nlp: Nlp, options: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Transcribe all records as the method of the problem says."""
        self._nlp, self._records = nlp, nlp.records
        self._first = GaussNewton(nlp)
        method: Transcription = self._records[0].method
        z = ca.MX.sym("z", len(nlp.free))
        places = [part.locate(z) for part in self._records]
        self._data = [ca.MX.sym("data", part.step.width, part.experiment.measured.shape[1]) for part in self._records]
        self._weights = [ca.MX.sym("W", len(part.outputs), len(part.outputs)) for part in self._records]
        self._transcribed: list[Transcribed] = [
            method.transcribe(part.step, part.experiment, q, data)
            for part, (q, _, _), data in zip(self._records, places, self._data, strict=True)
        ]
        parameters = ca.vertcat(*map(ca.vec, (*self._weights, *self._data)))
        unknowns = ca.vertcat(z, *[t.unknowns for t in self._transcribed])
        errors = [
            math.sqrt(part.part.weight) * ca.vec(weight @ t.residuals)
            for part, weight, t in zip(self._records, self._weights, self._transcribed, strict=True)
        ]
        known = [
            self._known(part, t, q) for part, t, (q, _, _) in zip(self._records, self._transcribed, places, strict=True)
        ]
        rest = ca.Function("rest", [nlp.expressions["x"], nlp.expressions["p"]], [nlp.expressions["f"]])(z, SMOOTHING)
        limits = ca.Function("limits", [nlp.expressions["x"]], [nlp.expressions["g"]])(z)
        equations = ca.vertcat(*[t.equations for t in self._transcribed], *known)
        error = ca.vertcat(*errors)
        statement = {
            "x": unknowns,
            "p": parameters,
            "f": ca.sumsqr(error) / 2 + rest,
            "g": ca.vertcat(equations, limits),
        }
        approximate = method.hessian == "gauss-newton"
        extra = _gauss_newton(unknowns, parameters, error, rest, statement["g"]) if approximate else {}
        self._solver = checked_nlpsol(statement, options, extra)
        products = [t.residuals @ t.residuals.T for t in self._transcribed]
        self._products = ca.Function("products", [unknowns, parameters], products)
        free = np.full(unknowns.numel() - z.numel(), np.inf)
        low, high = nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper)
        self._bounds = {
            "lbx": np.concatenate([low, -free]),
            "ubx": np.concatenate([high, free]),
            "lbg": np.zeros(equations.numel() + limits.numel()),
            "ubg": np.concatenate([np.zeros(equations.numel()), np.full(limits.numel(), np.inf)]),
        }

    def begins(self, start: Array) -> bool:
        """Tell whether the model is finite at the parameters `start` (p,), near the data."""
        return self._first.begins(start)

    def run(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        scaling, p = self._nlp.scaling, len(start)
        z = np.clip(scaling.to_solver(start), self._bounds["lbx"][:p], self._bounds["ubx"][:p])
        states, weights = self._first.smoothed(z)
        if states is None:
            return Outcome(start, "not finite at the start", 0, time.perf_counter() - began, False, math.inf)
        w: Any = np.concatenate([z, *(t.start(s) for t, s in zip(self._transcribed, states, strict=True))])
        status, iterations, last, cost = "", 0, math.inf, math.inf
        for _ in range(RELAXATIONS):
            placed = self._placed(w[:p])
            data = [ca.DM(part.shooting.in_order(d)) for part, d in zip(self._records, placed, strict=True)]
            parameters = ca.vertcat(*map(ca.vec, (*map(ca.DM, weights), *data)))
            w = self._solver(x0=w, p=parameters, **self._bounds)["x"].full().ravel()
            stats = self._solver.stats()
            status, iterations = stats["return_status"], iterations + int(stats["iter_count"])
            products = [value.full() for value in self._as_list(self._products(w, parameters))]
            cost = self._cost(w[:p], products)
            # The data are the same object as long as no delay has passed a whole sample.
            same = all(a is b for a, b in zip(placed, self._placed(w[:p]), strict=True))
            settled = abs(cost - last) <= SAME * max(1.0, abs(cost)) and same
            if settled or status not in CONVERGED or not math.isfinite(cost):
                break
            last = cost
            weights = [part.noise.weight(s) for part, s in zip(self._records, products, strict=True)]
        else:
            status = "relaxations exceeded"
        estimate = np.clip(scaling.to_parameters(w[:p]), self._nlp.lower, self._nlp.upper)
        converged = status in CONVERGED and math.isfinite(cost)
        trace = self._first.trace(estimate) if converged else None
        converged = converged and trace is not None
        return Outcome(estimate, status, iterations, time.perf_counter() - began, converged, cost, trace)

    def _placed(self, z: Array) -> list[Array]:
        """Return the data of every record, inputs placed for the delays at z."""
        return [part.place(z).data for part in self._records]

    def _cost(self, z: Array, products: list[Array]) -> float:
        costs = [part.part.weight * part.noise.cost(s) for part, s in zip(self._records, products, strict=True)]
        return sum(costs) + float(self._nlp.costs(self._nlp.scaling.to_parameters(z)[None])[0])

    def _as_list(self, found: Any) -> list[ca.DM]:
        return list(found) if isinstance(found, (tuple, list)) else [found]

    @staticmethod
    def _known(part: RecordPart, transcribed: Transcribed, q: ca.MX) -> ca.MX:
        """Return known states at the first sample of the record less what they must be."""
        count = int(part.begins.sum())
        rows = np.flatnonzero(part.known_states).tolist()
        if not rows:
            return ca.MX(0, 1)  # no rows of a single one would be taken as a row without columns
        wanted, _ = part.initial(q)
        return ca.vec(transcribed.initial[rows, :count] - ca.repmat(wanted[rows], 1, count))


def _gauss_newton(unknowns: ca.MX, parameters: ca.MX, error: ca.MX, rest: ca.MX, g: ca.MX) -> dict[str, ca.Function]:
    """Return the Hessian of the Lagrangian without the curvature of residuals and equations, as IPOPT's."""
    jacobian = ca.jacobian(error, unknowns)
    scale, multipliers = ca.MX.sym("scale"), ca.MX.sym("multipliers", g.numel())
    hessian = scale * (jacobian.T @ jacobian + ca.hessian(rest, unknowns)[0])
    function = ca.Function("hessian", [unknowns, parameters, scale, multipliers], [ca.triu(hessian)])
    return {"hess_lag": function}
