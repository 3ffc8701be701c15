"""The numbers of a fit as plain values, for JSON."""

import math
from typing import Any

import numpy as np

from greybox.estimate.verdict import verdict
from greybox.files.json_numbers import plain
from greybox.solve.runs import SCREENED, Runs


def summary(result: Any, level: float = 0.95) -> dict[str, Any]:
    """Return the numbers of a `Fit`; None for one that is unknown or not finite."""
    parameters = [q for q in result.quantities if q.kind != "derived"]
    free = [q for q in parameters if q.kind == "free"]
    runs, misfit = Runs.of(result.runs), result.misfit
    named = ("criterion", "rule", "delay", "seed", "agreeing", "cost", "costs", "status")
    named += ("estimate", "best_effort", "standard_error", "derived", "dof")
    named += ("warnings", "notes", "checksum", "seconds", "versions")
    answer = {
        "problem": result.name,
        "model": list(dict.fromkeys(part.label for part in result.parts)),
        "data": list(dict.fromkeys(part.data.name or part.name for part in result.parts)),
        **{name: getattr(result, name) for name in named},
        "starts": len(runs),
        "screened": int(np.count_nonzero(runs.stage == SCREENED)),
        "converged": int(np.count_nonzero(runs.converged)),
        "minima": len(result.minima),
        "verdict": verdict(result),
        "misfit": misfit
        and vars(misfit) | {"explains": misfit.explains, "p_value": misfit.p_value},
        "level": level,
        "interval": result.interval(level),
        "profiles": {} if result.profiles is None else result.profiles.intervals_in_words(),
        "covariance": {"names": result.names, "values": result.covariance},
        "bounds": {q.name: q.bounds for q in free},
        "starts_box": {q.name: q.box for q in free},
        "unit": {q.name: q.unit for q in parameters},
        "fixed": {q.name: q.value for q in parameters if q.kind == "fixed"},
        "tied": [q.name for q in parameters if q.kind == "tied"],
        "at": {name: x for part in result.responses for name, x in part.at.items()},
        "prior": {
            name: {
                "mean": mean,
                "standard_deviation": sigma,
                "share": result.prior_share.get(name, math.nan),
            }
            for name, (mean, sigma) in result.priors.items()
        },
        "outputs": [
            {
                "part": part.name,
                "output": name,
                "unit": part.data.units.get(name, ""),
                "fit_percent": part.fit_percent(name),
                # The diagonal of the covariance of the residuals, given or estimated.
                "noise": math.sqrt(part.noise[k, k]),
            }
            for part in (*result.records, *result.spectra)
            for k, name in enumerate(part.outputs)
        ],
        "responses": [
            {"part": part.name, "magnitude_phase_cost": part.magnitude_phase_cost}
            for part in result.responses
        ],
        "at_bound": [q.name for q in result.quantities if q.at_bound],
    }
    return plain(answer)
