"""Are the standard errors right? Coverage of the 95 % Student-t interval for every criterion.

python benchmarks/coverage.py [--repeats 1000] [--only tilt] [--output FILE]

Synthetic truths with isotropic complex normal noise are fitted again and again. The table counts
how often the interval contains the truth. For speed, a cell is compiled once, its cost taken from
the criterion with the data as symbols, and all repeats are minimized together by Newton's method
from the truth; the standard errors are those of a fit. The first repeats of every cell, and those
that end outside the bounds, are done by `gb.fit` itself: the table says how far the two ways
differ, in standard errors.
"""

import argparse
import datetime as dt
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy
from scipy.special import stdtrit

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.covariance.accuracy import degrees, propagate
from greybox.engine.covariance.covariance import accuracy_at
from greybox.modeling.complex_arithmetic import Complex
from greybox.models.rotor import Rotor
from greybox.models.tilt import PAPER_G, Tilt
from greybox.statistics.neighbor_correlation import UNLIKELY

UNEQUAL = (
    "MaximumLikelihood",
    "MagnitudePhase, coherence",
    "MagnitudePhase, variances",
)  # errors of several sizes
CHECKS = 5  # repeats of every cell that gb.fit does too
SMOOTHINGS = (1e-6, 1e-9, 1e-13)
NOMINAL = (92.0, 97.0)  # per cent; outside, a number is marked


class Lags(gb.TransferFunction):
    r"""Two lags and a delay, $K e^{-s T} / ((T_1 s + 1)(T_2 s + 1))$; the benchmark's own."""

    input, output = "u", "y"
    K = gb.Parameter(2.0, bounds=(0.01, 100))
    T1 = gb.Parameter(0.4, bounds=(0.001, 10), unit="s")
    T2 = gb.Parameter(0.05, bounds=(0.001, 10), unit="s")
    T = gb.Parameter(0.02, bounds=(0, 0.2), unit="s")
    derived = {"ratio": lambda p: p.T1 / p.T2}

    def response(self, s, p):
        """Return the response."""
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) * gb.exp(-s * p.T)


PITCH = {
    "a1": -14.61,
    "a2": 2.97,
    "a3": 83.06 / PAPER_G,
    "a4": 295.5,
    "a5": 0.16,
}  # the paper, (4.28)
ROTOR = {"K_Omega": 1033.0, "T_rotor": 0.048, "T_delay": 0.0042}  # the paper, (4.22)
TRUTH = {"K": 2.0, "T1": 0.4, "T2": 0.05, "T": 0.02, **PITCH, **ROTOR}

TILT_OMEGA = np.geomspace(0.5, 30, 24)
LAGS_OMEGA = np.geomspace(1, 60, 40)
ROTOR_OMEGA = np.array([30.28, 20.11, 16.01, 12.03, 8.00, 5.34, 4.00, 3.50, 3.00])  # table 4.2

CRITERIA: dict[str, Any] = {
    "RelativeError": gb.RelativeError(),
    "RelativeError, model": gb.RelativeError(normalized="model"),
    "SquaredRelativeError": gb.SquaredRelativeError(),
    "SquaredRelativeError, model": gb.SquaredRelativeError(normalized="model"),
    "RelativeLikelihood": gb.RelativeLikelihood(),
    "MagnitudePhase": gb.MagnitudePhase(),
    "MagnitudePhase, coherence": gb.MagnitudePhase(),
    "MagnitudePhase, variances": gb.MagnitudePhase(),
    "MaximumLikelihood": gb.MaximumLikelihood(),
}


