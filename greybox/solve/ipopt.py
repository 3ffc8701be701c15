"""IPOPT on a problem without hidden unknowns, such as frequency responses: a dense program in the parameters."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING
from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time
from greybox.solve.interruption import Response, reason_to_end, responding, stop_requested
from greybox.solve.local_solver import LocalSolver, Profile
from greybox.solve.minima import AT_ONCE, Minimum, Multistart
from greybox.solve.outcome import CUT_SHORT, STAGNATED, Outcome

CONVERGED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")

# From a located minimum this status means that only rounding errors remain, as where the logarithm
# of nearly nothing is minimized.
ROUNDED = "Search_Direction_Becomes_Too_Small"
INVALID = "Invalid_Number_Detected"
STOPPED = "User_Requested_Stop"

# The fits of the paper take some 30 iterations; a run of 500 does not converge.
QUIET = {"print_level": 0, "sb": "yes", "max_iter": 500}

# Options of a run that begins near a solution: without them it would first move toward the middle
# between the bounds.
WARM = {"mu_init": 1e-5, "bound_push": 1e-8, "bound_frac": 1e-8, "max_iter": 200}

# Options of a run that begins where another stagnated. In directions that the data do not determine
# only the barrier has a slope, and its long steps leave a curved valley again and again: without a
# barrier 127 of 129 such runs, on random structures with a redundant product, ended at a minimum,
# the median after 4 iterations; with that of WARM 33. The cost has a larger unit, since rounding of
# a log-likelihood of tiny errors exceeds IPOPT's tolerance: of 12 runs that stagnated at relative
# errors of 1e-4, 10 then ended at the minimum. From the start on, the barrier would outweigh such a
# cost.
WITHOUT_BARRIER = {**WARM, "mu_init": 1e-11, "max_iter": 50, "obj_scaling_factor": 0.01}


def merits(nlp: CompiledProblem, z: Array) -> Array:
    """Return the smoothed costs at the columns of z (p, m), with a penalty on missed constraints: (m,)."""
    costs, limits = (value.full() for value in nlp.programs[0].function(z, SMOOTHING))
    # The weight of the penalty: a constraint missed by a thousandth weighs as much as a cost of one.
    values = costs.ravel() + 1e3 * np.maximum(-limits, 0).sum(axis=0)
    return np.where(np.isfinite(values), values, np.inf)


class StopCheck(ca.Callback):
    """Ends a run of IPOPT after Ctrl-C, at a time limit, or when the run makes no progress.

    Attributes
    ----------
    reason : str
        Why it ended the run: a status.
    best : (p,) array or None
        The point of the lowest cost, since a run that is cut short may be anywhere; None with
        constraints.
    """

    def __init__(self, expressions: Mapping[str, Any]) -> None:
        ca.Callback.__init__(self)
        self._sizes = {name: value.numel() for name, value in expressions.items()}
        self._sizes |= {f"lam_{name}": size for name, size in self._sizes.items()}
        self.reason = ""
        self.begin()
        self.construct("stop_check", {})

    def begin(self) -> None:
        """Prepare for a run."""
        self.reason, self._waited = "", 0
        self._lowest = self._level = math.inf
        self.best: Array | None = None

    def get_n_in(self) -> int:
        """Return the number of results of a solver, which the callback receives at every iteration."""
        return ca.nlpsol_n_out()

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of one of them."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def has_eval_buffer(self) -> bool:
        """Receive plain memory: converted to matrices, an iteration would take a tenth longer."""
        return True

    def eval_buffer(self, arg: Any, res: Any) -> int:
        """Write whether to stop, 1 or 0."""
        if res[0] is not None:
            x, cost = np.frombuffer(arg[0]), float(np.frombuffer(arg[1])[0])
            stagnant = self._is_stagnant(x, cost)
            self.reason = reason_to_end() or (STAGNATED if stagnant else "")
            np.frombuffer(res[0])[0] = float(bool(self.reason))
        return 0

    def _is_stagnant(self, x: Array, cost: float) -> bool:
        """Tell whether the cost has not decreased for long."""
        if self._sizes["g"]:  # the cost grows while constraints are being met
            return False
        if cost < self._lowest:
            self._lowest, self.best = cost, x.copy()
        # Minima are distinguished to 1e-4. Of 60 runs on each of eleven included problems, none that
        # converged had more than 39 iterations in a row with a smaller decrease than this; twice
        # that is the limit.
        if not math.isfinite(self._level) or cost < self._level - 1e-6 * abs(self._level):
            self._level, self._waited = cost, 0
        self._waited += 1
        return self._waited > 80


class Ipopt:
    """IPOPT on one problem, without output; a `StopCheck` may end a run.

    Parameters
    ----------
    statement : mapping
        ``x, p, f, g`` as `casadi.nlpsol` takes them.
    options : mapping
        IPOPT's.
    derivatives : mapping
        Derivatives built elsewhere, as options of `casadi.nlpsol`.

    Raises
    ------
    ValueError
        For an option that IPOPT does not take.
    """

    @one_thread_at_a_time
    def __init__(
        self,
        statement: Mapping[str, Any],
        options: Mapping[str, Any],
        derivatives: Mapping[str, ca.Function] = MappingProxyType({}),
    ) -> None:
        self._statement, self._options = dict(statement), options
        self._check = StopCheck(statement)  # a reference, since CasADi holds only its address
        settings = {
            **_settings({**QUIET, **options}),
            **derivatives,
            "iteration_callback": self._check,
        }
        try:
            self._solver = ca.nlpsol("ipopt", "ipopt", self._statement, settings)
        except RuntimeError:
            for name, value in options.items():
                _check_option(name, value)
            raise

    def solve(self, x: Array, p: Any, bounds: Mapping[str, Any]) -> tuple[Array, str, int]:
        """Return the end of a run from x, its status and iterations; the lowest point if it was stopped."""
        self._check.begin()
        end: Any = self._solver(x0=x, p=p, **bounds)["x"]
        stats = self._solver.stats()
        status = stats["return_status"]
        if status == STOPPED:
            status, end = self._check.reason, end if self._check.best is None else self._check.best
        return np.asarray(end).ravel(), status, int(stats["iter_count"])

    @cached_property
    def without_barrier(self) -> "Ipopt":
        """IPOPT on the same problem without a barrier."""
        return Ipopt(self._statement, {**self._options, **WITHOUT_BARRIER}, self.derivatives)

    @property
    def derivatives(self) -> dict[str, ca.Function]:
        """The derivatives that were built, as options of another solver of the same problem."""
        names = {"grad_f": "nlp_grad_f", "jac_g": "nlp_jac_g", "hess_lag": "nlp_hess_l"}
        built = self._solver.get_function()
        return {
            option: self._solver.get_function(name)
            for option, name in names.items()
            if name in built
        }


class IpoptSolver(LocalSolver):
    """IPOPT on one compiled problem: with the criterion that locates the minimum, if any, then with its own."""

    # A run takes some milliseconds, and the declared values of a transfer function are rarely better
    # than random ones.
    starts = 200
    tries_declared_values = False

    def __init__(
        self,
        nlp: CompiledProblem,
        options: Mapping[str, Any] = MappingProxyType({}),
        like: "IpoptSolver | None" = None,
    ) -> None:
        """Build the solver, with the derivatives of the one it is `like`."""
        self._nlp = nlp
        self._options = options
        derivatives = [program.derivatives for program in nlp.programs]
        if like:
            derivatives = [stage.derivatives for stage in like._stages]
        self._stages = [
            Ipopt(_statement(program.function), options, known)
            for program, known in zip(nlp.programs, derivatives, strict=True)
        ]
        scale = nlp.scaling.to_solver
        self._bounds = {
            "lbx": scale(nlp.lower),
            "ubx": scale(nlp.upper),
            "lbg": np.zeros(nlp.constraint.numel_out()),
            "ubg": np.full(nlp.constraint.numel_out(), np.inf),
        }

    def __reduce__(self) -> tuple[Callable[..., "IpoptSolver"], tuple[Any, ...]]:
        """Return what builds the same solver."""
        return IpoptSolver, (self._nlp, dict(self._options))

    def run(self, start: Array, smoothing: float = SMOOTHING) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        z = self._nlp.scaling.to_solver(start)
        iterations, status, located = 0, "", False
        for stage in self._stages:
            located = status in CONVERGED
            z, status, count = stage.solve(z, smoothing, self._bounds)
            iterations += count
            if status == STAGNATED:
                end, again, count = stage.without_barrier.solve(z, smoothing, self._bounds)
                iterations += count
                z, status = (end, again) if again in CONVERGED else (z, status)
            if status in (*CUT_SHORT, STAGNATED):
                break
        estimate = np.clip(self._nlp.scaling.to_parameters(z), self._nlp.lower, self._nlp.upper)
        converged = status in CONVERGED or (located and status == ROUNDED)
        return Outcome(estimate, status, iterations, time.perf_counter() - began, converged)

    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the point x (p,): there are no hidden unknowns."""
        z = self._nlp.scaling.to_solver(x)
        trajectories = tuple(part.initial_trajectory(z) for part in self._nlp.parts)
        return Profile(z, trajectories, float(self._nlp.costs(x[None])[0]), converged=True)

    def cost(self, values: Array) -> float:
        """Return the cost without smoothing at all values (k,)."""
        return self._nlp.cost(values)

    def judged(self, estimates: Array) -> tuple[Array, Any]:
        """Return the costs, without smoothing, and signatures."""
        if not len(estimates):
            return np.zeros(0), np.zeros((0, 0), np.float32)
        batches = [estimates[k : k + AT_ONCE] for k in range(0, len(estimates), AT_ONCE)]
        costs = np.concatenate([self._nlp.costs(batch) for batch in batches])
        # In single precision: they are stored for every run, and compared to a percent.
        signatures = [self._nlp.signatures(batch).astype(np.float32) for batch in batches]
        return costs, np.concatenate(signatures)

    def judged_run(self, outcome: Outcome) -> Outcome:
        """Return the outcome of a run with its cost and signature."""
        [cost], [signature] = self.judged(outcome.estimate[None])
        return replace(outcome, cost=float(cost), signature=signature)

    def refined(self, nlp: CompiledProblem) -> "IpoptSolver":
        """Return the solver of another problem with the same options."""
        return IpoptSolver(nlp, self._options)

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with the minima close to the best solved with less smoothing; after Ctrl-C the best alone."""
        minima = search.minima
        if not minima or not any(part.is_smoothed for part in self._nlp.parts):
            return search
        # At a kink IPOPT can reach looser tolerances only.
        options = {"acceptable_tol": 1e-4, "acceptable_iter": 3, **self._options}
        last = IpoptSolver(self._nlp, options, like=self)
        # Smoothing moves costs by 6e-5 and may change the order of close minima.
        close = [m for m in minima if m.cost <= 1.01 * minima[0].cost]
        close = minima[:1] if stop_requested() else close
        with responding(Response.FINISH):
            polished = [*(last._polish(m) for m in close), *minima[len(close) :]]
        return replace(search, minima=tuple(sorted(polished, key=lambda m: m.cost)))

    def _polish(self, best: Minimum) -> Minimum:
        """Return a minimum solved again with less smoothing, as long as the cost does not grow."""
        # In steps: at the kink of a zero residual IPOPT stalls when the smoothing falls at once.
        for smoothing in (1e-10, 1e-11, 1e-12, 1e-13):
            outcome = self.run(best.estimate, smoothing)
            cost = float(self._nlp.costs(outcome.estimate[None])[0])
            if outcome.status not in CONVERGED or not cost <= best.cost:
                break
            best = replace(best, cost=cost, estimate=outcome.estimate)
        return best


def _statement(program: ca.Function) -> dict[str, Any]:
    """Return ``x, p, f, g`` as `casadi.nlpsol` takes them, for a function (x, p) -> f, g."""
    kind: Any = ca.SX if program.is_a("SXFunction") else ca.MX
    x, p = (kind.sym(name, program.numel_in(k)) for k, name in enumerate("xp"))
    f, g = program(x, p)
    return {"x": x, "p": p, "f": f, "g": g}


def _settings(ipopt: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "print_time": False,
        "show_eval_warnings": False,
        "calc_lam_p": False,
        "ipopt": dict(ipopt),
    }


def _check_option(name: str, value: Any) -> None:
    """Raise ValueError when IPOPT does not take this option."""
    x = ca.SX.sym("x")
    try:
        ca.nlpsol(
            "option",
            "ipopt",
            {"x": x, "f": x**2},
            _settings({"print_level": 0, "sb": "yes", name: value}),
        )
    except RuntimeError:
        raise ValueError(
            f"solver_options {name!r} = {value!r} is not accepted by IPOPT: "
            "see the list of options in IPOPT's documentation."
        ) from None
