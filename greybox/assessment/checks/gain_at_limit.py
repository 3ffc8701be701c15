"""Whether a Kalman gain has reached the stability limit."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.compiled.kalman_gain import kalman_gain


def gain_at_limit(evidence: Evidence) -> Findings:
    """Warn where a Kalman gain has reached the stability limit."""
    for part, trajectory in zip(evidence.nlp.parts, evidence.accuracy.trajectories, strict=True):
        gain = kalman_gain(part)
        if gain and gain.is_at_limit(trajectory):
            yield Finding(
                f"the Kalman gain in {part.name!r} reached the stability limit, as if the data "
                "showed no process noise in a state that it corrects. The standard errors do not "
                "account for the limit and are too small: let it correct fewer states, or compare "
                "with OutputError().",
                "limit",
                part.name,
            )