@dataclass(frozen=True)
class Part:
    """One synthetic experiment.

    Model, frequencies, noise (standard deviation of a component, relative).

    Errors over their sizes have a `correlation` from one point to the next, of an autoregression.
    """

    model: gb.modeling.Model
    omega: np.ndarray
    noise: float
    free: tuple[str, ...] = ()
    correlation: float = 0.0

    def sizes(self, given: bool) -> np.ndarray:
        """Noise of every point; where the fit is told of them they differ fourfold in size."""
        if not given:
            return np.full(self.omega.size, self.noise)
        order = np.argsort(np.sin(7.0 * np.arange(self.omega.size)))
        return self.noise * np.geomspace(0.5, 2.0, self.omega.size)[order]

    def exact(self) -> np.ndarray:
        """Return the true response, (n,)."""
        values = {name: TRUTH[name] for name in self.model.parameters}
        return gb.frequency_response(self.model, values, self.omega).response

    def draw(self, random: np.random.Generator, repeats: int, given: bool) -> np.ndarray:
        """Return noisy responses, (repeats, n)."""
        exact = self.exact()
        noise = random.normal(size=(repeats, exact.size)) + 1j * random.normal(
            size=(repeats, exact.size)
        )
        for k in range(1, exact.size if self.correlation else 0):
            noise[:, k] *= np.sqrt(1 - self.correlation**2)
            noise[:, k] += self.correlation * noise[:, k - 1]
        return exact * (1 + self.sizes(given) * noise)

    def problem(self, response: np.ndarray, criterion: str, fixed: Any) -> gb.Problem:
        """State the problem for one set of noisy data."""
        sizes = self.sizes(criterion in UNEQUAL)
        given = criterion in ("MaximumLikelihood", "MagnitudePhase, variances")
        variance = 2 * (sizes * np.abs(self.exact())) ** 2 if given else None
        # A coherence such as errors of these sizes come with: (1 - γ²)/γ² in proportion to their
        # variances.
        coherence = 1 / (1 + 20 * sizes**2) if criterion.startswith("MagnitudePhase, ") else None
        signals = {"input": self.model.input_names[0], "output": self.model.output_names[0]}
        data = gb.FrequencyResponse(
            self.omega, response, **signals, variance=variance, coherence=coherence
        )
        return gb.Problem(
            self.model, data, criterion=CRITERIA[criterion], free=self.free, fixed=fixed
        )


@dataclass(frozen=True)
class Case:
    """What is fitted: parts solved together, after `first`, whose Fit they take as fixed."""

    label: str
    parts: tuple[Part, ...]
    first: Part | None = None


def cases() -> list[Case]:
    result = []
    for noise in (0.02, 0.05):
        per_cent = f"{100 * noise:.0f} % noise"
        tilt = Part(Tilt(), TILT_OMEGA, noise, ("T_delay",))
        result += [
            Case(f"tilt, 24 points, {per_cent}", (tilt,)),
            Case(f"lags, 40 points, {per_cent}", (Part(Lags(), LAGS_OMEGA, noise),)),
            Case(f"rotor, 9 points, {per_cent}", (Part(Rotor(), ROTOR_OMEGA, noise),)),
        ]
    rotor = Part(Rotor(), ROTOR_OMEGA, 0.02)
    both = Part(Tilt(), TILT_OMEGA, 0.05, ("T_rotor", "T_delay"))
    for noise in (0.1, 0.2):
        result += [
            Case(f"tilt, 24 points, {100 * noise:.0f} % noise", (Part(Tilt(), TILT_OMEGA, noise),)),
            Case(f"lags, 40 points, {100 * noise:.0f} % noise", (Part(Lags(), LAGS_OMEGA, noise),)),
        ]
    return [
        *result,
        Case("joint, rotor 2 % + tilt 5 %", (rotor, both)),
        Case(
            "joint, rotor 2 % + tilt 5 % with 96 points",
            (rotor, replace(both, omega=np.geomspace(0.5, 30, 96))),
        ),
        Case("two-step, rotor 2 %, then tilt 5 %", (Part(Tilt(), TILT_OMEGA, 0.05),), rotor),
        Case(
            "two-step, rotor 4 %, then tilt 2 %",
            (Part(Tilt(), TILT_OMEGA, 0.02),),
            replace(rotor, noise=0.04),
        ),
    ]


