"""Whether clearly different parameters give the same response."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.arrays import Array
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import listed
from greybox.engine.compiled.compiled_problem import CompiledProblem


def several_estimates(evidence: Evidence) -> Findings:
    """Warn where clearly different parameters give the best response, as two lags that swap."""
    search = evidence.search.found
    best = search.minima[0]
    if best.variants < 2 or evidence.accuracy.combinations:
        return

    nlp = evidence.nlp
    ends = search.runs.estimate[list(best.runs)]
    away = np.abs(nlp.scaling.to_solver(ends) - nlp.scaling.to_solver(best.estimate))
    yield Finding(
        f"at least {best.variants} clearly different parameter vectors give this same response, "
        f"also {_values(nlp, ends[away.max(axis=1).argmax()])}. Add an ordering constraint, "
        "such as constraints=[lambda p: p.T1 - p.T2], or fix a parameter to choose one of them."
    )


def _values(nlp: CompiledProblem, x: Array) -> str:
    """Return parameters x (p,) in words."""
    return listed([f"{name} = {number(value)}" for name, value in zip(nlp.free, x, strict=True)])
