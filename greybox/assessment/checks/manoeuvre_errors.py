"""Whether the errors of a manoeuvre look like turbulence, which may bias an estimate."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def manoeuvre_errors(evidence: Evidence) -> Findings:
    """Name manoeuvres whose errors look like turbulence, which may bias an estimate."""
    for information in evidence.accuracy.informations:
        if information.disturbed:
            yield Finding(
                f"the errors of {information.part.name!r} are larger in a part of the band, like "
                "those of turbulence, of noise of the outputs in equation error, or of a model "
                "that misses something. Intervals allow for the size of the errors, and not for a "
                "bias. For noise of the outputs, use OutputError(); in turbulence, "
                "EquationError(gusts=True) or, if that says the same, the record itself with "
                "PredictionError(process_noise=states) or PredictionError(disturbance={state: "
                "'colored'})."
            )