@dataclass(frozen=True, eq=False)
class Known:
    """An earlier answer, as `Problem(fixed=...)` takes it."""

    estimate: Mapping[str, float]
    covariance: np.ndarray
    dof: float

    def covariance_of(self, names: Sequence[str]) -> np.ndarray:
        """Return the covariance of the named parameters."""
        places = [list(self.estimate).index(name) for name in names]
        return self.covariance[np.ix_(places, places)]


class _Measured(Complex):
    """A measured response as symbols.

    Unlike `Complex` it has `np.abs`, which the criteria take of data.
    """

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> Any:
        return abs(self) if ufunc is np.absolute else NotImplemented


@dataclass(frozen=True, eq=False)
class _SymbolicData:
    response: _Measured
    variance: Any
    coherence: Any
    size: int
    dof: Any = None

    def __len__(self) -> int:
        return self.size


class Cell:
    """One case and one criterion.

    The cost with data and constants as symbols, and its derivatives, compiled once.
    """

    def __init__(self, problem: gb.Problem | Any, smoothings: Sequence[float]) -> None:
        self.nlp = compile_problem(problem)
        self.smoothings = smoothings
        k, p = len(self.nlp.names), len(self.nlp.free)
        points = sum(len(part.data) for part in problem.parts)
        x, data, smoothing = (
            ca.SX.sym("x", k),
            ca.SX.sym("data", 2 * points),
            ca.SX.sym("smoothing"),
        )
        _, values = self.nlp.responses.function(x, self.nlp.data)
        cost, begin = 0, 0
        for part in problem.parts:
            n = len(part.data)
            re, im = slice(begin, begin + n), slice(points + begin, points + begin + n)
            symbols = _SymbolicData(
                _Measured(data[re], data[im]), part.data.variance, part.data.coherence, n
            )
            cost += part.criterion.cost(Complex(values[re], values[im]), symbols, smoothing)
            begin += n
        z = ca.SX.sym("z", p)
        scaled = ca.substitute(cost, x[:p], z * self._scale)
        hessian, gradient = ca.hessian(scaled, z)
        self._newton = ca.Function(
            "newton", [z, x[p:], data, smoothing], [scaled, gradient, hessian]
        )
        derived = [ca.SX(f) for f in self._derived(x)]
        stacked = ca.vertcat(*derived) if derived else ca.SX(0, 1)
        self._quantities = ca.Function("quantities", [x], [stacked, ca.jacobian(stacked, x)])

    @property
    def _scale(self) -> np.ndarray:
        return np.array([TRUTH[name] for name in self.nlp.free])

    def _derived(self, x: Any) -> list[Any]:
        values = dict(zip(self.nlp.names, ca.vertsplit(x), strict=True))
        return [
            f(p.local_values(values))
            for p in self.nlp.problem.parts
            for f in p.model.derived.values()
        ]

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters, then derived quantities."""
        return (*self.nlp.free, *(name for p in self.nlp.problem.parts for name in p.model.derived))

    def truth(self) -> np.ndarray:
        """Return the true values of `names`."""
        values = [TRUTH[name] for name in self.nlp.names]
        return np.concatenate(
            [values[: len(self.nlp.free)], np.asarray(self._quantities(values)[0]).ravel()]
        )

    def minimize(self, data: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (repeats, p) near the truth, and which are minima; data (repeats, 2N)."""
        repeats, p = len(data), len(self.nlp.free)
        function = self._newton.map(repeats)
        z, damping = np.ones((repeats, p)), np.full(repeats, 1e-3)

        def evaluate(z: np.ndarray, smoothing: float) -> tuple[np.ndarray, ...]:
            f, g, h = function(z.T, constants.T, data.T, smoothing)
            hessian = np.asarray(h).reshape(p, repeats, p).transpose(1, 0, 2)
            return np.asarray(f).ravel(), np.asarray(g).T, hessian

        decrement = np.full(repeats, np.inf)
        for smoothing in self.smoothings:
            f, g, h = evaluate(z, smoothing)
            for _ in range(60):
                diagonal = np.abs(np.diagonal(h, axis1=1, axis2=2)) * damping[:, None]
                values, vectors = np.linalg.eigh(h + diagonal[:, :, None] * np.eye(p))
                # A direction of negative curvature is gone down as if it were of positive one.
                values = np.maximum(
                    np.abs(values), 1e-9 * np.abs(values).max(axis=1, keepdims=True)
                )
                step = np.einsum(
                    "rij,rj->ri", vectors, np.einsum("rji,rj->ri", vectors, g) / values
                )
                decrement = np.einsum("ri,ri->r", g, step) / np.maximum(np.abs(f), 1e-12)
                if decrement.max() < 1e-12:
                    break
                new = evaluate(z - step, smoothing)
                better = new[0] <= f
                z = np.where(better[:, None], z - step, z)
                f, g, h = (
                    np.where(better[(...,) + (None,) * (a.ndim - 1)], b, a)
                    for a, b in zip((f, g, h), new, strict=True)
                )
                damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-12, 1e6)
        return z * self._scale, decrement < 1e-9

    def judge(self, problem: Any, x: np.ndarray, constants: np.ndarray) -> "Answer":
        """Return what a Fit would say at the minimum `x`, by the same code."""
        parts = tuple(
            ResponsePart(p, part.functions, part.inputs, part.is_open)
            for part, p in zip(self.nlp.parts, problem.parts, strict=True)
        )
        nlp = replace(self.nlp, problem=problem, parts=parts, constant_values=constants)
        accuracy = accuracy_at(nlp, x)
        value, gradient = (np.asarray(v) for v in self._quantities(nlp.all_values(x)))
        gradient = np.vstack([np.eye(x.size, len(nlp.names)), gradient])
        error = propagate(accuracy, gradient)
        half = stdtrit(np.minimum(degrees(accuracy, gradient), 1e9), 0.975) * error
        found = np.concatenate([x, value.ravel()])
        center = found - gradient @ accuracy.bias
        rough = any(
            part.neighbors is not None and part.neighbors.independent < UNLIKELY
            for part in accuracy.parts
        )
        return Answer(found, error, center, half, accuracy.covariance, accuracy.dof, rough)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """Return which rows of `x` lie within the bounds."""
        return np.all((x > self.nlp.lower) & (x < self.nlp.upper), axis=-1)


