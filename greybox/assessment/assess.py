"""The third of the three steps of a fit: what its checks find, the misfit, and profiles."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from greybox.assessment.checks.data_findings import findings_of_data
from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.failure import failure
from greybox.assessment.checks.finding import Finding, once
from greybox.assessment.checks.included import CHECKS, Check
from greybox.assessment.misfit.assessment import assessed_misfit
from greybox.assessment.profile import with_profiles_where_misleading
from greybox.assessment.result import Fit
from greybox.assessment.wrapped_outputs import wrapped
from greybox.engine.solve.not_finite import not_finite_warnings
from greybox.modeling.one_thread import one_thread_at_a_time


@one_thread_at_a_time
def assess(evidence: Evidence, checks: Sequence[Check] = CHECKS, *, profiles: bool = True) -> Fit:
    """Return the fit with its misfit, the findings of all checks, and profiles.

    A failed search is explained, whatever the checks; a search that was cut short says so.
    """
    fit, cut_short = evidence.fit, tuple(evidence.search.cut_short())
    if not fit.converged:
        return replace(fit, warnings=(*cut_short, *_explained_failure(evidence)))

    left_out = tuple(check.__name__ for check in CHECKS if check not in checks)
    if not checks:
        return replace(fit, warnings=cut_short, left_out=left_out)

    evidence = replace(evidence, fit=_with_misfit(evidence))
    findings = [finding for check in checks for finding in once(check(evidence))]
    fit = replace(
        evidence.fit,
        warnings=tuple(finding.text for finding in findings if not finding.is_note),
        notes=tuple(finding.text for finding in findings if finding.is_note),
        left_out=left_out,
    )
    # A search that was cut short has no time for profiles.
    if profiles and not cut_short:
        fit = with_profiles_where_misleading(evidence.nlp, fit)
    return replace(fit, warnings=(*cut_short, *fit.warnings))


def _with_misfit(evidence: Evidence) -> Fit:
    """Return the fit with what its residuals say of the model."""
    accuracy = evidence.accuracy
    misfit = assessed_misfit(
        evidence.nlp,
        evidence.x,
        accuracy.trajectories,
        accuracy.at_bound,
        {},
    )
    return replace(evidence.fit, misfit=misfit)


def _explained_failure(evidence: Evidence) -> tuple[str, ...]:
    """Return why no run converged."""
    search = evidence.search
    return (
        *wrapped(evidence.fit),
        *not_finite_warnings(search.nlp, search.found),
        *_texts(failure(search)),
        *_texts(once(findings_of_data(search.nlp))),
    )


def _texts(findings: Iterable[Finding]) -> tuple[str, ...]:
    return tuple(finding.text for finding in findings)
