"""Which parameters the data determine, alone or in combination; whether they contradict priors."""

import math

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import Accuracy
from greybox.estimate.identifiability import Combination
from greybox.estimate.result import Fit
from greybox.files.arrays import unique
from greybox.files.text_table import Sentences, counted, listed, number, with_error
from greybox.modeling.symbolic_reading import RAMP, switching_parameters


def not_determined(accuracy: Accuracy) -> Sentences:
    """Name the combinations that the data determine poorly or not at all, the worst three first."""
    absent = accuracy.nlp.noise_sizes & set(accuracy.at_bound)
    combinations = [c for c in accuracy.combinations if not set(c.names) <= absent]
    # Infinite indices first: without them fixed, no standard error exists.
    combinations.sort(key=lambda c: -c.index)
    switching = _switching(accuracy.nlp) if combinations else set()
    for combination in combinations[:3]:
        if len(combination.names) == 1 and combination.names[0] in switching:
            yield (
                f"{combination.names[0]} is not determined: it enters the model only through a "
                "switch or a rounding, which has no slope that a solver could follow, so its value "
                f"is that of a start. {RAMP}"
            )
        elif math.isinf(combination.index):
            yield _not_determined(combination)
        else:
            yield (
                f"{listed(combination.names)} are poorly identifiable: their effects nearly cancel "
                f"one another (collinearity index {combination.index:.0f}); fix one of them, or "
                "add data in which their effects differ."
            )

    if len(combinations) > 3:
        names = dict.fromkeys(name for c in combinations[3:] for name in c.names)
        yield (
            f"{counted(len(combinations) - 3, 'more combination')} of parameters are determined "
            f"poorly or not at all, of {listed(tuple(names))}; the table of identifiability "
            "shows them."
        )


def determined_together(fit: Fit) -> Sentences:
    """Say which combinations are determined although none of their members is."""
    combinations = () if fit.directions is None else fit.identifiability.combinations
    if not combinations:
        return

    members = unique(name for c in combinations for name in c.names)
    remaining = f" and {len(combinations) - 3} more" if len(combinations) > 3 else ""
    yield (
        f"{'; '.join(map(str, combinations[:3]))}{remaining}: determined together, although "
        f"{listed(members)} are not; the table of identifiability shows how well each "
        "is."
    )


def _switching(nlp: CompiledProblem) -> set[str]:
    """Return the unknowns that the formulas contain only where they have no slope."""
    return {
        part.outside(name)
        for part in nlp.problem.parts
        for name in switching_parameters(part.model)
    }


def _not_determined(combination: Combination) -> str:
    """Name parameters without an effect, or with effects only in combination; say what to fix."""
    names, count = combination.names, combination.directions
    if len(names) == 1 and not combination.states:
        return (
            f"{names[0]} is not determined: it does not change the response to these data at this "
            "estimate. If no equation uses it, remove it; else fix it, or try starts at which it "
            "does."
        )

    cure = f"fix {names[0]}" if len(names) == 1 else f"fix {'one' if count == 1 else count} of them"
    if combination.states:
        cure += f", or give a known initial state, initial={{{combination.states[0]!r}: ...}}"

    combined = "a combination" if count == 1 else "combinations"
    return (
        f"{listed(combination.members)} are not determined: at this estimate the data depend only "
        f"on {combined} of them, so no standard error is given; {cure}."
    )


def held_without_error(accuracy: Accuracy) -> Sentences:
    """Name values fixed at an earlier fit that gives them no standard error."""
    nlp = accuracy.nlp
    variances = np.diag(accuracy.covariance)[len(nlp.free) :]
    held = nlp.problem.held_estimates
    pairs = zip(nlp.constants, variances, strict=True)
    unknown = [name for name, variance in pairs if name in held and np.isnan(variance)]
    if unknown:
        yield (
            f"the earlier fit gives {listed(unknown)} no standard error, so none can be given "
            "here; fix it at a number to treat it as known."
        )


def no_degrees_of_freedom(nlp: CompiledProblem) -> Sentences:
    """Warn where the data have no more numbers than the fit has unknowns."""
    numbers = nlp.numbers
    initial = sum(part.unknown_initial_states for part in nlp.parts)
    if numbers > len(nlp.free) + initial:
        return

    states = f" and {counted(initial, 'initial state')}" if initial else ""
    leave = "leaves" if numbers == 1 else "leave"
    yield (
        f"{counted(numbers, 'real number')} of data for "
        f"{counted(len(nlp.free), 'unknown')}{states} {leave} no degrees of freedom, so that no "
        "standard error is known: add data."
    )


def at_bounds(answer: Fit, accuracy: Accuracy) -> Sentences:
    """Name parameters at bounds, and active constraints; say which of them errors take as known."""
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
        yield f"{name} ended at its {side} bound {bound:g}; {errors}: {cure}."

    for limit in accuracy.active:
        yield f"{limit} holds with equality: standard errors treat it as known."


def prior_conflicts(fit: Fit) -> Sentences:
    """Warn of parameters that the data moved further than their priors allow.

    If prior and data agree, the shift of the mean is normal, and its variance is that of the prior
    less that of the estimate. Source: Evans and Moshonov (2006), Checking for prior-data conflict,
    Bayesian Analysis 1(4), for normal densities.
    """
    for name, (mean, sigma) in fit.priors.items():
        q = fit.by_name[name]
        moved = sigma**2 - q.standard_error**2
        # An error beyond that of the prior has grown with the residuals that a conflict leaves.
        spread = math.sqrt(moved) if moved > 0 else sigma
        deviations = abs(q.value - mean) / spread
        if deviations > 3:
            value, deviation = with_error(mean, sigma)
            yield (
                f"the data contradict the prior of {name}, {value} ± {deviation}: the estimate "
                f"{number(q.value)} is {number(deviations, 2)} standard deviations "
                "away. Check the prior and the model."
            )
