"""The bootstrap: a fit is repeated on data that are drawn anew; the spread is the error.

Begin with `bootstrap`. Sources: Efron and Tibshirani (1993), An
Introduction to the Bootstrap; Davison and Hinkley (1997), Bootstrap Methods and their Application.
"""

import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from greybox.assessment.fitted_problem import compiled_again
from greybox.assessment.quantities import quantity_function
from greybox.assessment.response_band import t_quantile
from greybox.assessment.result import Fit, Quantity, require_fit
from greybox.data.files.argument_checks import require_whole
from greybox.data.files.arrays import Array, Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.json_numbers import plain
from greybox.data.files.numbers_in_text import number
from greybox.data.files.printed import Printed
from greybox.data.files.progress import bar
from greybox.data.files.public import public
from greybox.data.files.spelling import alternatives
from greybox.data.files.text_table import text_table, titled
from greybox.data.files.wording import counted, some
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.covariance.covariance import accuracy_at
from greybox.engine.solve.discretization_error import refine_discretization
from greybox.engine.solve.executors import require_executor, run_all
from greybox.engine.solve.interruption import (
    Interrupted,
    Response,
    listening,
    responding,
    take_interrupt,
)
from greybox.engine.solve.minima import same_cost
from greybox.engine.solve.multistart import ProgressReport, multistart
from greybox.engine.solve.run_storage import Memory
from greybox.engine.solve.runs import Outcomes
from greybox.engine.solve.search_method import solver_for
from greybox.modeling.cached_property import cached_property
from greybox.workflows.study.record_replicates import RecordReplicates, record_draws
from greybox.workflows.study.replicates import Replicates
from greybox.workflows.study.response_replicates import ResponseReplicates, response_draws
from greybox.workflows.study.stored_runs import StoredRuns
from greybox.workflows.study.study_lock import locked

# Relative distance within which a replicate counts as being at a bound: IPOPT's barrier keeps
# estimates this far from it.
BARRIER = 1e-4

# Ratio of the two sides of an interval above which the data bound a parameter on one side only.
# Intervals of poles far above the band reached at least 2.5 times as far to one side as to the
# other, those of lags and of the tilt model at most 2.1 times (`benchmarks/bootstrap_coverage.py`).
ASYMMETRIC = 2.5

# Share of failed replicates that is reported. Replicates may fail because their estimates lie far
# out: beyond twice the share of a tail of a 95 % interval, the tails of the others say little.
MANY_FAILED = 0.05

# Replicates beyond an end of an interval that leave this end uncertain by a quarter of a standard
# error.
FEWEST_IN_TAIL = 4


