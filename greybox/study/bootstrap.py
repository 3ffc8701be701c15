"""The bootstrap: a fit is repeated on data that were drawn anew, and what its answers spread over is their error.

The replicates begin at the estimate: they say how far the minimum at hand moves with the errors of
the data, not whether another one would be found. Sources: Efron and Tibshirani (1993), An
Introduction to the Bootstrap; Davison and Hinkley (1997), Bootstrap Methods and their Application.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import casadi as ca
import numpy as np
from tqdm import tqdm

from greybox.compiled.compiled_problem import AnyProblem, Nlp
from greybox.compiled.transcription.method import Transcription
from greybox.estimate.covariance import assess, known_covariances
from greybox.estimate.fitted_problem import compiled_again
from greybox.estimate.quantities import formulas
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.json_numbers import finite
from greybox.files.text_table import alternatives, counted, number, one_line, some, text_table
from greybox.solve.discretization_error import refine_discretization
from greybox.solve.executors import packed, run_all
from greybox.solve.interruption import Response, listening, responding, take_interrupt
from greybox.solve.kept_runs import Memory
from greybox.solve.minima import same_cost
from greybox.solve.multistart import multistart, solver_for
from greybox.solve.outcome import Outcome
from greybox.statistics.error_spectrum import ErrorSpectrum
from greybox.study.record_replicates import RecordReplicates, record_draws
from greybox.study.resampling import acceleration, bca_interval, percentile_interval, tail
from greybox.study.response_replicates import response_draws, response_replicates
from greybox.study.store import StoredRuns, locked

Resampling = Literal["residuals", "points", "parametric", "parts", "blocks"]
Method = Literal["bca", "percentile"]

CLOSE = 1e-4  # relative, within which a replicate counts as at its bound: that is how far IPOPT's barrier keeps it
MANY_FAILED = (
    0.05  # share of replicates whose failure is a warning: the tails are of half that size
)

# Replicates beyond an end of an interval: with four, the end itself is uncertain by a quarter of a
# standard error.
FEWEST_BEYOND = 4
# How much farther an interval reaches on one side than on the other from which it is said to be
# one-sided: of poles far above the band it was 2.5 and more, of lags and the tilt model at most 2.1
# (`benchmarks/bootstrap_coverage.py`).
ONE_SIDED = 2.5
FEWEST_PARTS = 3  # of which a replicate is drawn: of two, half of the replicates have one alone

WORDS = {
    "residuals": "residuals drawn over the frequencies, turned at random in the complex plane",
    "points": "points drawn with replacement",
    "parametric": "normal errors of the fitted size",
    "parts": "whole parts drawn with replacement",
    "blocks": "residuals drawn",
}


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Replicates of an estimate. Printing them gives errors and intervals.

    Attributes
    ----------
    name : str
        Of the problem.
    resampling : str
        What was drawn; `about` says it in words.
    seed : int
    names, units : tuple of str
        Free and tied parameters, then derived quantities.
    estimate, given_error : (q,) arrays
        Of the fit; its standard errors are NaN where it has none.
    values : (b, q) array
        A row for each replicate; NaN where it failed.
    statuses : tuple of str
        Of the replicates that failed, by number; empty for the others.
    left_out : (m, q) array
        The estimates with one observation left out each, for the acceleration; none where there are
        no such.
    bounds : (q, 2) array
        Infinite for what has none.
    dof : (q,) array
        Degrees of freedom of the size of the errors, as of the fit.
    warnings : tuple of str
    seconds : float
    """

    name: str
    resampling: str
    about: str
    seed: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    estimate: Array
    given_error: Array
    values: Array
    statuses: tuple[str, ...]
    left_out: Array
    bounds: Array
    dof: Array
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0

    def __getitem__(self, name: str) -> Array:
        """Return the replicates of a quantity that did not fail."""
        if name not in self.names:
            raise KeyError(
                f"{name!r} has no replicates; there are {alternatives(name, list(self.names))}"
            )
        return self._done[:, self.names.index(name)]

    @property
    def failed(self) -> int:
        """How many replicates failed."""
        return len(self.values) - len(self._done)

    @property
    def standard_error(self) -> dict[str, float]:
        """Standard deviations of the replicates by name."""
        spread = (
            self._done.std(axis=0, ddof=1)
            if len(self._done) > 1
            else np.full(len(self.names), np.nan)
        )
        return dict(zip(self.names, spread.tolist(), strict=True))

    @property
    def bias(self) -> dict[str, float]:
        """Means of the replicates less the estimates, by name."""
        away = (
            self._done.mean(axis=0) - self.estimate
            if len(self._done)
            else np.full(len(self.names), np.nan)
        )
        return dict(zip(self.names, away.tolist(), strict=True))

    def interval(
        self, level: float = 0.95, method: Method = "bca", *, widened: bool = True
    ) -> dict[str, tuple[float, float]]:
        """Return intervals by name, infinite on a side on which they reach the bound; NaN where there is none.

        Parameters
        ----------
        level : float
        method : "bca" or "percentile"
            Bias-corrected and accelerated, where the acceleration is that of the estimates with one
            observation left out, zero where there are none; or the quantiles of the replicates.
        widened : bool
            Take quantiles as far out as those of Student's t with the degrees of freedom of the
            fit, since replicates do not tell how well the size of the errors is known (Hesterberg
            2015, the expanded percentile interval).
        """
        if not 0 < level < 1:
            raise ValueError(f"level {level} must lie between 0 and 1, e.g. 0.95.")
        if method not in get_args(Method):
            raise ValueError(f"method is {method!r:.40}: give 'bca' or 'percentile'.")
        found = {}
        for k, name in enumerate(self.names):
            values = self._done[:, k]
            dof = float(self.dof[k]) if widened else math.inf
            if method == "bca":
                low, high = bca_interval(
                    values, float(self.estimate[k]), float(self._acceleration[k]), level, dof
                )
            else:
                low, high = percentile_interval(values, level, dof)
            lower, upper = self.bounds[k]
            found[name] = (
                -math.inf if _is_at(low, lower) else low,
                math.inf if _is_at(high, upper) else high,
            )
        return found

    @property
    def at_bound(self) -> dict[str, tuple[float, float]]:
        """Shares of the replicates at the lower and at the upper bound, by name."""
        return {
            name: (
                float(
                    np.mean(
                        [_is_at(value, self.bounds[k][0]) for value in self._done[:, k]] or [0.0]
                    )
                ),
                float(
                    np.mean(
                        [_is_at(value, self.bounds[k][1]) for value in self._done[:, k]] or [0.0]
                    )
                ),
            )
            for k, name in enumerate(self.names)
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader should know of the intervals: which parameters the data bound on one side alone."""
        names = []
        for k, (name, (low, high)) in enumerate(self.interval(method="percentile").items()):
            below, above = sorted((float(self.estimate[k]) - low, high - float(self.estimate[k])))
            if above > ONE_SIDED * max(below, 0.0):
                names.append(name)
        if not names:
            return ()
        return (
            f"the replicates of {some(names)} reach much farther to one side: take the percentile interval or, where "
            "it serves, gb.profile. Of such parameters BCa intervals covered 86 to 91 %, percentile ones 91 to 93 %, "
            "profiles 95 to 97 %; all are the same for any function of the parameter, so that none mends them.",
        )

    @cached_property
    def _done(self) -> Array:
        return self.values[np.isfinite(self.values).all(axis=1)]

    @cached_property
    def _acceleration(self) -> Array:
        return acceleration(self.left_out) if len(self.left_out) else np.zeros(len(self.names))

    def __repr__(self) -> str:
        return one_line(self, self.name, self.resampling, counted(len(self.values), "replicate"))

    def __str__(self) -> str:
        return self.text()

    def text(self, level: float = 0.95) -> str:
        """Return errors and intervals as a table."""
        failed = f", {self.failed} failed" if self.failed else ""
        title = f"{self.name}: bootstrap, {self.about}; {counted(len(self.values), 'replicate')}{failed}"
        error, bias = self.standard_error, self.bias
        both = [self.interval(level, method) for method in ("percentile", "bca")]
        percent = f"{100 * level:g} %"
        header = [
            "",
            "estimate",
            "± error",
            "± fit",
            "bias",
            "unit",
            f"{percent} percentile",
            f"{percent} BCa",
        ]
        rows = [
            [
                name,
                number(float(self.estimate[k])),
                number(error[name], 3),
                number(float(self.given_error[k]), 3),
                number(bias[name], 2),
                self.units[k],
                *(interval_text(_ends(found[name])) for found in both),
            ]
            for k, name in enumerate(self.names)
        ]
        table = ["  " + line for line in text_table(header, rows, left=(0, 5, 6, 7)).splitlines()]
        warnings = [f"  warning: {text}" for text in self.warnings] + [
            f"  note: {text}" for text in self.notes
        ]
        return "\n".join(
            [title, "", *table, "", *warnings, f"  {self.seconds:.2f} s; seed {self.seed}"]
        )

    def summary(self, level: float = 0.95) -> dict[str, Any]:
        """Return everything but the replicates as plain values, for JSON; None for an open side, or no interval."""
        error, bias, at_bound = self.standard_error, self.bias, self.at_bound
        intervals = {method: self.interval(level, method) for method in get_args(Method)}
        return {
            "problem": self.name,
            "resampling": self.resampling,
            "about": self.about,
            "seed": self.seed,
            "replicates": len(self.values),
            "failed": self.failed,
            "statuses": dict(Counter(status for status in self.statuses if status)),
            "level": level,
            "quantities": {
                name: {
                    "unit": self.units[k],
                    "estimate": finite(float(self.estimate[k])),
                    "standard_error": finite(error[name]),
                    "fit_standard_error": finite(float(self.given_error[k])),
                    "bias": finite(bias[name]),
                    "acceleration": finite(float(self._acceleration[k])),
                    "at_bound": list(at_bound[name]),
                    **{method: _ends(found[name]) for method, found in intervals.items()},
                }
                for k, name in enumerate(self.names)
            },
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "seconds": self.seconds,
        }


def _is_at(value: float, bound: float) -> bool:
    return math.isfinite(bound) and abs(value - bound) <= CLOSE * max(abs(bound), abs(value))


def _ends(interval: tuple[float, float]) -> list[float | None] | None:
    return None if any(map(math.isnan, interval)) else [finite(end) for end in interval]


def interval_text(ends: Sequence[float | None] | None) -> str:
    """Return an interval of `Bootstrap.summary` as text."""
    if ends is None:
        return "-"
    low, high = ends
    if low is None:
        return "open" if high is None else f"below {number(high)}"
    return f"above {number(low)}" if high is None else f"{number(low)} to {number(high)}"


def bootstrap(  # noqa: PLR0913  (what is drawn, how often, and where)
    fit: Fit,
    resampling: Resampling | None = None,
    replicates: int = 1000,
    *,
    problem: AnyProblem | None = None,
    seed: int = 0,
    block: int = 1,
    method: Transcription | None = None,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: bool | Callable[[int, int], None] = True,
) -> Bootstrap:
    """Repeat a fit on data that are drawn anew, from its estimate, and return what its values spread over.

    ================
    ==================================================================================================
    ``"residuals"``   frequency responses: the fitted response with errors of the magnitudes that the residuals have, at
                      any frequency and any angle. Errors are taken as isotropic in the complex
                      plane and of one size, in proportion to what the criterion says (of one
                      relative size; of the given variances; by the coherence)
    ``"parametric"``  responses: the same with normal errors of the size of the residuals. Records:
    the fitted outputs
                      with white normal errors of the fitted, or given, covariance
    ``"points"``      responses: as many of the measured points, drawn with replacement. Nothing is taken of the errors
                      but their independence
    ``"blocks"``      records: the fitted outputs with errors that are correlated in time as the residuals are, and
                      from output to output. Residuals are whitened by the spectrum that the
                      standard errors use, drawn, and colored again
    ``"parts"``       sums: whole records or responses, drawn with replacement, and of parameters those that all share
    ================
    ==================================================================================================

    Percentile intervals of few points are too narrow: of 5 to 12 points they covered 85 to 94 %
    instead of 95. They are therefore widened, see `Bootstrap.interval`. The sum of relative errors
    (4.26) leaves some residuals close to zero, as errors are not, so that replicates of residuals
    scatter too little: widened percentile intervals of 5 to 24 points covered 90 to 95 %, those of
    normal errors 92 to 95 %, those of points 89 to 95 %. Of a pole that the data bound on one side
    alone they covered 91 to 93 %, BCa intervals 86 to 91, the standard error 84, a profile 95 to
    97: the answer says for which parameters. No transformation helps there, since percentile and
    BCa intervals are those of any function of the parameter (Efron 1987): bias and acceleration are
    estimated from replicates that say little of where the open side ends (DiCiccio and Efron 1996,
    Statistical Science 11). In time, of 400 samples with errors of correlation 0.8 from one to the
    next, percentile intervals covered 92 %, BCa intervals 91, the standard error 94 (300 repeats;
    the others 100 each, hence ± 2 %; all figures by ``benchmarks/bootstrap_coverage.py`` and
    ``benchmarks/profile_coverage.py``).

    Residuals are enlarged by what the fit took from them. Constants that an earlier fit gave with
    errors are drawn too. Every replicate is solved from the estimate: the spread of one minimum,
    not of the choice among several.

    Parameters
    ----------
    fit : Fit
    resampling : str, optional
        By default ``"parametric"`` for frequency responses and ``"blocks"`` for records.
    replicates : int
        A thousand give the ends of 95 % intervals to about a tenth of a standard error.
    problem : Problem or Sum, optional
        What was fitted; needed where it has ties, constraints, or values fixed by an earlier fit.
    seed : int
        The replicates do not depend on how many workers make them.
    block : int
        Samples of the blocks in which whitened residuals are drawn, all outputs together. One
        serves, unless errors come in bursts.
    method : Transcription, optional
        Of records, as in the fit.
    executor : concurrent.futures.Executor, optional
        What makes the replicates, as of `greybox.fit`.
    folder : str or Path, optional
        Where every replicate is kept as it is made, so that the same call goes on after whatever
        ended it.
    progress : bool or function
        As of `greybox.fit`.

    Raises
    ------
    ValueError
        For what cannot be drawn from these data, with the reason; and for a problem that is not the
        fit's.
    LookupError
        If a loaded fit does not know its model.
    RuntimeError
        When the executor has lost its workers.
    KeyboardInterrupt
        After Ctrl-C; with a folder the same call goes on.
    """
    began = time.perf_counter()
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate to begin from: {fit.status}.")
    if isinstance(replicates, bool) or not isinstance(replicates, int) or replicates < 2:
        raise ValueError(
            f"replicates is {replicates!r:.40}: give a whole number of at least 2, 1000 for intervals."
        )
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ValueError(f"seed is {seed!r:.40}: give a whole number of at least 0.")
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(
            f"executor is {executor!r:.60}: give an instance such as greybox.solve.WorkerPool(2)."
        )
    drawn = _resampling(fit, resampling)
    nlp = compiled_again(fit, problem, method)
    x = np.array([fit.estimate[name] for name in nlp.free])
    at_bound = np.array([{q.name: q.at_bound for q in fit.quantities}[name] for name in nlp.free])
    constants = sum(
        (c for c, _ in known_covariances(nlp)), np.zeros((len(nlp.names), len(nlp.names)))
    )
    constants = constants[len(x) :, len(x) :]
    if fit.records:
        runner, about = _of_records(nlp, x, fit.cost, drawn, seed, block)
    else:
        neighbors = []
        if drawn == "parametric":
            neighbors = [
                known and (known.correlation, known.scale) for known in assess(nlp, x).neighbors
            ]
        draws = response_draws(nlp, x, at_bound, constants, drawn, seed, neighbors)
        runner, about = response_replicates(nlp, draws, x), WORDS[drawn]
        if any(neighbors):
            about += " with their correlation along frequency"
    quantities = _Quantities(fit, nlp, only_shared=drawn == "parts")
    outcomes = _made(runner, replicates, executor, folder, progress)
    values = quantities.at(
        [outcomes[k] for k in range(replicates)],
        [runner.constants_of(k) for k in range(replicates)],
    )
    without = [outcomes[-1 - k] for k in range(runner.left_out)]
    statuses = tuple("" if outcomes[k].converged else outcomes[k].status for k in range(replicates))
    return Bootstrap(
        name=fit.name,
        resampling=drawn,
        about=about,
        seed=seed,
        names=tuple(q.name for q in quantities.lines),
        units=tuple(q.unit for q in quantities.lines),
        estimate=np.array([q.value for q in quantities.lines]),
        given_error=np.array([q.standard_error for q in quantities.lines]),
        values=values,
        statuses=statuses,
        left_out=quantities.at(without, [nlp.constant_values] * len(without)),
        bounds=np.array(
            [q.bounds if q.kind == "free" else (-math.inf, math.inf) for q in quantities.lines]
        ),
        dof=np.array([q.dof for q in quantities.lines]),
        warnings=tuple(_warnings(statuses, min(q.dof for q in quantities.lines))),
        seconds=time.perf_counter() - began,
    )


def _resampling(fit: Fit, asked: str | None) -> Any:
    """Return what is drawn, if these data allow it."""
    if fit.spectra:
        raise ValueError(
            f"the fit {fit.name!r} has manoeuvres, which are not drawn yet: use fit.interval()."
        )
    if any(part.is_prior for part in fit.parts):
        raise ValueError(
            f"the fit {fit.name!r} has a prior, which is not drawn: use fit.interval()."
        )
    if fit.records and fit.responses:
        raise ValueError(
            f"the fit {fit.name!r} has records and responses, which are drawn in no common way: use one."
        )
    in_time = bool(fit.records)
    allowed = (
        ("blocks", "parametric", "parts")
        if in_time
        else ("parametric", "residuals", "points", "parts")
    )
    if asked is None:
        return allowed[0]
    if asked not in get_args(Resampling):
        raise ValueError(
            f"resampling is {asked!r:.40}: give one of {', '.join(map(repr, get_args(Resampling)))}."
        )
    if asked not in allowed:
        data = "records" if in_time else "frequency responses"
        raise ValueError(
            f"resampling {asked!r} is not for {data}: give one of {', '.join(map(repr, allowed))}."
        )
    if asked == "parts" and len(fit.parts) < FEWEST_PARTS:
        raise ValueError(
            f"the fit {fit.name!r} has {counted(len(fit.parts), 'part')}, and parts are drawn from at least "
            f"{FEWEST_PARTS}: use resampling={allowed[0]!r}."
        )
    return asked


def _of_records(
    nlp: Nlp, x: Array, cost: float, resampling: Any, seed: int, block: int
) -> tuple[RecordReplicates, str]:
    """Return what makes the refits of records, and what is drawn in words."""
    if nlp.problem.held_estimates:
        names = ", ".join(nlp.problem.held_estimates)
        raise ValueError(
            f"{names} of {nlp.problem.name!r} came with errors of an earlier fit, which are compiled into records as "
            "constants: fit them along, or bootstrap that fit."
        )
    solver = solver_for(nlp)
    search = multistart(nlp, solver, x[None], movable=False)
    nlp, search, solver, _ = refine_discretization(nlp, search, solver)
    if (
        not search.minima
        or search.nodes is None
        or search.minima[0].cost > cost + same_cost(nlp, cost)
    ):
        raise ValueError(
            f"the fit of {nlp.problem.name!r} is not found again from its estimate: give its method=..."
        )
    x = search.minima[0].estimate
    trajectories = solver.profile(x, search.nodes).trajectories
    spectra: list[ErrorSpectrum | None] = [None] * len(nlp.parts)
    if resampling == "blocks":
        spectra = [each and each.spectrum for each in assess(nlp, x, trajectories).correlation]
    draws = record_draws(nlp, trajectories, spectra, resampling, seed, block)
    about = WORDS[resampling]
    if any(spectra):
        about += " with their correlation in time"
    if resampling == "blocks" and block > 1:
        about += f", in blocks of {block} samples"
    return RecordReplicates(nlp, draws, x, search.nodes), about


class _Quantities:
    """The quantities of an answer, of many estimates at once; those that `only_shared` parameters determine."""

    def __init__(self, fit: Fit, nlp: Nlp, *, only_shared: bool) -> None:
        """Compile tied and derived quantities as functions of all values."""
        found = {formula.name: formula for formula in formulas(nlp.problem)}
        symbols = ca.SX.sym("x", len(nlp.names))
        named = dict(zip(nlp.names, ca.vertsplit(symbols), strict=True))
        lines = [q for q in fit.quantities if q.kind != "fixed" and q.standard_error != 0]
        expressions = [
            ca.SX(found[q.name].evaluate(named)) if q.name in found else named[q.name]
            for q in lines
        ]
        if only_shared:
            everywhere = set.intersection(*({*part.parameters} for part in nlp.problem.parts))
            own = ca.vertcat(
                ca.SX(0, 1), *[named[name] for name in nlp.free if name not in everywhere]
            )
            keep = [not own.numel() or not ca.depends_on(e, own) for e in expressions]
            lines = [q for q, kept in zip(lines, keep, strict=True) if kept]
            expressions = [e for e, kept in zip(expressions, keep, strict=True) if kept]
            if not lines:
                raise ValueError(
                    f"the parts of {fit.name!r} share no parameter, so that none is left to draw them for."
                )
        self.lines = lines
        self._function = ca.Function("quantities", [symbols], [ca.vertcat(*expressions)])

    def at(self, outcomes: list[Outcome], constants: list[Array]) -> Array:
        """Return the values (r, q), NaN where a run failed."""
        if not outcomes:
            return np.zeros((0, len(self.lines)))
        points = [
            np.concatenate([o.estimate if o.converged else np.full(len(o.estimate), np.nan), c])
            for o, c in zip(outcomes, constants, strict=True)
        ]
        values = np.asarray(self._function(np.array(points).T)).T.copy()
        values[[not outcome.converged for outcome in outcomes]] = np.nan
        return values


def _made(
    runner: Any,
    replicates: int,
    executor: Executor | None,
    folder: str | Path | None,
    progress: bool | Callable[[int, int], None],
) -> dict[int, Outcome]:
    """Make the runs of all numbers, below zero those with an observation left out, and return what they leave."""
    numbers = [*range(replicates), *range(-1, -1 - runner.left_out, -1)]
    found: dict[int, Outcome] = {}
    with _kept(folder) as kept, listening(), _shown(len(numbers), progress) as report:
        try:
            memory = Memory() if kept is None else Memory(kept, packed(runner)[0])
            with responding(Response.STOP):
                # Apart, so that no batch has both.
                for some in (numbers[:replicates], numbers[replicates:]):
                    rows = ((k, np.array([float(k)])) for k in some)
                    for k, _, outcome in run_all(runner, rows, len(some), executor, memory):
                        found[k] = outcome
                        report(len(found), len(numbers))
            if take_interrupt():
                raise KeyboardInterrupt
        finally:
            if kept is not None:
                with responding(Response.FINISH):
                    kept.write()
    return found


@contextmanager
def _kept(folder: str | Path | None) -> Iterator[StoredRuns | None]:
    """Give the files that keep the replicates, None where nothing is kept."""
    if folder is None:
        yield None
        return
    with locked(Path(folder)):
        yield StoredRuns(Path(folder), "bootstrap")


@contextmanager
def _shown(
    count: int, progress: bool | Callable[[int, int], None]
) -> Iterator[Callable[[int, int], None]]:
    if callable(progress):
        yield progress
    elif not progress:
        yield lambda done, count: None
    else:
        with tqdm(total=count, disable=None, delay=2, unit="replicate", leave=False) as bar:
            yield lambda done, count: (bar.update(done - bar.n), None)[1]


def _warnings(statuses: tuple[str, ...], dof: float) -> Iterator[str]:
    failed = Counter(status for status in statuses if status)
    if failed.total() > MANY_FAILED * len(statuses):
        why = ", ".join(f"{count} {status}" for status, count in failed.most_common(3))
        yield (
            f"{failed.total()} of {len(statuses)} replicates failed ({why}), so that the tails of the others are not "
            "those of the estimate."
        )
    beyond = tail(0.95, dof)
    if beyond * len(statuses) < FEWEST_BEYOND:
        few = f"with {dof:.3g} degrees of freedom " if math.isfinite(dof) else ""
        yield (
            f"{few}{100 * beyond:.2g} % of the replicates lie beyond each end of a 95 % interval: "
            f"make {math.ceil(FEWEST_BEYOND / beyond / 100) * 100} instead of {len(statuses)}."
        )
