"""Whether another minimum is nearly as likely."""

import math

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.arrays import Array
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import listed
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.covariance.accuracy import propagate
from greybox.engine.solve.minima import RIVAL, likelihood_unit


def rival_minima(evidence: Evidence) -> Findings:
    """Warn of another minimum with a different response and nearly the same likelihood."""
    best, *others = evidence.search.found.minima
    nlp = evidence.nlp
    unit = likelihood_unit(nlp, best.cost)
    errors = propagate(evidence.accuracy, np.eye(len(nlp.free), len(nlp.names)))
    # Initial states that the data hardly show may differ with equal parameters. Values within a
    # standard error say nothing else, as on both sides of the kink where a delay passes a sample.
    near = np.fmax(errors, 1e-3 * np.abs(best.estimate))
    for rival in others[:1]:
        excess = rival.cost - best.cost
        is_another = np.any(np.abs(rival.estimate - best.estimate) > near)
        if is_another and excess < RIVAL * unit:
            yield Finding(
                f"another minimum with a different response has {math.exp(-excess / unit):.2g} "
                f"times the likelihood: {_values(nlp, rival.estimate)}."
            )


def _values(nlp: CompiledProblem, x: Array) -> str:
    """Return parameters x (p,) in words."""
    return listed([f"{name} = {number(value)}" for name, value in zip(nlp.free, x, strict=True)])
