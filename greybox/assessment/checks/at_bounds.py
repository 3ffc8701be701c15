"""Which parameters ended at a bound, and which constraints hold with equality."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings


def at_bounds(evidence: Evidence) -> Findings:
    """Name parameters at bounds, and active constraints; say which of them errors take as known."""
    accuracy, answer = evidence.accuracy, evidence.fit
    without_effect = [c.names[0] for c in accuracy.combinations if len(c.names) == 1]
    # Runs start above zero: an intensity that ends there is that of no noise. Where all do, `gusts`
    # compares likelihoods.
    sizes = accuracy.nlp.noise_sizes
    is_held = dict.fromkeys(accuracy.at_bound, True)
    if answer.directions is not None:
        is_known = answer.directions.is_known
        is_held |= zip(answer.names, is_known, strict=True)
    for name in accuracy.at_bound:
        if name in without_effect or name in sizes:
            continue
        q = answer.by_name[name]
        low, high = q.bounds
        side, bound = ("lower", low) if q.value - low < high - q.value else ("upper", high)
        cure = "widen the bound if the physics allow, or fix the parameter"
        if name.startswith("T_gust_"):
            # Gusts that last longer than those of the data bias the values.
            cure = f"gusts of less than a sample are white noise, process_noise={(name[7:],)}"
            if side == "upper":
                cure = "gusts that last as long as the record need a longer one"
        errors = "the other standard errors treat it as known there"
        if not is_held[name]:
            errors = (
                "the data would leave another parameter far less certain without this bound, so "
                "standard errors are those without it"
            )
        yield Finding(f"{name} ended at its {side} bound {bound:g}; {errors}: {cure}.")

    for limit in accuracy.active:
        yield Finding(f"{limit} holds with equality: standard errors treat it as known.")
