"""Frequency responses predicted by fits that have not seen them: every n-th frequency is left out.

Points at one frequency are left out together, in all parts, since errors of one test are alike
there.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import AnyProblem
from greybox.estimate.fit import fit as fit_problem
from greybox.estimate.fitted_problem import problem_of
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, BoolArray, ComplexArray
from greybox.files.text_table import counted, number
from greybox.formulation.problem import Problem
from greybox.modeling.periodic_motions import response_of_test
from greybox.statistics.metrics import rms
from greybox.validation.common_likelihood import has_responses_alone
from greybox.validation.comparison import FREQUENCIES, SIGNIFICANT, Row, p_text


def cross_validation(
    fits: Sequence[Fit], labels: Sequence[str], folds: int
) -> tuple[list[Row], list[str]]:
    """Return measures of the predictions of left-out frequencies, and a sentence on every pair.

    Raises
    ------
    ValueError
        For records, folds out of range, and a fit whose problem cannot be stated again.
    """
    if not all(map(has_responses_alone, fits)):
        raise ValueError(
            "folds are for frequency responses alone: hold records out by records=[...]."
        )
    left_out = _folds(fits[0], folds)
    measured = np.concatenate([part.data.response for part in fits[0].responses])
    predicted = [_predicted(fit, problem_of(fit), left_out) for fit in fits]
    errors = [np.abs(values / measured - 1) for values in predicted]
    measures = {
        ("sum of relative errors", ""): [float(e.sum()) for e in errors],
        ("relative error (rms)", "%"): [100 * rms(e) for e in errors],
    }
    rows = [
        Row(FREQUENCIES, "", measure, unit, tuple(v if math.isfinite(v) else None for v in values))
        for (measure, unit), values in measures.items()
    ]
    omega = np.concatenate([part.data.omega for part in fits[0].responses])
    pairs = combinations(zip(labels, errors, strict=True), 2)
    return rows, [pair_verdict(*first, *second, omega) for first, second in pairs]


def _folds(fit: Fit, folds: int) -> list[list[BoolArray]]:
    """Return for every fold which points of every part it leaves out."""
    omega = np.unique(np.concatenate([part.data.omega for part in fit.responses]))
    if not isinstance(folds, int) or not 2 <= folds <= len(omega):
        raise ValueError(
            f"folds is {folds!r}: give a number from 2 to {len(omega)}, the number of frequencies."
        )
    left_out = [
        [np.isin(part.data.omega, omega[k::folds]) for part in fit.responses] for k in range(folds)
    ]
    if any(points.all() for fold in left_out for points in fold):
        raise ValueError(
            f"folds is {folds}: one of them leaves no point of a response; give more folds."
        )
    return left_out


def _predicted(fit: Fit, problem: AnyProblem, folds: Sequence[Sequence[BoolArray]]) -> ComplexArray:
    """Return the responses of all parts, each point by the fit without its fold, NaN without one."""
    predicted = [np.full(len(part.data), np.nan, dtype=complex) for part in fit.responses]
    start = {name: fit.estimate[name] for name in fit.free}
    for fold in folds:
        stored = [_without(part, points) for part, points in zip(problem.parts, fold, strict=True)]
        refit = fit_problem(problem.with_parts(stored), [start], profiles=False, progress=False)
        for values, part, points in zip(predicted, problem.parts, fold, strict=True):
            if refit.converged and points.any():
                values[points] = _response(part, refit)[points]
    return np.concatenate(predicted)


def _without(part: Problem, points: BoolArray) -> Problem:
    sine = part.amplitude
    if sine is not None and np.ndim(sine.amplitude):
        sine = replace(sine, amplitude=np.asarray(sine.amplitude)[~points])
    return part.with_(data=part.response.where(~points), amplitude=sine)


def _response(part: Problem, fit: Fit) -> ComplexArray:
    data = part.response
    inside = {name: fit.estimate[part.outside(name)] for name in part.model.parameters}
    signals = {"input": data.input, "output": data.output, "at": part.at, "delay": part.delay}
    try:
        return response_of_test(
            part.model, inside, data.omega, part.amplitude, data.omega, **signals
        ).response
    except ValueError:  # no operating point, or a pole on a frequency
        return np.full(len(data), np.nan, dtype=complex)


def pair_verdict(first: str, errors: Array, second: str, rivals: Array, omega: Array) -> str:
    """Compare the relative errors of two fits, by their mean over all points of a frequency."""
    from scipy.stats import ttest_1samp  # noqa: PLC0415  (takes long to import)

    failed = [n for n, e in ((first, errors), (second, rivals)) if not np.all(np.isfinite(e))]
    if failed:
        return f"{' and '.join(failed)} could not be fitted without some of the points."
    _, group = np.unique(omega, return_inverse=True)
    difference = np.bincount(group, rivals - errors) / np.bincount(group)
    sizes = {
        first: f"{number(100 * rms(errors), 3)} %",
        second: f"{number(100 * rms(rivals), 3)} %",
    }
    both = " and ".join(sizes.values())
    # With fewer than five frequencies the threshold of Student's t is above 2.8.
    if len(difference) < 5 or not np.ptp(difference) > 0:
        return f"{first} and {second} predict left-out frequencies to {both} rms."
    test: Any = ttest_1samp(difference, 0)  # scipy does not declare its attributes
    if test.pvalue >= SIGNIFICANT:
        return (
            f"It cannot be told which of {first} and {second} predicts left-out frequencies better: "
            f"{both} rms ({p_text(test.pvalue)})."
        )
    better, worse = (first, second) if test.statistic > 0 else (second, first)
    share = int(np.sum(np.sign(difference) == np.sign(test.statistic)))
    count = counted(len(difference), "frequency", "frequencies")
    return (
        f"{better} predicts left-out frequencies better than {worse}, to {sizes[better]} rms against "
        f"{sizes[worse]}, at {share} of {count} ({p_text(test.pvalue)})."
    )