@dataclass(frozen=True, eq=False)
class Answer:
    """Values, standard errors, centers and half widths of 95 % intervals, as `Cell.names`."""

    value: np.ndarray
    error: np.ndarray
    center: np.ndarray
    half: np.ndarray
    covariance: np.ndarray
    dof: float
    rough: bool


@dataclass
class Outcome:
    """The results of a cell, one row for each repeat."""

    names: tuple[str, ...]
    truth: np.ndarray
    value: list[np.ndarray] = field(default_factory=list)
    error: list[np.ndarray] = field(default_factory=list)
    center: list[np.ndarray] = field(default_factory=list)
    half: list[np.ndarray] = field(default_factory=list)
    rough: list[bool] = field(default_factory=list)
    difference: float = 0.0
    by_fit: int = 0

    def add(self, answer: Answer) -> None:
        """Append one repeat."""
        self.value.append(answer.value)
        self.error.append(answer.error)
        self.center.append(answer.center)
        self.half.append(answer.half)
        self.rough.append(answer.rough)

    def summary(self) -> list[tuple[str, float, float, int, float, float]]:
        """Per quantity: coverage and its sigma (%), no interval, bias / sd, printed error / sd."""
        value, error, center, half = (
            np.array(v) for v in (self.value, self.error, self.center, self.half)
        )
        rows = []
        for k, name in enumerate(self.names):
            known = np.isfinite(half[:, k])
            miss = value[known, k] - self.truth[k]
            hit = np.abs(center[known, k] - self.truth[k]) <= half[known, k]
            sd = miss.std(ddof=1)
            share = hit.mean()
            sigma = np.sqrt(max(share * (1 - share), 0.95 * 0.05 / 4) / known.sum())
            ratio = np.sqrt(np.mean(error[known, k] ** 2)) / sd
            rows.append(
                (name, 100 * share, 100 * sigma, int((~known).sum()), miss.mean() / sd, ratio)
            )
        return rows


