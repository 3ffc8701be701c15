"""The numbers of a fit as plain values, for JSON."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from greybox.estimate.verdict import verdict
from greybox.files.json_numbers import all_finite, finite
from greybox.solve.runs import SCREENED, Runs


def summary(result: Any, level: float = 0.95) -> dict[str, Any]:
    """Return what there is to say of a `Fit`; None for a number that is not known or not finite.

    Intervals are of this `level`. `Fit.to_dict` is the same.
    """
    parameters = [q for q in result.quantities if q.kind != "derived"]
    judged, runs = verdict(result), Runs.of(result.runs)
    return {
        "problem": result.name,
        "model": list(dict.fromkeys(part.label for part in result.parts)),
        "data": list(dict.fromkeys(part.data.name or part.name for part in result.parts)),
        "criterion": result.criterion,
        "rule": result.rule,
        "delay": result.delay,
        "starts": len(runs),
        "screened": int(np.count_nonzero(runs.stage == SCREENED)),
        "seed": result.seed,
        "converged": int(np.count_nonzero(runs.converged)),
        "agreeing": result.agreeing,
        "minima": len(result.minima),
        "cost": finite(result.cost),
        "costs": all_finite(result.costs),
        "status": result.status,
        "verdict": {"grade": judged.grade, "sentences": list(judged.sentences)},
        "estimate": all_finite(result.estimate),
        "best_effort": None if result.best_effort is None else all_finite(result.best_effort),
        "standard_error": all_finite(result.standard_error),
        "level": level,
        "interval": _pairs(result.interval(level)),
        "profiles": {} if result.profiles is None else result.profiles.intervals_in_words(),
        "dof": finite(result.dof),
        "covariance": {"names": list(result.names), "values": _rows(result.covariance)},
        "bounds": _pairs({q.name: q.bounds for q in parameters if q.kind == "free"}),
        "starts_box": _pairs({q.name: q.box for q in parameters if q.kind == "free"}),
        "unit": {q.name: q.unit for q in parameters},
        "fixed": all_finite({q.name: q.value for q in parameters if q.kind == "fixed"}),
        "tied": [q.name for q in parameters if q.kind == "tied"],
        "derived": all_finite(result.derived),
        "prior": {
            name: {
                "mean": mean,
                "standard_deviation": sigma,
                "share": finite(result.prior_share.get(name, math.nan)),
            }
            for name, (mean, sigma) in result.priors.items()
        },
        "outputs": [
            _output(part, name)
            for part in (*result.records, *result.spectra)
            for name in part.outputs
        ],
        "at_bound": [q.name for q in result.quantities if q.at_bound],
        "warnings": list(result.warnings),
        "notes": list(result.notes),
        "checksum": result.checksum,
        "seconds": result.seconds,
        "versions": dict(result.versions),
    }


def _pairs(values: Mapping[str, tuple[float, float]]) -> dict[str, list[float | None]]:
    return {name: [finite(low), finite(high)] for name, (low, high) in values.items()}


def _rows(matrix: Any) -> list[list[float | None]]:
    return [[finite(value) for value in row] for row in matrix.tolist()]


def _output(part: Any, name: str) -> dict[str, Any]:
    """Return how well an output of a record or a manoeuvre is fitted."""
    # The standard deviation of the residuals, given or estimated.
    noise = float(part.noise[part.outputs.index(name), part.outputs.index(name)])
    answer = {"part": part.name, "output": name, "unit": part.data.units.get(name, "")}
    return answer | {
        "fit_percent": finite(part.fit_percent(name)),
        "noise": finite(math.sqrt(noise)),
    }
