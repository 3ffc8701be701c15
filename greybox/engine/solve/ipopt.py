"""IPOPT on one program: its options, what ends a run early, and variants with other options."""

import math
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.response_programs import CostProgram
from greybox.engine.solve.interruption import reason_to_end
from greybox.engine.solve.runs import STAGNATED
from greybox.modeling.cached_property import cached_property
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import input_symbols

# The fits of the paper take some 30 iterations; a run of 500 does not converge.
QUIET = {"print_level": 0, "sb": "yes", "max_iter": 500}

# Options of a run that begins near a solution: without them it would first move toward the middle
# between the bounds.
WARM = {"mu_init": 1e-5, "bound_push": 1e-8, "bound_frac": 1e-8, "max_iter": 200}

# Options of a run that confirms a minimum: the barrier of WARM leads away from it, and three or
# four iterations back. With 1e-9, within IPOPT's tolerance, a saddle, where two lags are equal,
# would count as a minimum, since no step is tried.
CONFIRMING = {**WARM, "mu_init": 1e-7}


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
        self.begin()
        self.construct("stop_check", {})

    def begin(self) -> None:
        """Prepare for a run."""
        self.reason = ""
        self._waited = 0
        self._lowest = self._level = math.inf
        self.best: Array | None = None

    def get_n_in(self) -> int:
        """Return the number of results that the callback receives at every iteration."""
        return ca.nlpsol_n_out()

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of one of them."""
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)], 1)

    def has_eval_buffer(self) -> bool:
        """Receive plain memory: converted to matrices, an iteration would take a tenth longer."""
        return True

    def eval_buffer(self, arg: Any, res: Any) -> int:
        """Write whether to stop, 1 or 0."""
        x = np.frombuffer(arg[0])
        cost = float(np.frombuffer(arg[1])[0])
        stagnant = self.is_stagnant(x, cost)
        self.reason = reason_to_end() or (STAGNATED if stagnant else "")
        np.frombuffer(res[0])[0] = float(bool(self.reason))
        return 0

    def is_stagnant(self, x: Array, cost: float) -> bool:
        """Return whether the cost has not decreased for long."""
        if self._sizes["g"]:  # the cost grows while constraints are being met
            return False
        if cost < self._lowest:
            self._lowest, self.best = cost, x.copy()
        # Minima are distinguished to 1e-4. In 60 runs on each of eleven included problems, none
        # that converged had more than 39 iterations in a row with a smaller decrease than this;
        # twice that is the limit.
        if not math.isfinite(self._level) or cost < self._level - 1e-6 * abs(self._level):
            self._level = cost
            self._waited = 0
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
    derivatives : dict
        Derivatives built elsewhere, as options of `casadi.nlpsol`. The first solver that is built
        adds its own, and all variants share them.
    """

    def __init__(
        self,
        statement: Mapping[str, Any],
        options: Mapping[str, Any],
        derivatives: dict[str, ca.Function],
    ) -> None:
        self._statement = dict(statement)
        self._options = options
        self._derivatives = derivatives
        self._variants: dict[tuple[Any, ...], Ipopt] = {}
        self._check = StopCheck(statement)  # a reference, since CasADi holds only its address

    @classmethod
    def of(cls, program: CostProgram, options: Mapping[str, Any]) -> "Ipopt":
        """Return IPOPT on a program; its p are the smoothing and the data."""
        # Problems with the same formulas share it: building it takes as long as a run.
        key = repr(options)
        if key not in program.solvers:
            z, smoothing, data = input_symbols(program.function)
            f, g = program.function(z, smoothing, data)
            statement = {"x": z, "p": ca.vertcat(smoothing, data), "f": f, "g": g}
            program.solvers[key] = cls(statement, options, {})
        return program.solvers[key]

    @cached_property
    @one_thread_at_a_time
    def solver(self) -> ca.Function:
        """CasADi's solver, built when it is needed: a search in batches needs only a variant.

        Raises
        ------
        ValueError
            For an option that IPOPT does not take.
        """
        settings = {**self._derivatives, "iteration_callback": self._check}
        try:
            solver = _solver(self._statement, {**QUIET, **self._options}, settings)
        except RuntimeError:
            # The error of CasADi does not name the option: each is tried alone.
            x = ca.SX.sym("x")
            for name, value in self._options.items():
                try:
                    _solver({"x": x, "f": x**2}, {**QUIET, name: value}, {})
                except RuntimeError:
                    raise ValueError(
                        f"solver_options {name!r} = {value!r} is not accepted by IPOPT: "
                        "see the list of options in IPOPT's documentation."
                    ) from None
            raise

        names = {"grad_f": "nlp_grad_f", "jac_g": "nlp_jac_g", "hess_lag": "nlp_hess_l"}
        for option, name in names.items():
            if name in solver.get_function():
                self._derivatives[option] = solver.get_function(name)
        return solver

    def solve(self, x: Array, p: Any, bounds: Mapping[str, Any]) -> tuple[Array, str, int]:
        """Return the end of a run from x, its status and iterations.

        The end of a run that was stopped is its lowest point.
        """
        self._check.begin()
        end = self.solver(x0=x, p=p, **bounds)["x"]
        stats = self.solver.stats()
        status = stats["return_status"]

        # At a stop, IPOPT returns its current point, which may be anywhere.
        if status == "User_Requested_Stop":
            status = self._check.reason
            end = end if self._check.best is None else self._check.best
        return np.asarray(end).ravel(), status, int(stats["iter_count"])

    def derivatives(self, x: Array, p: Any) -> tuple[float, Array, Array]:
        """Return the cost at x (p,), its gradient (p,) and its Hessian (p, p)."""
        cost, gradient = [matrix.full() for matrix in self.solver.get_function("nlp_grad_f")(x, p)]
        no_multipliers = np.zeros(self._statement["g"].numel())
        upper = self._hessian(x, p, 1.0, no_multipliers).full()
        return cost.item(), gradient.ravel(), upper + np.triu(upper, 1).T

    @cached_property
    @one_thread_at_a_time
    def _hessian(self) -> ca.Function:
        """Return the exact Hessian, also if an option of IPOPT approximates it."""
        _ = self.solver
        if "hess_lag" in self._derivatives:
            return self._derivatives["hess_lag"]
        x, p = self._statement["x"], self._statement["p"]
        f, g = self._statement["f"], self._statement["g"]
        multipliers = type(g).sym("multipliers", g.numel())
        scale = type(g).sym("scale")
        upper = ca.triu(scale * ca.hessian(f, x)[0])
        return ca.Function("hessian", [x, p, scale, multipliers], [upper])

    def variant(self, options: Mapping[str, Any]) -> "Ipopt":
        """Return IPOPT on the same problem with more `options`, made at the first call."""
        key = tuple(options.items())
        if key not in self._variants:
            options = {**self._options, **options}
            self._variants[key] = Ipopt(self._statement, options, self._derivatives)
        return self._variants[key]


def _solver(
    statement: Mapping[str, Any], options: Mapping[str, Any], settings: Mapping[str, Any]
) -> ca.Function:
    """Return a silent solver with these options of IPOPT and `settings` of CasADi."""
    silent = {"print_time": False, "show_eval_warnings": False, "calc_lam_p": False}
    return ca.nlpsol("ipopt", "ipopt", statement, {**silent, "ipopt": dict(options), **settings})
