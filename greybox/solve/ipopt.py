"""One IPOPT run."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.data.text_table import counted, one_line

CONVERGED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
INVALID = "Invalid_Number_Detected"
SMOOTHING = 1e-8  # under the root of |e|²; 1e-14 takes about twice the time and moves the cost by 6e-5 at most
POLISH = (1e-10, 1e-11, 1e-12, 1e-13)  # of the last runs, one from the other; a kink allows no less at once

_QUIET = {"print_level": 0, "sb": "yes", "max_iter": 500}


@dataclass(frozen=True, eq=False)
class Run:
    """The outcome of one start.

    Attributes
    ----------
    index : int
        Number of the start.
    start, estimate : (p,) arrays
        Where the run began and ended, in the order of the free parameters.
    cost : float
        The criterion without smoothing, at the end.
    status : str
        What IPOPT returned.
    converged : bool
        True when IPOPT reports a solution and the cost is finite.
    iterations : int
    seconds : float
    reason : str
        Why it did not converge, as far as the model tells: where its response is not finite.
    """

    index: int
    start: NDArray[np.float64]
    estimate: NDArray[np.float64]
    cost: float
    status: str
    converged: bool
    iterations: int
    seconds: float
    reason: str = ""

    def __repr__(self) -> str:
        return one_line(
            self, f"{self.index}", self.status, f"cost {self.cost:.6g}", counted(self.iterations, "iteration")
        )


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a solver leaves of one run; IPOPT's cost is evaluated later, without smoothing and for all runs at once.

    `trace` (t,) tells runs in time apart: simulated outputs in units of the spread of the measured ones; `nodes` are
    the states at the beginning of every segment, (s, n) for each record.
    """

    estimate: NDArray[np.float64]
    status: str
    iterations: int
    seconds: float
    converged: bool
    cost: float = math.nan
    trace: NDArray[np.float64] | None = None
    nodes: tuple[NDArray[np.float64], ...] | None = None


class Solver:
    """IPOPT on one compiled problem, built once: the criterion that locates the minimum, if any, then its own."""

    def __init__(
        self, nlp: Nlp, options: Mapping[str, Any] = MappingProxyType({}), like: "Solver | None" = None
    ) -> None:
        """Build the solver; one `like` it lends its derivatives."""
        self._nlp = nlp
        self._options = options
        statements = [e for e in (nlp.first, nlp.expressions) if e is not None]
        known = [_derivatives(stage) for stage in like._stages] if like else [{} for _ in statements]
        self._stages = [checked_nlpsol(e, options, given) for e, given in zip(statements, known, strict=True)]
        scale = nlp.scaling.to_solver
        self._bounds = {
            "lbx": scale(nlp.lower),
            "ubx": scale(nlp.upper),
            "lbg": np.zeros(nlp.constraint.numel_out()),
            "ubg": np.full(nlp.constraint.numel_out(), np.inf),
        }

    def polishing(self) -> "Solver":
        """Return a solver for the last runs, which takes the little that a kink leaves to gain for a solution."""
        return Solver(self._nlp, {"acceptable_tol": 1e-4, "acceptable_iter": 3, **self._options}, like=self)

    def run(self, start: NDArray[np.float64], smoothing: float = SMOOTHING) -> Outcome:
        """Solve from `start` (p,)."""
        began = time.perf_counter()
        z: Any = self._nlp.scaling.to_solver(start)
        iterations, status = 0, ""
        for stage in self._stages:
            z = stage(x0=z, p=smoothing, **self._bounds)["x"]
            stats = stage.stats()
            iterations, status = iterations + int(stats["iter_count"]), stats["return_status"]
        estimate = self._nlp.scaling.to_parameters(np.asarray(z).ravel())
        estimate = np.clip(estimate, self._nlp.lower, self._nlp.upper)
        return Outcome(estimate, status, iterations, time.perf_counter() - began, status in CONVERGED)


def _derivatives(solver: ca.Function) -> dict[str, ca.Function]:
    """Return the derivatives that a solver has built, as options of another on the same problem."""
    names = {"grad_f": "nlp_grad_f", "jac_g": "nlp_jac_g", "hess_lag": "nlp_hess_l"}
    there = solver.get_function()
    return {option: solver.get_function(name) for option, name in names.items() if name in there}


def checked_nlpsol(
    expressions: Mapping[str, Any], options: Mapping[str, Any], derivatives: Mapping[str, ca.Function]
) -> ca.Function:
    """Return IPOPT on a problem, quiet.

    Raises
    ------
    ValueError
        For an option that IPOPT does not take.
    """
    settings = {**_settings({**_QUIET, **options}), **derivatives}
    try:
        return ca.nlpsol("ipopt", "ipopt", dict(expressions), settings)
    except RuntimeError:
        for name, value in options.items():
            _check_option(name, value)
        raise


def _settings(ipopt: Mapping[str, Any]) -> dict[str, Any]:
    return {"print_time": False, "show_eval_warnings": False, "calc_lam_p": False, "ipopt": dict(ipopt)}


def _check_option(name: str, value: Any) -> None:
    """Raise ValueError when IPOPT does not take this option."""
    x = ca.SX.sym("x")
    try:
        ca.nlpsol("option", "ipopt", {"x": x, "f": x**2}, _settings({"print_level": 0, "sb": "yes", name: value}))
    except RuntimeError:
        raise ValueError(
            f"solver_options {name!r} = {value!r} is not an option of IPOPT with such a value: "
            "see the list of options in IPOPT's documentation."
        ) from None
