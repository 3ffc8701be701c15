"""Frequency responses predicted by fits that have not seen them: over frequencies, or one part of a sum at a time.

Points at one frequency are left out together, in all parts, since errors of one test are alike
there. A part that is left out may have parameters of its own, which no other part tells of: these
are estimated from it, at the values that the others give to what is shared.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from greybox.compiled.compiled_problem import AnyProblem
from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.files.text_table import counted, number
from greybox.formulation.problem import Problem
from greybox.formulation.sum import Sum
from greybox.modeling.periodic_motions import response_of_test
from greybox.statistics.metrics import rms
from greybox.validation.common_likelihood import has_responses_alone
from greybox.validation.comparison import FREQUENCIES, PARTS, SIGNIFICANT, Row, p_text

FEWEST_FOLDS = 2
FEWEST_FREQUENCIES = (
    5  # at which a mean difference is tested: with fewer the threshold of Student's t is above 2.8
)


def cross_validation(
    fits: Sequence[Fit], labels: Sequence[str], folds: int | str
) -> tuple[list[Row], list[str]]:
    """Return measures of the predictions of left-out points by every fit, and sentences on pairs of them.

    Raises
    ------
    ValueError
        For records, folds out of range, and a fit whose problem cannot be stated again.
    """
    if not all(map(has_responses_alone, fits)):
        raise ValueError(
            "folds are for frequency responses alone: hold records out by records=[...]."
        )
    problems = [problem_of(fit) for fit in fits]
    if folds == PARTS:
        each = zip(fits, problems, labels, strict=True)
        predicted = [_parts_left_out(fit, problem, label) for fit, problem, label in each]
        kind = PARTS
    else:
        left_out = _folds(fits[0], folds)
        predicted = [
            _frequencies_left_out(fit, problem, left_out)
            for fit, problem in zip(fits, problems, strict=True)
        ]
        kind = FREQUENCIES
    measured = [part.data.response for part in fits[0].responses]
    errors = [
        np.concatenate([np.abs(p / m - 1) for p, m in zip(of_fit, measured, strict=True)])
        for of_fit, _ in predicted
    ]
    own = [float(count) for _, count in predicted]
    rows = [
        Row(kind, "", "sum of relative errors", "", _known(float(e.sum()) for e in errors)),
        Row(kind, "", "relative error (rms)", "%", _known(100 * rms(e) for e in errors)),
    ]
    if any(own):
        rows.append(Row(kind, "", "values estimated from what is left out", "", tuple(own)))
    omega = np.concatenate([part.data.omega for part in fits[0].responses])
    return rows, list(_verdicts(errors, labels, omega, kind))


def _known(values: Iterable[float]) -> tuple[float | None, ...]:
    return tuple(value if math.isfinite(value) else None for value in values)


def _folds(fit: Fit, folds: int | str) -> list[list[BoolArray]]:
    """Return for every fold which points of every part it leaves out: every `folds`-th frequency."""
    omega = np.unique(np.concatenate([part.data.omega for part in fit.responses]))
    if (
        not isinstance(folds, int)
        or isinstance(folds, bool)
        or not FEWEST_FOLDS <= folds <= len(omega)
    ):
        raise ValueError(
            f"folds is {folds!r}: give a number from {FEWEST_FOLDS} to {len(omega)}, the number of frequencies, or "
            f"{PARTS!r} to leave out one response at a time."
        )
    found = []
    for k in range(folds):
        left_out = [np.isin(part.data.omega, omega[k::folds]) for part in fit.responses]
        if any(out.all() for out in left_out):
            raise ValueError(
                f"folds is {folds}: one of them leaves no point of a response; give more folds."
            )
        found.append(left_out)
    return found


def _frequencies_left_out(
    fit: Fit, problem: AnyProblem, folds: Sequence[Sequence[BoolArray]]
) -> tuple[list[ComplexArray], int]:
    """Return the predicted responses of all parts, each point by the fit without its fold."""
    predicted = [np.full(len(part.data), np.nan, dtype=complex) for part in fit.responses]
    for left_out in folds:
        kept = [
            part.with_(data=part.response.where(~out), amplitude=_sine(part, ~out))
            for part, out in zip(problem.parts, left_out, strict=True)
        ]
        found = _refitted(problem.with_parts(kept), fit)
        for values, part, out in zip(predicted, problem.parts, left_out, strict=True):
            if found is not None and out.any():
                values[out] = _response(part, found.estimate)[out]
    return predicted, 0


def _parts_left_out(fit: Fit, problem: AnyProblem, label: str) -> tuple[list[ComplexArray], int]:
    """Return the responses of all parts, each predicted by the fit to the others, and how many values were its own."""
    if len(problem.parts) < FEWEST_FOLDS:
        raise ValueError(
            f"{label} has one response, which cannot be left out: give folds as a number."
        )
    predicted, count = [], 0
    for k, part in enumerate(problem.parts):
        others = [other for i, other in enumerate(problem.parts) if i != k]
        shared = {name for other in others for name in other.parameters}
        of_part = {
            part.outside(name): name for name in part.declared if part.outside(name) in fit.free
        }
        if not shared & set(of_part):
            raise ValueError(
                f"{part.name!r} of {label} shares no free parameter with the other parts, which then say nothing of it."
            )
        found = _refitted(Sum(tuple(others)) if len(others) > 1 else others[0], fit)
        own = {outside for outside in of_part if outside not in shared}
        count += len(own)
        values = {} if found is None else {**fit.estimate, **found.estimate}
        if own and found is not None:
            held = {
                inside: values[outside] for outside, inside in of_part.items() if outside not in own
            }
            alone = _refitted(part.with_(fixed={**part.fixed_values, **held}), fit)
            values = {} if alone is None else {**values, **alone.estimate}
        predicted.append(
            _response(part, values) if values else np.full(len(part.data), np.nan, dtype=complex)
        )
    return predicted, count


def _refitted(problem: AnyProblem, fit: Fit) -> Fit | None:
    """Return the fit from the estimate of another one, which is near; None where it fails."""
    start = {name: fit.estimate[name] for name, p in problem.parameters.items() if not p.fixed}
    found = fit_problem(problem, [start], profiles=False, progress=False)
    return found if found.converged else None


def _sine(part: Problem, kept: BoolArray) -> object:
    sine = part.amplitude
    if sine is None or not np.ndim(sine.amplitude):
        return sine
    return replace(sine, amplitude=np.asarray(sine.amplitude)[kept])


def _response(part: Problem, values: dict[str, float]) -> ComplexArray:
    data = part.response
    inside = {name: values[part.outside(name)] for name in part.model.parameters}
    signals = {"input": data.input, "output": data.output, "at": part.at, "delay": part.delay}
    try:
        return response_of_test(
            part.model, inside, data.omega, part.amplitude, data.omega, **signals
        ).response
    except ValueError:  # no operating point, or a pole on a frequency
        return np.full(len(data), np.nan, dtype=complex)


def _verdicts(errors: Sequence[Array], labels: Sequence[str], omega: Array, kind: str) -> list[str]:
    """Compare the relative errors of left-out points in pairs, by the mean over all points of a frequency."""
    from scipy.special import stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    said = []
    _, group = np.unique(omega, return_inverse=True)
    counts = np.bincount(group)
    what = "left-out frequencies" if kind == FREQUENCIES else "responses that were left out"
    for a in range(len(errors)):
        for b in range(a + 1, len(errors)):
            failed = [labels[i] for i in (a, b) if not np.all(np.isfinite(errors[i]))]
            if failed:
                said.append(
                    f"{' and '.join(failed)} could not be fitted without some of the points."
                )
                continue
            difference = np.bincount(group, errors[b] - errors[a]) / counts
            n, spread = (
                len(difference),
                float(np.std(difference, ddof=1)) if len(difference) > 1 else 0.0,
            )
            sizes = [f"{number(100 * rms(errors[i]), 3)} %" for i in (a, b)]
            if n < FEWEST_FREQUENCIES or not spread > 0:
                said.append(
                    f"{labels[a]} and {labels[b]} predict {what} to {sizes[0]} and {sizes[1]} rms."
                )
                continue
            t = float(difference.mean()) / (spread / math.sqrt(n))
            p = float(2 * stdtr(n - 1, -abs(t)))
            if p >= SIGNIFICANT:
                said.append(
                    f"It cannot be told which of {labels[a]} and {labels[b]} predicts {what} better: {sizes[0]} and "
                    f"{sizes[1]} rms ({p_text(p)})."
                )
                continue
            better, worse = (a, b) if t > 0 else (b, a)
            better_size, worse_size = sizes if t > 0 else sizes[::-1]
            share = int(np.sum(np.sign(difference) == np.sign(t)))
            said.append(
                f"{labels[better]} predicts {what} better than {labels[worse]}, to {better_size} rms against "
                f"{worse_size}, at {share} of {counted(n, 'frequency', 'frequencies')} ({p_text(p)})."
            )
    return said