@public
@frozen
class Bootstrap(Printed):
    """Replicates of an estimate; printed, they are a table of errors and intervals.

    Attributes
    ----------
    name : str
        Name of the problem.
    about : str
        Description of the draws.
    seed : int
    quantities : tuple of Quantity
        Free and tied parameters, then derived quantities, with their estimates and standard errors
        of the fit.
    values : (b, q) array
        One row for each replicate; NaN where it failed.
    statuses : tuple of str
        Why each replicate failed; empty for the others.
    warnings : tuple of str
    seconds : float

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=5)
    >>> samples = gb.bootstrap(fit, replicates=4, progress=False)
    >>> samples.values.shape
    (4, 5)
    """

    name: str
    about: str
    seed: int
    quantities: tuple[Quantity, ...]
    values: Array
    statuses: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities."""
        return tuple(q.name for q in self.quantities)

    @cached_property
    def columns(self) -> Mapping[str, Array]:
        """Return the values of every quantity in the replicates that did not fail."""
        return dict(zip(self.names, self._successful.T, strict=True))

    def __getitem__(self, name: str) -> Array:
        """Return the values of a quantity in the replicates that did not fail."""
        if name not in self.columns:
            raise KeyError(
                f"{name!r} has no replicates; there are {alternatives(name, self.names)}"
            )
        return self.columns[name]

    @property
    def failed(self) -> int:
        """Number of replicates that failed."""
        return len(self.values) - len(self._successful)

    @property
    def standard_error(self) -> dict[str, float]:
        """Standard deviations of the replicates by name; NaN for less than two."""
        return {
            name: float(values.std(ddof=1)) if values.size > 1 else math.nan
            for name, values in self.columns.items()
        }

    @property
    def bias(self) -> dict[str, float]:
        """Means of the replicates minus the estimates, by name; NaN without replicates."""
        return {
            q.name: float(self[q.name].mean() - q.value) if len(self._successful) else math.nan
            for q in self.quantities
        }

    def interval(self, level: float = 0.95) -> dict[str, Interval]:
        """Return percentile intervals by name: quantiles of the replicates; NaN without replicates.

        A side on which the replicates reach the bound of a parameter is infinite. Source:
        Hesterberg (2015), What teachers should know about the bootstrap, The American Statistician
        69 (the expanded percentile interval).
        """
        # Replicates do not show how well the size of the errors is known. The quantiles therefore
        # lie as far out as those of Student's t with the degrees of freedom of the fit.
        intervals = {}
        for q in self.quantities:
            values = self[q.name]
            share = tail(level, q.dof)
            low = high = math.nan
            if values.size and math.isfinite(share):
                low, high = np.quantile(values, [share, 1 - share]).tolist()
            lower, upper = q.bounds
            if math.isclose(low, lower, rel_tol=BARRIER):
                low = -math.inf
            if math.isclose(high, upper, rel_tol=BARRIER):
                high = math.inf
            intervals[q.name] = (low, high)
        return intervals

    @property
    def notes(self) -> tuple[str, ...]:
        """Remark on the parameters that the data bound on one side only."""
        names = []
        intervals = self.interval()
        for q in self.quantities:
            low, high = intervals[q.name]
            shorter, longer = sorted((q.value - low, high - q.value))
            if longer > ASYMMETRIC * max(shorter, 0.0):
                names.append(q.name)
        if not names:
            return ()
        return (
            f"the replicates of {some(names)} reach much farther to one side. Percentile intervals "
            "of such parameters covered 91 to 93 % instead of 95 %, profiles 95 to 97 %: "
            "profile these if the criterion allows it.",
        )

    @cached_property
    def _successful(self) -> Array:
        return self.values[np.isfinite(self.values).all(axis=1)]

    def __str__(self) -> str:
        return self.text()

    def text(self, level: float = 0.95) -> str:
        """Return errors and intervals as a table."""
        failed = f", {self.failed} failed" if self.failed else ""
        title = f"{self.name}: bootstrap, {self.about}; "
        title += f"{counted(len(self.values), 'replicate')}{failed}"
        header = ["", "estimate", "± error", "± fit", "bias", "unit", f"{100 * level:g} % interval"]
        rows = []
        for name, q in self.summary(level)["quantities"].items():
            rows.append(
                [
                    name,
                    number(q["estimate"]),
                    number(q["standard_error"], 3),
                    number(q["fit_standard_error"], 3),
                    number(q["bias"], 2),
                    q["unit"],
                    interval_text(q["interval"]),
                ]
            )
        lines = [text_table(header, rows, left=(0, 5, 6)), ""]
        lines += [f"warning: {text}" for text in self.warnings]
        lines += [f"note: {text}" for text in self.notes]
        return titled(title, [*lines, f"{self.seconds:.2f} s; seed {self.seed}"])

    def summary(self, level: float = 0.95) -> dict[str, Any]:
        """Return plain values for JSON, without the replicates; None for an open or unknown end."""
        error = self.standard_error
        bias = self.bias
        intervals = self.interval(level)
        quantities = {}
        for q in self.quantities:
            low, high = intervals[q.name]
            is_known = not (math.isnan(low) or math.isnan(high))
            quantities[q.name] = {
                "unit": q.unit,
                "estimate": q.value,
                "standard_error": error[q.name],
                "fit_standard_error": q.standard_error,
                "bias": bias[q.name],
                "interval": (low, high) if is_known else None,
            }
        return plain(
            {
                "problem": self.name,
                "about": self.about,
                "seed": self.seed,
                "replicates": len(self.values),
                "failed": self.failed,
                "statuses": Counter(status for status in self.statuses if status),
                "level": level,
                "quantities": quantities,
                "warnings": self.warnings,
                "notes": self.notes,
                "seconds": self.seconds,
            }
        )


def tail(level: float, dof: float) -> float:
    """Return the share of normal replicates beyond each end of an interval of Student's t."""
    from scipy.special import ndtr  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(ndtr(-t_quantile(level, dof)))


def interval_text(ends: Sequence[float | None] | None) -> str:
    """Return an interval of `Bootstrap.summary` as text."""
    if ends is None:
        return "-"
    low, high = ends
    if low is None:
        return "open" if high is None else f"below {number(high)}"
    return f"above {number(low)}" if high is None else f"{number(low)} to {number(high)}"


