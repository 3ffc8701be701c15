"""Hidden states as unknowns of one sparse program for IPOPT, for any transcription.

Where the residual covariance is estimated, IPOPT minimizes weighted squares and the weights follow
from the last residuals, until both agree (relaxation): this is the minimum of the likelihood. The
whole samples of estimated delays follow in the same way.
"""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import SMOOTHING
from greybox.engine.compiled.record_group import shared_products
from greybox.engine.compiled.record_part import RecordPart, RecordProgram
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.interruption import reason_to_end
from greybox.engine.solve.ipopt import Ipopt
from greybox.engine.solve.local_solver import Descent, Profile
from greybox.engine.solve.runs import CUT_SHORT, NOT_FINITE, Outcome, Outcomes
from greybox.modeling.one_thread import one_thread_at_a_time


class TranscribedProgram(Descent):
    """IPOPT on one compiled problem whose parts have hidden unknowns, built once for all starts."""

    @one_thread_at_a_time
    def __init__(self, nlp: CompiledProblem, options: Mapping[str, Any]) -> None:
        """Put the programs of all parts together."""
        self.nlp = nlp
        self._gauss_newton = GaussNewton(nlp)  # supplies the first states
        z = ca.MX.sym("z", len(nlp.free))
        self._programs = [RecordProgram(part, z) for part in nlp.parts_of(RecordPart)]
        self._responses = nlp.parts_of(ResponsePart)
        # IPOPT needs a symbolic expression. A spectrum, say, eliminates its end terms numerically.
        for part in nlp.parts:
            if not isinstance(part, RecordPart | ResponsePart):
                raise ValueError(
                    f"IPOPT takes records as one program and {part.name!r} is "
                    f"{part.problem.kind.noun}: use method=MultipleShooting() and "
                    "search='batched', the defaults."
                )

        # The parameters come first: they are all that the parts share.
        unknowns = ca.vertcat(z, *[program.unknowns for program in self._programs])
        parameters = ca.vertcat(*[program.parameters for program in self._programs])
        error = ca.vertcat(
            *[math.sqrt(program.part.weight) * program.error for program in self._programs]
        )
        cost = ca.MX(self._cost_of_responses(z, SMOOTHING))
        equations = ca.vertcat(*[program.equations for program in self._programs])
        limits = nlp.limits_at(z)
        constraints = ca.vertcat(equations, limits)
        statement = {
            "x": unknowns,
            "p": parameters,
            "f": ca.sumsqr(error) / 2 + cost,
            "g": constraints,
        }

        derivatives = {}
        if nlp.method.hessian == "gauss-newton":
            # Without the curvature of residuals and equations.
            scale, multipliers = ca.MX.sym("scale"), ca.MX.sym("lam", constraints.numel())
            jacobian = ca.jacobian(error, unknowns)
            hessian = scale * (jacobian.T @ jacobian + ca.hessian(cost, unknowns)[0])
            arguments = [unknowns, parameters, scale, multipliers]
            derivatives["hess_lag"] = ca.Function("hessian", arguments, [ca.triu(hessian)])
        self._ipopt = Ipopt(statement, options, derivatives)

        # Where the unknowns and parameters of each part end in those of the program.
        sizes = [program.unknowns.numel() for program in self._programs]
        self._unknown_ends = np.cumsum([z.numel(), *sizes])[:-1]
        sizes = [program.parameters.numel() for program in self._programs]
        self._parameter_ends = np.cumsum(sizes)[:-1]

        # States may go anywhere: a bound would only cut off their search.
        unbounded = np.full(unknowns.numel() - z.numel(), np.inf)
        low, high = nlp.bounds
        self._bounds = {
            "lbx": np.concatenate([low, -unbounded]),
            "ubx": np.concatenate([high, unbounded]),
            "lbg": np.zeros(constraints.numel()),
            "ubg": np.concatenate([np.zeros(equations.numel()), np.full(limits.numel(), np.inf)]),
        }

    def is_finite_at(self, start: Array) -> bool:
        """Return whether the model is finite at the parameters `start` (p,), near the data."""
        return self._gauss_newton.is_finite_at(start)

    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the best nodes at the parameters x (p,), as the Gauss-Newton solver finds them."""
        return self._gauss_newton.profile(x, nodes)

    def with_problem(self, nlp: CompiledProblem) -> GaussNewton:
        """Return the Gauss-Newton solver of the problem, which is near the minimum already."""
        return self._gauss_newton.with_problem(nlp)

    def led(self, starts: Array) -> Outcomes:
        """Return the runs from all starts (r, p)."""
        return [self._led(start) for start in starts]

    def descended(self, starts: Array) -> Outcomes:
        """Return where Gauss-Newton steps lead from the starts (r, p)."""
        return self._gauss_newton.descended(starts)

    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the costs (r,) at the starts (r, p) with their best states."""
        return self._gauss_newton.costs_at(starts, ends)

    def _led(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        z = self._gauss_newton.limits.clipped(self.nlp.scaling.to_solver(start))
        first = self._gauss_newton.smoothed(z)
        if first is None:
            return Outcome(start, NOT_FINITE, 0, time.perf_counter() - began, False, math.inf)

        status = ""
        iterations = 0
        last = cost = math.inf
        pairs = zip(self._programs, self.nlp.rows_of(RecordPart, first), strict=True)
        solution = np.concatenate([z, *[program.initial_unknowns(t) for program, (_, t) in pairs]])
        w = np.concatenate([program.initial_parameters(z) for program in self._programs])
        # Relaxations, each an IPOPT run from the end of the last. They converge linearly; a useful
        # rate needs far fewer.
        for _ in range(100):
            solution, status, count = self._ipopt.solve(solution, w, self._bounds)
            iterations += count
            cost, w, same_data = self._outcome(solution, w)
            # A tenth of a standard error changes the cost by 0.005, and costs are rarely above 1e5.
            settled = abs(cost - last) <= 1e-9 * max(1.0, abs(cost)) and same_data
            # A program that IPOPT did not solve is not worth another one.
            if settled or not status.startswith("Solve") or not math.isfinite(cost):
                break
            last = cost
        else:
            status = "relaxations exceeded"

        estimate = self.nlp.estimate_at(solution[: len(z)])
        signature, converged = None, False
        if status not in CUT_SHORT and math.isfinite(cost):
            profile = self.profile(estimate)
            converged = self._gauss_newton.is_minimum(estimate, profile)
            pairs = zip(self.nlp.parts, profile.trajectories, strict=True)
            signature = np.concatenate([part.signature(trajectory) for part, trajectory in pairs])
            if not profile.converged:
                status = reason_to_end() or "no continuous states at the estimate"
                cost = math.inf  # that of IPOPT's states is none of the model
        return Outcome(
            estimate, status, iterations, time.perf_counter() - began, converged, cost, signature
        )

    def _outcome(self, solution: Array, w: Array) -> tuple[float, Array, bool]:
        """Return cost, next parameters, and whether no delay passed a whole sample."""
        z = solution[: len(self.nlp.free)]
        unknowns = np.split(solution, self._unknown_ends)[1:]
        parameters = np.split(w, self._parameter_ends)
        values = zip(self._programs, unknowns, parameters, strict=True)
        products = [program.products(z, states, ws).full() for program, states, ws in values]
        products = shared_products([program.part for program in self._programs], products)
        values = zip(self._programs, products, parameters, strict=True)
        outcomes = [program.outcome(z, each, ws) for program, each, ws in values]
        costs, following, same_data = zip(*outcomes, strict=True)
        pairs = zip(self._programs, costs, strict=True)
        cost = sum(program.part.weight * record_cost for program, record_cost in pairs)
        cost += float(self._cost_of_responses(z, 0.0))
        return cost, np.concatenate(following), all(same_data)

    def _cost_of_responses(self, z: Any, smoothing: float) -> Any:
        """Return the weighted cost of the frequency responses, which have no hidden unknowns."""
        return sum(part.weight * part.objective(z, smoothing) for part in self._responses)