def by_fit(problem: Any, names: Sequence[str]) -> Answer:
    """Fit with the public function, from the truth."""
    start = {name: TRUTH[name] for name, p in problem.parameters.items() if not p.fixed}
    fit = gb.fit(problem, starts=[start], progress=False)
    values, intervals = {**fit.estimate, **fit.derived}, fit.interval()
    return Answer(
        np.array([values[name] for name in names]),
        np.array([fit.standard_error[name] for name in names]),
        np.array([sum(intervals[name]) / 2 for name in names]),
        np.array([(intervals[name][1] - intervals[name][0]) / 2 for name in names]),
        fit.covariance,
        fit.dof,
        any("correlated along frequency" in text for text in fit.warnings),
    )


def cell(case: Case, criterion: str, repeats: int, seed: int) -> Outcome:
    """Run one cell."""
    random = np.random.default_rng(seed)
    given = criterion in UNEQUAL
    draws = [part.draw(random, repeats, given) for part in case.parts]
    known: list[Known | None] = [None] * repeats
    if case.first is not None:
        known = [*_first(case.first, criterion, case.first.draw(random, repeats, given))]

    def problem(r: int) -> Any:
        problems = [
            part.problem(d[r], criterion, _fixed(part, known[r]))
            for part, d in zip(case.parts, draws, strict=True)
        ]
        return problems[0] if len(problems) == 1 else sum(problems[1:], problems[0])

    return _run(problem, draws, repeats)[0]


def _fixed(part: Part, known: Known | None) -> dict[str, Any]:
    """Return the values that are held.

    The true values of the declared constants, or the earlier answer where it has them.
    """
    declared = part.model.parameters
    held = [
        name for name, parameter in declared.items() if parameter.fixed and name not in part.free
    ]
    return {
        name: known if known is not None and name in known.estimate else TRUTH[name]
        for name in held
    }


def _first(part: Part, criterion: str, draws: np.ndarray) -> list[Known]:
    """Fit the first step of a two-step case in every repeat."""
    outcome, answers = _run(lambda r: part.problem(draws[r], criterion, {}), [draws], len(draws))
    return [
        Known(dict(zip(outcome.names, a.value.tolist(), strict=True)), a.covariance, a.dof)
        for a in answers
    ]


def _run(
    problem: Callable[[int], Any], draws: list[np.ndarray], repeats: int
) -> tuple[Outcome, list[Answer]]:
    problems = [problem(r) for r in range(repeats)]
    smoothed = any(part.criterion.smoothed for part in problems[0].parts)
    own = Cell(problems[0], SMOOTHINGS if smoothed else (0.0,))
    stacked = np.hstack([*(d.real for d in draws), *(d.imag for d in draws)])
    constants = np.array(
        [[p.parameters[name].start for name in own.nlp.constants] for p in problems]
    )
    constants = constants.reshape(repeats, len(own.nlp.constants))
    x, good = own.minimize(stacked, constants)
    good &= own.inside(x)
    outcome, answers = Outcome(own.names, own.truth()), []
    for r in range(repeats):
        answer = own.judge(problems[r], x[r], constants[r]) if good[r] else None
        if answer is None or r < CHECKS:
            full = by_fit(problems[r], own.names)
            if answer is not None:
                outcome.difference = max(
                    outcome.difference,
                    float(np.max(np.abs(full.value - answer.value) / answer.error)),
                    float(np.max(np.abs(full.error / answer.error - 1))),
                    float(np.max(np.abs(full.center - answer.center) / answer.error)),
                    float(np.max(np.abs(full.half / answer.half - 1))),
                )
            else:
                outcome.by_fit += 1
            answer = answer or full
        outcome.add(answer)
        answers.append(answer)
    return outcome, answers