@public
def bootstrap(  # noqa: PLR0913  (what to repeat, how, and where it is kept)
    fit: Fit,
    replicates: int = 1000,
    *,
    problem: AnyProblem | None = None,
    seed: int = 0,
    method: Transcription | None = None,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: bool | ProgressReport = True,
    trust: bool = False,
) -> Bootstrap:
    """Repeat a fit on data that are drawn anew, and return the spread of its estimates.

    Data of responses are the fitted response plus normal errors with the size of the residuals and
    their correlation along frequency. Data of records are the fitted outputs plus drawn residuals:
    these are whitened by the spectrum that the standard errors use, drawn, and colored again.

    Residuals are enlarged for the degrees of freedom of the fit. Constants from an earlier fit are
    drawn too, with their covariance. Every replicate is solved from the estimate: the spread is
    that of one minimum and does not include a choice among several.

    Percentile intervals from 5 to 24 points covered 92 to 95 %; those of a pole that the data bound
    on one side only covered 91 to 93 %. In time, with errors of correlation 0.8, they covered 92 %
    (± 2 %, by ``benchmarks/bootstrap_coverage.py``).

    Parameters
    ----------
    fit : Fit
    replicates : int
        With a thousand, the ends of 95 % intervals are known to a tenth of a standard error.
    problem : Problem or Sum, optional
        The fitted problem; needed if it has ties, constraints, or values fixed by an earlier fit.
    seed : int
        The seed determines the replicates; the number of workers does not matter.
    method : Transcription, optional
        The method of the fit, for records.
    executor : concurrent.futures.Executor, optional
        Makes the replicates, as in `greybox.fit`.
    folder : str or Path, optional
        Stores every replicate: after an interruption of any kind the same call resumes.
    progress : bool or function
        As in `greybox.fit`.
    trust : bool
        Continue with replicates in the folder that another user or another machine made.

    Raises
    ------
    ValueError
        If these data cannot be drawn, the problem is not the fitted one, or another user made
        replicates in the folder, without `trust`.
    LookupError
        If a loaded fit does not know its model.
    RuntimeError
        If the executor has lost its workers.
    KeyboardInterrupt
        After Ctrl-C, with the replicates so far in its attribute ``samples``; with a folder the
        same call resumes.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> samples = gb.bootstrap(fit, replicates=100, progress=False)
    >>> low, high = samples.interval(0.95)["a1"]
    >>> low < fit.estimate["a1"] < high
    True
    """
    began = time.perf_counter()
    require_fit(fit)
    fit.require_estimate()
    require_whole("replicates", replicates, 2)
    require_whole("seed", seed, 0)
    require_executor(executor)
    _require_drawable(fit)
    nlp = compiled_again(fit, problem, method)
    runner = _refits(fit, nlp, seed)
    # Fixed values, and what follows from them alone, are the same in every replicate.
    quantities = [q for q in fit.quantities if q.kind != "fixed" and q.standard_error != 0]
    function = quantity_function(nlp, [q.name for q in quantities])

    outcomes: Outcomes = []
    # A replicate is its number: workers draw the data themselves, so that the result does not
    # depend on how many there are.
    rows = ((k, np.array([float(k)])) for k in range(replicates))
    runs = None if folder is None else StoredRuns(Path(folder), "bootstrap")
    lock = nullcontext() if folder is None else locked(Path(folder), trust=trust)
    progress_bar = bar(is_shown=progress is True, total=replicates, unit="replicate")
    with lock, listening(), progress_bar:
        try:
            memory = Memory(runs, runner)
            with responding(Response.STOP):
                for _, _, outcome in run_all(runner, rows, replicates, executor, memory):
                    outcomes.append(outcome)
                    progress_bar.update()
                    if callable(progress):
                        progress(len(outcomes), replicates)
            interrupted = take_interrupt()
        finally:
            if runs is not None:
                runs.write()
    if not outcomes:
        raise KeyboardInterrupt
    # Derived quantities follow from the drawn constants too, so that their errors are included.
    points = []
    for k, outcome in enumerate(outcomes):
        constants, _ = runner.draws.of(k)
        points.append(np.append(outcome.estimate, constants))
    values = np.asarray(function(np.array(points).T)).T.copy()
    # Where a refit failed, its last point says nothing about the estimate.
    values[[not outcome.converged for outcome in outcomes]] = np.nan
    statuses = tuple("" if outcome.converged else outcome.status for outcome in outcomes)
    samples = Bootstrap(
        name=fit.name,
        about=runner.draws.about,
        seed=seed,
        quantities=tuple(quantities),
        values=values,
        statuses=statuses,
        warnings=tuple(replicate_warnings(statuses, min(q.dof for q in quantities))),
        seconds=time.perf_counter() - began,
    )
    if interrupted:
        raise Interrupted(
            f"interrupted after {counted(len(outcomes), 'replicate')}; they are "
            "sys.last_value.samples in a notebook, and the attribute samples of this exception",
            samples=samples,
        )
    return samples


