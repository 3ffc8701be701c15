"""Whether the harmonics of a sine test are enough for the noise."""

from dataclasses import replace

import numpy as np

from greybox.compiled.response_part import ResponsePart
from greybox.estimate.checks.evidence import Evidence
from greybox.estimate.checks.finding import Finding, Findings
from greybox.files.arrays import by_name
from greybox.files.text_table import counted
from greybox.modeling.harmonic_balance import directly_found
from greybox.modeling.sine import MOST_HARMONICS
from greybox.statistics.metrics import rms


def few_harmonics(evidence: Evidence) -> Findings:
    """Warn if more harmonics would change the estimate `x` (p,) noticeably, or cannot be tried."""
    nlp = evidence.nlp
    values = nlp.all_values(evidence.x)
    named = by_name(nlp.names, values.tolist())
    for part in nlp.parts_of(ResponsePart):
        problem, sine = part.problem, part.problem.amplitude
        if sine is None or not sine.harmonics:
            continue
        more = min(2 * sine.harmonics + 3, MOST_HARMONICS)
        few = part.response(values)
        many, _ = directly_found(
            problem.model,
            dict(problem.local_values(named)),
            part.data.omega,
            replace(sine, harmonics=more),
            **problem.signals,
        )
        lost = np.isnan(many)
        change = np.where(lost, 0.0, np.abs(many / few - 1))
        noise = rms(np.abs(part.data.response / few - 1))
        # A shift matters above a tenth of a standard error, which adds 0.5 % to the root mean
        # square error.
        if np.linalg.norm(change) > max(0.1 * noise, 1e-7):
            count = counted(sine.harmonics, "harmonic is", "harmonics are")
            yield Finding(
                f"{count} too few for {problem.name!r}: with {more} the response changes by up to "
                f"{100 * change.max():.2g} %; use Sine({sine.signal!r}, ..., harmonics={more})."
            )
        if lost.any():
            yield Finding(
                f"with {more} harmonics no motion was found at {lost.sum()} of {lost.size} "
                f"frequencies of {problem.name!r}: whether {sine.harmonics} are enough there is "
                "not known."
            )
