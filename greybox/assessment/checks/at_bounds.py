"""Which parameters ended at a bound, and which constraints hold with equality."""

from collections.abc import Iterable

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.engine.compiled.part import Part
from greybox.modeling.colored_disturbance import ColoredDisturbance, named
from greybox.modeling.disturbance import GUST_TIME, FirstOrderGust


def at_bounds(evidence: Evidence) -> Findings:
    """Name parameters at bounds, and active constraints; say which of them errors take as known."""
    accuracy, answer = evidence.accuracy, evidence.fit
    without_effect = [c.names[0] for c in accuracy.combinations if len(c.names) == 1]
    # Runs start above zero: an intensity that ends there is that of no noise. Where all do, `gusts`
    # compares likelihoods.
    sizes = accuracy.nlp.noise_sizes
    gust_times = _gust_times(accuracy.nlp.parts)
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
        if name in gust_times:
            # Gusts that last longer than those of the data bias the values.
            state = gust_times[name]
            cure = f"gusts of less than a sample are white noise, process_noise={(state,)}"
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


def _gust_times(parts: Iterable[Part]) -> dict[str, str]:
    """Return the disturbed state of every time constant of a gust, by the parameter's name."""
    result = dict[str, str]()
    for part in parts:
        model = part.problem.model
        if not isinstance(model, ColoredDisturbance):
            continue
        for state, color in model.disturbances.items():
            if isinstance(color, FirstOrderGust):
                result[part.problem.outside(named(GUST_TIME, state))] = state
    return result
