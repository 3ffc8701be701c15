"""Records as one sparse nonlinear program for IPOPT: any transcription, the exact Hessian, and a second opinion.

Where the residual covariance is estimated, IPOPT minimizes weighted squares and the weights follow from the last
residuals, until both agree (relaxation); this is the minimum of the likelihood. Whole samples of estimated delays are
treated alike.
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
from greybox.compiled.response_part import SMOOTHING
from greybox.compiled.transcription.method import Transcribed
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.iterate import Iterate
from greybox.solve.interruption import stop_requested
from greybox.solve.ipopt import CONVERGED, STOPPED, StopCheck, checked_nlpsol
from greybox.solve.outcome import INTERRUPTED, NOT_FINITE, Outcome

Array = NDArray[np.float64]

# Relaxations, each an IPOPT run from the end of the last. They converge linearly; a useful rate needs far fewer.
RELAXATIONS = 100

# Relative change of the cost from one relaxation to the next that ends them: a tenth of a standard error changes it by
# 0.005, and costs are rarely above 1e5.
SAME = 1e-9


class TranscribedProgram:
    """IPOPT on one compiled problem that has records, built once for all starts."""

    def __init__(self, nlp: Nlp, gauss_newton: GaussNewton, options: Mapping[str, Any] = MappingProxyType({})) -> None:
        """Transcribe all records as their method says; `gauss_newton` gives states to begin with."""
        self._nlp = nlp
        self._gauss_newton = gauss_newton
        self._records = nlp.record_parts
        z = ca.MX.sym("z", len(nlp.free))
        placed = [part.model.locate(z)[0] for part in self._records]
        self._rows = [ca.MX.sym("rows", part.step.width, part.data.samples) for part in self._records]
        self._weights = [ca.MX.sym("W", len(part.outputs), len(part.outputs)) for part in self._records]
        self._transcribed: list[Transcribed] = [
            part.transcribe(q, rows) for part, q, rows in zip(self._records, placed, self._rows, strict=True)
        ]
        parameters = ca.vertcat(*map(ca.vec, (*self._weights, *self._rows)))
        unknowns = ca.vertcat(z, *[t.unknowns for t in self._transcribed])

        each = list(zip(self._records, self._weights, self._transcribed, placed, strict=True))
        errors = [math.sqrt(part.weight) * ca.vec(weight @ t.residuals) for part, weight, t, _ in each]
        error = ca.vertcat(*errors)
        known = [_known_states(part, t, q) for part, _, t, q in each]
        equations = ca.vertcat(*[t.equations for t in self._transcribed], *known)
        expressions = nlp.expressions
        responses = ca.Function("f", [expressions["x"], expressions["p"]], [expressions["f"]])(z, SMOOTHING)
        limits = ca.Function("g", [expressions["x"]], [expressions["g"]])(z)
        constraints = ca.vertcat(equations, limits)
        statement = {"x": unknowns, "p": parameters, "f": ca.sumsqr(error) / 2 + responses, "g": constraints}

        approximate = all(part.model.method.hessian == "gauss-newton" for part in self._records)
        hessian = _gauss_newton_hessian(unknowns, parameters, error, responses, constraints) if approximate else {}
        self._stop_check = StopCheck(statement)
        self._solver = checked_nlpsol(statement, options, hessian, self._stop_check)
        products = [t.residuals @ t.residuals.T for t in self._transcribed]
        self._products = ca.Function("products", [unknowns, parameters], products)

        unbounded = np.full(unknowns.numel() - z.numel(), np.inf)
        low, high = nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper)
        self._bounds = {
            "lbx": np.concatenate([low, -unbounded]),
            "ubx": np.concatenate([high, unbounded]),
            "lbg": np.zeros(constraints.numel()),
            "ubg": np.concatenate([np.zeros(equations.numel()), np.full(limits.numel(), np.inf)]),
        }

    def is_finite_at(self, start: Array) -> bool:
        """Tell whether the model is finite at the parameters `start` (p,), near the data."""
        return self._gauss_newton.is_finite_at(start)

    def run(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        scaling, p = self._nlp.scaling, len(start)
        z = np.clip(scaling.to_solver(start), self._bounds["lbx"][:p], self._bounds["ubx"][:p])
        first = self._gauss_newton.smoothed(z)
        if first is None:
            return Outcome(start, NOT_FINITE, 0, time.perf_counter() - began, False, math.inf)

        status, iterations, last, cost = "", 0, math.inf, math.inf
        w: Any = np.concatenate([z, *self._initial_unknowns(first)])
        settings = self._nlp.strategies
        weights = [part.initial_weight(settings.assumed_error) for part in self._records]
        for _ in range(RELAXATIONS):
            placed = [part.place(w[:p]).data for part in self._records]
            rows = [ca.DM(part.segments.in_order(data)) for part, data in zip(self._records, placed, strict=True)]
            parameters = ca.vertcat(*map(ca.vec, (*map(ca.DM, weights), *rows)))
            w = self._solver(x0=w, p=parameters, **self._bounds)["x"].full().ravel()
            stats = self._solver.stats()
            status, iterations = stats["return_status"], iterations + int(stats["iter_count"])
            products = [value.full() for value in _as_list(self._products(w, parameters))]
            cost = self._cost(w[:p], products)
            # The data are the same object as long as no delay has passed a whole sample.
            later = [part.place(w[:p]).data for part in self._records]
            same = all(a is b for a, b in zip(placed, later, strict=True))
            settled = abs(cost - last) <= SAME * max(1.0, abs(cost)) and same
            if settled or status not in CONVERGED or not math.isfinite(cost):
                break
            last = cost
            weights = [part.covariance.weight(s) for part, s in zip(self._records, products, strict=True)]
        else:
            status = "relaxations exceeded"
        if status == STOPPED:
            status = INTERRUPTED

        estimate = np.clip(scaling.to_parameters(w[:p]), self._nlp.lower, self._nlp.upper)
        converged = status in CONVERGED and math.isfinite(cost)
        signature = self._gauss_newton.signature(estimate) if converged else None
        if converged and signature is None:
            status, converged = INTERRUPTED if stop_requested() else "no continuous states at the estimate", False
        return Outcome(estimate, status, iterations, time.perf_counter() - began, converged, cost, signature)

    def _initial_unknowns(self, iterate: Iterate) -> list[Array]:
        """Return the unknowns of every record for the states along an iterate."""
        trajectories = [t for part, t in zip(self._nlp.parts, iterate.trajectories, strict=True) if part.has_states]
        each = zip(self._transcribed, self._records, trajectories, strict=True)
        return [t.start(part.segments.in_order(trajectory.detail.states)) for t, part, trajectory in each]

    def _cost(self, z: Array, products: list[Array]) -> float:
        costs = [part.weight * part.covariance.cost(s) for part, s in zip(self._records, products, strict=True)]
        return sum(costs) + float(self._nlp.costs(self._nlp.scaling.to_parameters(z)[None])[0])


def _as_list(found: Any) -> list[ca.DM]:
    return list(found) if isinstance(found, (tuple, list)) else [found]


def _known_states(part: RecordPart, transcribed: Transcribed, q: ca.MX) -> ca.MX:
    """Return known states at the first sample of the record less what they must be."""
    count = int(part.data.begins_record.sum())
    rows = np.flatnonzero(part.model.known_states).tolist()
    if not rows:
        return ca.MX(0, 1)  # no rows of a single one would be taken as a row without columns
    wanted, _ = part.model.initial(q)
    return ca.vec(transcribed.initial[rows, :count] - ca.repmat(wanted[rows], 1, count))


def _gauss_newton_hessian(
    unknowns: ca.MX, parameters: ca.MX, error: ca.MX, rest: ca.MX, constraints: ca.MX
) -> dict[str, ca.Function]:
    """Return the Hessian of the Lagrangian without the curvature of residuals and equations, as IPOPT's."""
    jacobian = ca.jacobian(error, unknowns)
    scale, multipliers = ca.MX.sym("scale"), ca.MX.sym("multipliers", constraints.numel())
    hessian = scale * (jacobian.T @ jacobian + ca.hessian(rest, unknowns)[0])
    function = ca.Function("hessian", [unknowns, parameters, scale, multipliers], [ca.triu(hessian)])
    return {"hess_lag": function}