def report(case: Case, outcomes: Mapping[str, Outcome]) -> tuple[str, list[str]]:
    """Return the table of one case, and the lines of what lies outside the nominal range."""
    names = next(iter(outcomes.values())).names
    heading = "".join(f"{name:>10}" for name in names)
    lines = [
        "",
        case.label,
        f"  {'criterion':<28}{heading}   largest bias   error / sd  by gb.fit  differ",
    ]
    outside = []
    for criterion, outcome in outcomes.items():
        rows = outcome.summary()
        cells = ""
        for name, share, sigma, missing, bias, ratio in rows:
            mark = "" if NOMINAL[0] <= share <= NOMINAL[1] else "!"
            cells += f"{mark + format(share, '.1f'):>10}"
            if mark or missing:
                outside.append(
                    f"  {case.label}; {criterion}; {name}: {share:.1f} ± {sigma:.1f} %, no "
                    f"interval in {missing}, "
                    f"bias {bias:+.2f} sd, printed error {ratio:.2f} sd"
                )
        worst = max(rows, key=lambda row: abs(row[4]))
        ratios = [row[5] for row in rows]
        lines.append(
            f"  {criterion:<28}{cells}{worst[4]:>+7.2f} {worst[0]:<9}{min(ratios):>5.2f} to "
            f"{max(ratios):.2f}"
            f"{outcome.by_fit:>9}{outcome.difference:>9.0e}"
        )
    return "\n".join(lines), outside


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="run the cases whose label holds this text")
    parser.add_argument("--output", type=Path, help="also write the tables here")
    arguments = parser.parse_args()
    began, text, outside, pooled = time.perf_counter(), [], [], {}

    def tell(line: str) -> None:
        print(line, flush=True)
        text.append(line)

    tell("Coverage (%) of the 95 % Student-t interval by the standard errors of greybox")
    tell(
        f"{dt.date.today()}, greybox {gb.__version__}, casadi {ca.__version__}, numpy "
        f"{np.__version__}, "
        f"scipy {scipy.__version__}, python {platform.python_version()}; seed {arguments.seed}"
    )
    sigma = 100 * np.sqrt(0.95 * 0.05 / arguments.repeats)
    tell(
        f"{arguments.repeats} repeats a cell: a coverage of 95 % is estimated with a binomial "
        f"sigma of {sigma:.1f} %; "
        f"! outside {NOMINAL[0]:.0f} to {NOMINAL[1]:.0f} %."
    )
    tell(
        "largest bias: of the estimate, in its standard deviations, and whose; intervals are "
        "corrected for it;\n"
        "error / sd: root mean square of the printed standard error over the actual standard "
        "deviation; by gb.fit:\n"
        "repeats where Newton's method left the bounds or did not converge; differ: largest "
        "difference to gb.fit in\n"
        "the first repeats, in standard errors.\n"
        "Criteria that are not told of errors of several sizes see the same draws, so their "
        "coverages vary together."
    )
    for number, case in enumerate(cases()):
        if arguments.only not in case.label:
            continue
        outcomes = {
            criterion: cell(case, criterion, arguments.repeats, 1000 * arguments.seed + number)
            for criterion in CRITERIA
        }
        table, bad = report(case, outcomes)
        tell(table)
        outside += bad
        for criterion, outcome in outcomes.items():
            pooled.setdefault(criterion, []).extend(row[1] for row in outcome.summary())
    tell("\nMean over all cells, %:")
    for criterion, shares in pooled.items():
        tell(f"  {criterion:<28}{np.mean(shares):6.1f}  ({min(shares):.1f} to {max(shares):.1f})")
    tell("\nOutside the nominal range, or without an interval in some repeats:")
    tell("\n".join(outside) or "  none")
    tell(f"\n{time.perf_counter() - began:.0f} s")
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
