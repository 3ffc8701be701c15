"""Whether the Padé approximation of a delay is accurate enough over the fitted band."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def coarse_pade(evidence: Evidence) -> Findings:
    """Warn of a phase error beyond one degree, the effect of noise of 1.7 % in each component."""
    for part in evidence.fit.responses:
        if part.pade_error is not None and part.pade_error > 1.0:
            yield Finding(
                f"the phase error of {part.delay} reaches {part.pade_error:.2g}° in the band of "
                f"{part.name!r}: use a higher order or delay='exact'."
            )
