"""Hand-written alternatives to a time-domain `gb.fit`, and the data for both.

The plant is the quadcopter's tilt, (4.23) of the paper without the rotor's lag: states and outputs
v, q, theta, five unknowns, unstable in open loop. The references know nothing of greybox: they have
their own statement of the physics.

- `NonlinearProgram`: one multiple-shooting NLP for IPOPT, the idiom of CasADi's own example
  sysid.py: a step of SX, `map` over segments, nodes as unknowns, continuity as constraints, the
  Gauss-Newton Hessian through `hess_lag`.
- `segment_fit`: scipy.optimize.least_squares around segments of one second, simulated in numpy all
  at once, from the measured states or from initial states that are unknowns too.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array

GRAVITY = 9.8065  # m/s², the paper's
STEP = 0.01  # s
NAMES = ("a1", "a2", "a3", "a4", "C_x")
TRUTH = np.array([-2.0, 4.0, 3.0, 200.0, 0.1])
START = np.array([0.0, 3.0, 5.0, 250.0, 0.05])
LOWER = np.array([-100.0, -50.0, -50.0, 1.0, 0.001])
UPPER = np.array([100.0, 50.0, 50.0, 2000.0, 2.0])
SCALE = np.array([10.0, 3.0, 5.0, 250.0, 0.05])
NOISE = {"v": 0.05, "q": 0.02, "theta": 0.005}  # m/s, rad/s, rad
SIGMA = np.array(list(NOISE.values()))[:, None]
FEEDBACK = np.array(
    [0.004, 0.0175, 0.18]
)  # of v, q, theta: closes the loop at about 1.5 and 5 rad/s
SEGMENT = 10  # samples a shooting segment
EVALUATIONS = 200  # where least_squares gives up
SECOND = 100  # samples a simulated segment of `segment_fit`


def slopes(x: Any, u: Any, p: Any, tan: Any) -> list[Any]:
    """Return the right-hand side of (4.23) for anything that has arithmetic.

    `x` and `p` are indexed by row.
    """
    return [
        GRAVITY * tan(x[2]) - p[4] * abs(x[0]) * x[0],
        -p[0] * x[2] - p[1] * x[1] - p[2] * x[0] + p[3] * u,
        x[1],
    ]


def runge_kutta(f: Any, x: Any, h: float) -> Any:
    """Take one step of the classical method of order four, the input held."""
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * (k2 + k3) + k4)


def sx_slopes(x: ca.SX, u: ca.SX, p: ca.SX) -> ca.SX:
    return ca.vertcat(*slopes(ca.vertsplit(x), u, ca.vertsplit(p), ca.tan))


# --- the data


@dataclass(frozen=True)
class Flight:
    """A record at 100 Hz: `y` (3, n) holds v, q and theta with noise.

    `u` (n,) is held over a sample.
    """

    u: Array
    y: Array


def fly(samples: int, seed: int = 0) -> Flight:
    """Fly the unstable plant in a loop with noisy measurements, excited by a multisine of 60 s.

    The truth takes four Runge-Kutta steps where the estimators take one.
    """
    random = np.random.default_rng(seed)
    noise = SIGMA * random.normal(size=(3, samples))
    x, given, p = ca.SX.sym("x", 3), ca.SX.sym("given", 4), ca.SX(TRUTH)
    u = given[3] - ca.dot(ca.SX(FEEDBACK), x + given[:3])
    after = x
    for _ in range(4):
        after = runge_kutta(lambda z: sx_slopes(z, u, p), after, STEP / 4)
    loop = ca.Function("loop", [x, given], [after, ca.vertcat(u, x)]).mapaccum("flight", samples)
    _, seen = loop(np.zeros(3), np.vstack([noise, multisine(samples)]))
    seen = np.asarray(seen)
    return Flight(u=seen[0], y=seen[1:] + noise)


def multisine(samples: int) -> Array:
    """Return 24 sines between 0.05 and 5 Hz with the phases of Schroeder, periodic in 60 s."""
    time = STEP * np.arange(min(samples, 6000))
    turns = np.unique(np.round(np.geomspace(3, 300, 24)))  # whole turns in 60 s
    k = np.arange(len(turns))[:, None]
    waves = np.sin(2 * np.pi * turns[:, None] / 60 * time - np.pi * k**2 / len(turns))
    return np.resize(0.012 * waves.sum(axis=0), samples)


# --- one NLP for IPOPT


def shooting_segment(length: int) -> ca.Function:
    """(x0 (3,), u (1, n), y (3, n), scaled p (5,)) -> standardized residuals (3, n), last state."""
    x0, u, y, p = (
        ca.SX.sym(n, *size)
        for n, size in zip("xuyp", [(3,), (1, length), (3, length), (5,)], strict=True)
    )
    one, uk = ca.SX.sym("one", 3), ca.SX.sym("uk")
    step = ca.Function(
        "step", [one, uk, p], [runge_kutta(lambda z: sx_slopes(z, uk, p), one, STEP)]
    )
    x, residuals = x0, []
    for k in range(length):
        residuals.append((x - y[:, k]) / SIGMA[:, 0])
        x = step(x, u[:, k], p * SCALE)
    return ca.Function("segment", [x0, u, y, p], [ca.horzcat(*residuals), x])


def smoothed(y: Array) -> Array:
    """Return the mean of five neighbors, as good a guess of the states as a line of code gives."""
    padded = np.pad(y, ((0, 0), (2, 2)), mode="edge")
    return np.mean([padded[:, k : k + y.shape[1]] for k in range(5)], axis=0)


class NonlinearProgram:
    """The estimator as one NLP.

    Unknowns are the scaled parameters and the state at the head of every segment.

    With `blocks`, the derivatives are those of one segment, written as expressions and put in their
    places by hand, instead of CasADi's derivatives of the whole: more to write, less to build.
    """

    def __init__(self, flight: Flight, blocks: bool = False) -> None:
        segments = len(flight.u) // SEGMENT
        p, nodes = ca.MX.sym("p", len(TRUTH)), ca.MX.sym("nodes", 3, segments)
        w = ca.veccat(p, nodes)
        self.guess = smoothed(flight.y)[:, ::SEGMENT].ravel(order="F")
        data = (nodes, ca.DM(flight.u).T, ca.DM(flight.y), ca.repmat(p, 1, segments))
        expressions, functions = (_by_blocks if blocks else _by_casadi)(w, nodes, data, segments)
        options = {
            "print_time": False,
            "show_eval_warnings": False,
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 200},
        }
        self.solver = ca.nlpsol("program", "ipopt", {"x": w, **expressions}, functions | options)
        self.hessian = functions["hess_lag"]
        free = np.full(3 * segments, np.inf)
        self.bounds = {
            "lbx": np.r_[LOWER / SCALE, -free],
            "ubx": np.r_[UPPER / SCALE, free],
            "lbg": 0,
            "ubg": 0,
        }

    def solve(self, start: Array) -> dict[str, Any]:
        """Return `estimate`, `cost`, `status` and `iterations` from one start of the parameters."""
        answer = self.solver(x0=np.r_[start / SCALE, self.guess], **self.bounds)
        self.unknowns = answer["x"]
        return {
            "estimate": (np.asarray(answer["x"]).ravel()[: len(TRUTH)] * SCALE).tolist(),
            "cost": float(answer["f"]),
            "status": self.solver.stats()["return_status"],
            "iterations": self.solver.stats()["iter_count"],
        }

    def standard_errors(self) -> Array:
        """Return those of the parameters.

        The head of the inverse of the KKT matrix at the last solution.
        """
        from scipy.sparse import block_array  # noqa: PLC0415  (no part of what is timed)
        from scipy.sparse.linalg import splu  # noqa: PLC0415

        upper = self.hessian(self.unknowns, [], 1, 0)
        _, jacobian = self.solver.get_function("nlp_jac_g")(self.unknowns, [])
        hessian, jacobian = ca.triu2symm(upper).sparse(), jacobian.sparse()
        kkt = block_array([[hessian, jacobian.T], [jacobian, None]], format="csc")
        head = np.eye(kkt.shape[0], len(TRUTH))
        return np.sqrt(np.diag(splu(kkt).solve(head))) * SCALE


def _by_casadi(
    w: ca.MX, nodes: ca.MX, data: tuple[Any, ...], segments: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    residuals, after = shooting_segment(SEGMENT).map(segments)(*data)
    residuals, gaps = ca.vec(residuals), ca.vec(after[:, :-1] - nodes[:, 1:])
    jacobian = ca.jacobian(residuals, w)
    hessian = ca.triu(ca.mtimes(jacobian.T, jacobian))
    return {"f": ca.sumsqr(residuals) / 2, "g": gaps}, {"hess_lag": _gauss_newton(w, hessian, gaps)}


def _by_blocks(
    w: ca.MX, nodes: ca.MX, data: tuple[Any, ...], segments: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    segment = shooting_segment(SEGMENT)
    symbols = segment.sx_in()
    residuals, after = segment(*symbols)
    z = ca.vertcat(symbols[3], symbols[0])
    jacobian, size = ca.jacobian(ca.vec(residuals), z), len(TRUTH) + 3
    values = ca.Function("values", symbols, [ca.sumsqr(residuals) / 2, after])
    slopes_of = ca.Function(
        "slopes", symbols, [ca.mtimes(jacobian.T, ca.vec(residuals)), ca.jacobian(after, z)]
    )
    squares = ca.Function("squares", symbols, [ca.mtimes(jacobian.T, jacobian)])
    cost, ends = values.map(segments)(*data)
    gradients, sensitivities = slopes_of.map(segments)(*data)
    gaps = ca.vec(ends[:, :-1] - nodes[:, 1:])
    # Where the unknowns (p, node) of a segment stand among all, (8, segments), and the same for the
    # gaps behind it.
    own = np.r_[
        np.tile(np.arange(5)[:, None], segments), 5 + np.arange(3 * segments).reshape(-1, 3).T
    ]
    gap = np.arange(3 * (segments - 1)).reshape(-1, 3).T
    rows, columns = np.tile(own, (size, 1)), np.repeat(own, size, axis=0)
    hessian = _placed(
        ca.vec(squares.map(segments)(*data)), rows.T, columns.T, (w.numel(), w.numel()), upper=True
    )
    slope = _placed(
        ca.vec(sensitivities[:, :-size]),
        np.tile(gap, (size, 1)).T,
        np.repeat(own[:, :-1], 3, axis=0).T,
        (gaps.numel(), w.numel()),
    )
    after_node = ca.DM(
        ca.Sparsity.triplet(*slope.shape, range(gaps.numel()), range(8, w.numel())), 1
    )
    gradient = ca.vertcat(ca.sum2(gradients[:5, :]), ca.vec(gradients[5:, :]))
    names, none = ["x", "p"], ca.MX(0, 1)
    functions = {
        "hess_lag": _gauss_newton(w, hessian, gaps),
        "grad_f": ca.Function(
            "nlp_grad_f", [w, none], [ca.sum2(cost), gradient], names, ["f", "grad_f_x"]
        ),
        "jac_g": ca.Function(
            "nlp_jac_g", [w, none], [gaps, slope - after_node], names, ["g", "jac_g_x"]
        ),
    }
    return {"f": ca.sum2(cost), "g": gaps}, functions


def _gauss_newton(w: ca.MX, hessian: ca.MX, gaps: ca.MX) -> ca.Function:
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", gaps.numel())
    return ca.Function(
        "nlp_hess_l",
        [w, ca.MX(0, 1), weight, multipliers],
        [weight * hessian],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )


def _placed(
    values: ca.MX, rows: Any, columns: Any, shape: tuple[int, int], upper: bool = False
) -> ca.MX:
    """Return the sparse matrix with these entries, those of one place summed."""
    rows, columns = np.ravel(rows), np.ravel(columns)
    kept = np.flatnonzero(rows <= columns) if upper else np.arange(len(rows))
    places, which = np.unique(columns[kept] * shape[0] + rows[kept], return_inverse=True)
    pattern = ca.Sparsity.triplet(
        *shape, (places % shape[0]).tolist(), (places // shape[0]).tolist()
    )
    gather = ca.DM(ca.Sparsity.triplet(len(places), len(rows), which.tolist(), kept.tolist()), 1)
    return ca.MX(pattern, ca.mtimes(gather, values))


# --- scipy around short segments


def simulated(p: Any, heads: Any, u: Any) -> Any:
    """Simulate every segment: `p` and `heads` have rows first, `u` is (length, segments).

    Returns (length, 3, ...).
    """
    x, seen = heads, []
    for uk in u:
        seen.append(x)
        x = runge_kutta(lambda z, uk=uk: np.stack(slopes(z, uk, p, np.tan)), x, STEP)
    return np.stack(seen)


class ShortSegments:
    """Residuals of all segments and their difference quotients; the unknowns are scaled.

    With `free`, the state at the head of every segment is unknown; otherwise it is the measured
    one. All perturbations that do not meet are simulated at once: one for each parameter, and one
    for each of the three head states.
    """

    def __init__(self, flight: Flight, free: bool) -> None:
        self.segments = len(flight.u) // SECOND
        self.u = flight.u.reshape(self.segments, SECOND).T
        self.y = flight.y.reshape(3, self.segments, SECOND).transpose(2, 0, 1)
        self.free = free
        self.heads = smoothed(flight.y)[:, ::SECOND] if free else self.y[0]

    def unknowns(self, start: Array) -> Array:
        """Return the scaled parameters and, if unknown, the head states over the noise."""
        return np.r_[start / SCALE, (self.heads / SIGMA).ravel() if self.free else ()]

    def _parts(self, w: Array) -> tuple[Array, Array]:
        n = len(TRUTH)
        return w[:n] * SCALE, w[n:].reshape(3, -1) * SIGMA if self.free else self.heads

    def residuals(self, w: Array) -> Array:
        """Return the standardized residuals, time first."""
        return ((simulated(*self._parts(w), self.u) - self.y) / SIGMA).ravel()

    def jacobian(self, w: Array) -> Any:
        """Return forward differences; sparse where the heads are unknown."""
        p, heads = self._parts(w)
        n, m = len(TRUTH), len(TRUTH) + 3 * self.free
        h = 1e-7 * np.r_[np.maximum(np.abs(p), SCALE), 1 + 0 * SIGMA[:, 0]][:m]
        many = np.repeat(p[:, None, None], m + 1, axis=1)
        many[range(n), range(1, n + 1)] += h[:n, None]
        begins = np.repeat(heads[:, None, :], m + 1, axis=1)
        for k in range(m - n):
            begins[k, n + 1 + k] += h[n + k]
        seen = simulated(many, begins, self.u) / SIGMA[:, None]
        quotients = (seen[:, :, 1:] - seen[:, :, :1]) * (np.r_[SCALE, SIGMA[:, 0]][:m] / h)[:, None]
        dense = quotients[:, :, :n].transpose(0, 1, 3, 2).reshape(-1, n)
        return self._with_heads(dense, quotients[:, :, n:]) if self.free else dense

    def _with_heads(self, dense: Array, quotients: Array) -> Any:
        from scipy.sparse import csr_array, hstack  # noqa: PLC0415  (only this reference uses it)

        rows = np.arange(quotients.size // 3).reshape(*quotients.shape[:2], 1, self.segments)
        columns = np.arange(3 * self.segments).reshape(3, self.segments)
        index = [np.broadcast_to(a, quotients.shape).ravel() for a in (rows, columns)]
        return hstack([csr_array(dense), csr_array((quotients.ravel(), index))], format="csr")


def segment_fit(
    flight: Flight, start: Array, free: bool = False, errors: bool = False
) -> dict[str, Any]:
    """Return `estimate`, `cost`, `status` and `iterations`, and `standard_error` if asked for."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (only this reference uses it)

    problem = ShortSegments(flight, free)
    w, heads = problem.unknowns(start), problem.unknowns(start)[len(TRUTH) :]
    bounds = np.r_[LOWER / SCALE, heads - np.inf], np.r_[UPPER / SCALE, heads + np.inf]
    try:
        with np.errstate(all="ignore"):
            answer = least_squares(
                problem.residuals, w, problem.jacobian, bounds, max_nfev=EVALUATIONS
            )
    except (
        ValueError,
        np.linalg.LinAlgError,
    ) as error:  # the simulation overflows at the start, or on the way
        return {"estimate": start.tolist(), "cost": None, "status": str(error), "iterations": 0}
    found = {
        "estimate": (answer.x[: len(TRUTH)] * SCALE).tolist(),
        "cost": float(answer.cost),
        "status": answer.message if answer.success else f"not converged: {answer.message}",
        "iterations": int(answer.njev),
    }
    if errors:
        jacobian = answer.jac.toarray() if free else answer.jac
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        found["standard_error"] = (np.sqrt(np.diag(covariance))[: len(TRUTH)] * SCALE).tolist()
    return found