def _require_drawable(fit: Fit) -> None:
    """Raise ValueError for a fit whose data cannot be drawn."""
    obstacles = {
        "manoeuvres, which are not drawn yet": fit.spectra,
        "a prior, which is not drawn": any(part.is_prior for part in fit.parts),
        "records and responses, which cannot be drawn together": fit.records and fit.responses,
        "residuals that correct its states, which cannot be drawn and added": any(
            part.gains for part in fit.records
        ),
    }
    for obstacle, is_present in obstacles.items():
        if is_present:
            raise ValueError(
                f"the fit {fit.name!r} has {obstacle}: use the standard errors; if there are none, "
                "its warnings say what to do."
            )


def _accuracy(nlp: CompiledProblem, x: Array, trajectories: Sequence[Trajectory]) -> Accuracy:
    """Return the accuracy at the estimate x (p,); raise ValueError without degrees of freedom."""
    accuracy = accuracy_at(nlp, x, trajectories)
    if not accuracy.parts:
        raise ValueError(
            f"the data of {nlp.problem.name!r} are too few for the size of their errors: "
            "fix parameters."
        )
    return accuracy


def _refits(fit: Fit, nlp: CompiledProblem, seed: int) -> Replicates:
    """Return the object that draws data and fits them again."""
    x = fit.minima[0].estimate
    if not fit.records:
        return ResponseReplicates(nlp, response_draws(_accuracy(nlp, x, ()), seed), x)
    if nlp.problem.held_estimates:
        names = ", ".join(nlp.problem.held_estimates)
        raise ValueError(
            f"{names} of {nlp.problem.name!r} came with errors of an earlier fit, which are "
            "compiled into records as constants: fit them too, or bootstrap that fit."
        )
    # A fit has no states at the nodes: one run from the estimate finds them again.
    solver = solver_for(nlp)
    search = multistart(solver, x[None])
    search, solver, _ = refine_discretization(search, solver)
    nlp = solver.nlp
    # Replicates start from the estimate: if it were no minimum, all of them would move away from
    # it, and the spread would show that move.
    highest = fit.cost + same_cost(nlp, fit.cost)
    if not search.minima or search.nodes is None or search.minima[0].cost > highest:
        raise ValueError(
            f"the estimate of {nlp.problem.name!r} is not a minimum with this method: give the "
            "method of the fit, method=..."
        )

    x = search.minima[0].estimate
    trajectories = solver.profile(x, search.nodes).trajectories
    draws = record_draws(_accuracy(nlp, x, trajectories), seed)
    return RecordReplicates(nlp, draws, x, search.nodes)


def replicate_warnings(statuses: tuple[str, ...], dof: float) -> Iterator[str]:
    """Warn of many failed replicates, and of too few replicates for an interval."""
    failed = Counter(status for status in statuses if status)
    if failed.total() > MANY_FAILED * len(statuses):
        reasons = ", ".join(f"{count} {status}" for status, count in failed.most_common(3))
        yield (
            f"{failed.total()} of {len(statuses)} replicates failed ({reasons}): the others may "
            "lack the tails of the distribution."
        )
    share = tail(0.95, dof)
    needed = FEWEST_IN_TAIL / share
    if len(statuses) < needed:
        condition = f"with {dof:.3g} degrees of freedom " if math.isfinite(dof) else ""
        hundreds = math.ceil(needed / 100)
        cure = f"make {100 * hundreds} instead of {len(statuses)}"
        # A hundred thousand replicates would take hours.
        if needed > 1e5:
            cure = "take a profile instead, gb.profile or greybox profile"
        yield (
            f"{condition}{100 * share:.2g} % of the replicates lie beyond each end of a 95 % "
            f"interval: {cure}."
        )
