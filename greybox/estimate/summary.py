"""The numbers of a fit as plain values, for JSON."""

import math
from typing import Any

from greybox.data.json_numbers import all_finite, finite
from greybox.estimate.result import Fit, FittedRecord
from greybox.solve.outcome import SCREENED


def summary(result: Fit) -> dict[str, Any]:
    """Return names, counts, estimates and what there is to say; None for a number that is not known."""
    return {
        "problem": result.name,
        "criterion": result.criterion,
        "delay": result.delay,
        "starts": len(result.runs),
        "screened": sum(run.stage == SCREENED for run in result.runs),
        "seed": result.seed,
        "converged": sum(run.converged for run in result.runs),
        "agreeing": result.agreeing,
        "minima": len(result.minima),
        "cost": finite(result.cost),
        "costs": all_finite(result.costs),
        "status": result.status,
        "estimate": all_finite(result.estimate),
        "best_effort": None if result.best_effort is None else all_finite(result.best_effort),
        "standard_error": all_finite(result.standard_error),
        "derived": all_finite(result.derived),
        "outputs": [_output(part, name) for part in result.records for name in part.outputs],
        "at_bound": [q.name for q in result.quantities if q.at_bound],
        "warnings": list(result.warnings),
        "notes": list(result.notes),
        "checksum": result.checksum,
        "seconds": result.seconds,
        "versions": dict(result.versions),
    }


def _output(part: FittedRecord, name: str) -> dict[str, Any]:
    """Return how well an output of a record is fitted."""
    # The standard deviation of the residuals, given or estimated.
    noise = float(part.noise[part.outputs.index(name), part.outputs.index(name)])
    answer = {"part": part.name, "output": name, "unit": part.data.units.get(name, "")}
    return answer | {"fit_percent": finite(part.fit_percent(name)), "noise": finite(math.sqrt(noise))}
