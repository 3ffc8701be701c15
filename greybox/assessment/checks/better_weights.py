"""Whether other weights of the parts would give clearly smaller errors."""

import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.data.files.wording import some


def better_weights(evidence: Evidence) -> Findings:
    """Note the weights of parts with which standard errors are clearly smaller.

    The cost weights errors as if they were independent and as large as given. Where they are not,
    the variance of a part's score, its meat, exceeds its bread. With each part's bread over its
    meat as its weight, parts count by their information.
    """
    accuracy = evidence.accuracy
    # No weight could account for the misfit of a wrong model.
    if not accuracy.parts or not evidence.is_explained:
        return
    bread = np.array([errors.bread for errors in accuracy.parts])
    # A part may determine nothing.
    paid = np.linalg.trace(bread) + 1e-300
    variance = np.array([np.trace(errors.meat) for errors in accuracy.parts])
    # Correlation adds no information.
    weight = paid / np.maximum(variance, paid)
    better = np.linalg.inv(np.tensordot(weight, bread, 1))
    gain = np.sqrt(variance.sum() / max(np.trace(better), 1e-300))
    # A factor on standard errors: records of 60 samples with white errors have up to 1.1.
    if gain > 1.25:
        weights = [
            f"{part.weight * share:.2g} for {part.name!r}"
            for part, share in zip(accuracy.nlp.parts, weight, strict=True)
            if share < 0.5  # one is below 0.3, or the gain is smaller
        ]
        yield Finding(
            "some parts have too much weight, because their errors are correlated or exceed the "
            f"given noise: with Problem(..., weight=...) of {some(weights)}, standard errors "
            f"would be about {gain:.2g} times smaller.",
            is_note=True,
        )
