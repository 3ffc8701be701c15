"""Which parameters the data determine, and which the answer treats as known."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import Accuracy, Combination
from greybox.files.text_table import counted, listed, text_table
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.realization import has_branches
from greybox.solve.minima import Minimum

# Combinations that get a sentence each; more of them become one table.
FEW_COMBINATIONS = 3


def not_determined(nlp: CompiledProblem, accuracy: Accuracy) -> Iterator[str]:
    """Name the combinations of parameters that the data determine poorly or not at all."""
    absent = _absent_noise(nlp, accuracy)
    every = [c for c in accuracy.combinations if not set(c.names) <= absent]
    invisible = [c for c in every if math.isinf(c.index)]
    collinear = sorted((c for c in every if not math.isinf(c.index)), key=lambda c: -c.index)
    if len(every) > FEW_COMBINATIONS:
        yield _table(nlp, [*invisible, *collinear])
        return
    for combination in invisible:
        yield _not_determined(nlp, combination)
    for combination in collinear:
        yield (
            f"{listed(combination.names)} are poorly identifiable: their effects nearly cancel one another "
            f"(collinearity index {combination.index:.0f}); fix one of them, or add data in which their effects differ."
        )


def _not_determined(nlp: CompiledProblem, combination: Combination) -> str:
    """Name the parameters of one group that the data do not see, and what to fix."""
    names, count = combination.names, combination.directions
    branch = _inactive_branch(nlp, names)
    if len(names) == 1 and not combination.states:
        return (
            f"{names[0]} is not determined: it does not change the response to these data at this estimate; "
            f"fix it{branch}."
        )
    members = [*names, *(f"the initial state of {name}" for name in combination.states)]
    cure = f"fix {names[0]}" if len(names) == 1 else f"fix {'one' if count == 1 else count} of them"
    if combination.states:
        cure += f", or give a known initial state, initial={{{combination.states[0]!r}: ...}}"
    combined = "a combination" if count == 1 else "combinations"
    return (
        f"{listed(members)} are not determined: at this estimate the data depend only on {combined} of them, so no "
        f"standard error is given; {cure}{branch}."
    )


def _table(nlp: CompiledProblem, combinations: Sequence[Combination]) -> str:
    """Return all combinations as one table, what the data do not see at all first."""
    rows = []
    for combination in combinations:
        members = [*combination.names, *(f"initial state of {name}" for name in combination.states)]
        seen = "no effect" if len(members) == 1 else "invisible"
        index = seen if math.isinf(combination.index) else f"{combination.index:.0f}"
        free = str(combination.directions)
        rows.append([index, free, ", ".join(members)])
    table = text_table(["collinearity", "directions", "parameters"], rows, left=(0, 2))
    names = dict.fromkeys(name for c in combinations for name in c.names if math.isinf(c.index))
    without = f"; {listed(tuple(names))} have no standard error" if names else ""
    return (
        f"the data determine {counted(len(rows), 'combination')} of parameters poorly or not at all{without}: fix as "
        f"many parameters of each as it has directions, or add data in which their effects differ"
        f"{_inactive_branch(nlp, tuple(names))}.\n"
        + "\n".join("    " + line for line in table.splitlines())
    )


def _inactive_branch(nlp: CompiledProblem, names: tuple[str, ...]) -> str:
    """Return another cure, where a model of these parameters has branches."""
    models = [
        part.model
        for part in nlp.problem.parts
        if any(part.outside(declared) in names for declared in part.declared)
    ]
    if not any(has_branches(model) for model in models):
        return ""
    return (
        ", unless it acts in a branch or beyond a limit of the model (gb.where, gb.minimum, gb.maximum) that is not "
        "active at this estimate: then try starts at which it is active"
    )


def _absent_noise(nlp: CompiledProblem, accuracy: Accuracy) -> set[str]:
    """Return the sizes of process noise that ended at zero, where they have no effect to first order."""
    sizes = {
        part.outside(f"w_{state}")
        for part in nlp.problem.parts
        if isinstance(part.criterion, TimeCriterion)
        for state in part.criterion.driven()
    }
    return sizes & set(accuracy.at_bound)


def held_without_error(nlp: CompiledProblem, accuracy: Accuracy) -> Iterator[str]:
    """Name values held from an earlier fit that gives them no standard error."""
    errors = np.diag(accuracy.covariance)[len(nlp.free) :]
    held = nlp.problem.held_estimates
    unknown = [
        name for name, e in zip(nlp.constants, errors, strict=True) if name in held and np.isnan(e)
    ]
    if unknown:
        yield (
            f"the earlier fit gives {listed(unknown)} no standard error, so none can be given here; "
            "fix it at a number to treat it as known."
        )


def no_degrees_of_freedom(nlp: CompiledProblem) -> Iterator[str]:
    """Say so where there are not more numbers than unknowns."""
    numbers = sum(part.numbers for part in nlp.parts)
    initial = sum(part.unknown_initial_states for part in nlp.parts)
    if numbers > len(nlp.free) + initial:
        return
    states = f" and {counted(initial, 'initial state')}" if initial else ""
    leave = "leaves" if numbers == 1 else "leave"
    yield (
        f"{counted(numbers, 'real number')} of data for {counted(len(nlp.free), 'unknown')}{states} {leave} no degrees "
        "of freedom, so that no standard error is known: add data."
    )


def at_bounds(nlp: CompiledProblem, best: Minimum, accuracy: Accuracy) -> Iterator[str]:
    """Name parameters at their bounds and constraints that hold with equality; both are treated as known."""
    without_effect = [c.names[0] for c in accuracy.combinations if len(c.names) == 1]
    absent = _absent_noise(nlp, accuracy)
    if absent:
        yield (
            f"these data show no process noise of the size {listed(sorted(absent))}, which ended at zero: OutputError, "
            "or process_noise without it, says as much with fewer unknowns."
        )
    for name in accuracy.at_bound:
        if name in without_effect or name in absent:
            continue
        k = nlp.free.index(name)
        at_lower = best.estimate[k] - nlp.lower[k] < nlp.upper[k] - best.estimate[k]
        side = "lower" if at_lower else "upper"
        bound = nlp.lower[k] if at_lower else nlp.upper[k]
        yield (
            f"{name} ended at its {side} bound {bound:g}; the other standard errors treat it as known there: "
            "widen the bound if the physics allow, or fix the parameter."
        )
    for limit in accuracy.active:
        yield f"{limit} holds with equality: standard errors treat it as known."
