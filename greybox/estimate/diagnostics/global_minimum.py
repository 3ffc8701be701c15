"""Whether the answer is the global minimum, and the only one.

What came closest where no run converged, what blocks it, and what to try.
"""

import math

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import Accuracy, assess, propagate
from greybox.estimate.diagnostics.identifiability import not_determined
from greybox.files.arrays import Array
from greybox.files.text_table import Sentences, counted, listed, number
from greybox.solve.gauss_newton.kinks import AT_KINK
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import RIVAL, Multistart, best_unfinished, likelihood_unit
from greybox.solve.runs import CUT_SHORT, Run


def few_agreeing_starts(search: Multistart, agreeing: int) -> Sentences:
    """Warn where fewer than a tenth of the starts reached the best minimum, or most runs failed."""
    count = len(search.brought)
    if not agreeing:  # as `agreeing_runs` counts where the best is a response of zero
        yield (
            f"the model explains nothing: the cost {search.minima[0].cost:.6g} is that of a "
            "response of zero; narrow the start boxes or the bounds, or use more starts."
        )
        return
    if len(search.runs) == 1:
        yield "one start only: another minimum may be lower; use more starts."
    elif agreeing == 1 or agreeing < count / 10:
        yield (
            f"only {agreeing} of {count} starts reached the best minimum: a better one may exist; "
            "use more starts."
        )

    if search.converged < count / 2:
        yield f"only {search.converged} of {count} runs converged ({search.failures})."


def unfinished_runs(search: Multistart) -> Sentences:
    """Name the run that ended at the lowest cost below the answer, but did not converge."""
    best = search.minima[0].cost
    lowest = best_unfinished(search.brought)
    if lowest and lowest.cost < best:
        yield (
            f"run {lowest.index} ended at a lower cost, {lowest.cost:.6g} instead of {best:.6g}, "
            f"but did not converge ({lowest.status}): give it more iterations "
            "(the option max_iter of the solver), or start there."
        )


def minimum_at_kink(search: Multistart) -> Sentences:
    """Warn where the cost has a kink at the minimum."""
    run = search.runs[search.minima[0].runs[0]]
    if run.status.startswith(AT_KINK):
        yield (
            f"run {run.index} {run.status}: gradients beside its end differ and none is zero, as "
            "where a state or an input switches, a delay is a whole number of samples, or the "
            "steps of the integration are too long. The standard errors hold on one side only: use "
            "the profiles."
        )


def rival_minima(search: Multistart, accuracy: Accuracy) -> Sentences:
    """Warn of another minimum with a different response and nearly the same likelihood."""
    best, *others = search.minima
    nlp = accuracy.nlp
    unit = likelihood_unit(nlp, best.cost)
    errors = propagate(accuracy, np.eye(len(nlp.free), len(nlp.names)))
    # Initial states that the data hardly show may differ with equal parameters. Values within a
    # standard error say nothing else, as on both sides of the kink where a delay passes a sample.
    near = np.fmax(errors, 1e-3 * np.abs(best.estimate))
    for rival in others[:1]:
        excess = rival.cost - best.cost
        is_another = np.any(np.abs(rival.estimate - best.estimate) > near)
        if is_another and excess < RIVAL * unit:
            yield (
                f"another minimum with a different response has {math.exp(-excess / unit):.2g} "
                f"times the likelihood: {_values(nlp, rival.estimate)}."
            )


def several_estimates_of_one_response(search: Multistart, accuracy: Accuracy) -> Sentences:
    """Warn where clearly different parameters give the best response, as two lags that swap."""
    best = search.minima[0]
    if best.variants < 2 or accuracy.combinations:
        return

    nlp = accuracy.nlp
    ends = search.runs.estimate[list(best.runs)]
    away = np.abs(nlp.scaling.to_solver(ends) - nlp.scaling.to_solver(best.estimate))
    yield (
        f"at least {best.variants} clearly different parameter vectors give this same response, "
        f"also {_values(nlp, ends[away.max(axis=1).argmax()])}. Add an ordering constraint, "
        "such as constraints=[lambda p: p.T1 - p.T2], or fix a parameter to choose one of them."
    )


def _values(nlp: CompiledProblem, x: Array) -> str:
    """Return parameters x (p,) in words."""
    return listed([f"{name} = {number(value)}" for name, value in zip(nlp.free, x, strict=True)])


def discontinuous_costs(nlp: CompiledProblem) -> Sentences:
    """Warn where the cost jumps at whole samples of a delay."""
    delays = {
        name: pair
        for part in nlp.parts
        for name, pair in part.delays.items()
        if pair[1] and name in nlp.free
    }
    for name, (input_, output) in delays.items():
        yield (
            f"the held input {input_} reaches {output} directly, so the cost is discontinuous "
            f"where {name} is a whole number of samples: some start must lie in the right sample "
            f"interval, and the standard error of {name} holds within that interval."
        )


def failure_warnings(search: Multistart, solver: LocalSolver) -> Sentences:
    """Say how close the best run came, which parameters block it, and what to try."""
    run = best_unfinished(search.runs)
    if run is None:
        return

    yield (
        f"run {run.index} came closest, cost {run.cost:.6g} after "
        f"{counted(run.iterations, 'iteration')} ({run.status}); its values are no "
        f"estimate: {_cure(run)}."
    )
    # A run that was cut short says nothing about what blocks it.
    if run.status in CUT_SHORT:
        return
    nlp = solver.nlp
    limits = nlp.constraint(nlp.all_values(run.estimate)).full().ravel()
    for limit, value in zip(nlp.limits, limits, strict=True):
        if value < -1e-6:
            yield (
                f"{limit} is {value:.3g} in that run and must be at least 0: check its sign, or "
                "whether any values within the bounds meet all constraints."
            )
    nodes = search.ends[run.index] if search.ends else None
    try:
        profile = solver.profile(run.estimate, nodes)
        is_known = nodes is not None or profile.converged
        if not (is_known and all(t.finite for t in profile.trajectories)):
            return
        accuracy = assess(nlp, run.estimate, profile.trajectories)
    except np.linalg.LinAlgError:
        return

    for name in accuracy.at_bound:
        yield f"{name} ended at a bound in that run: widen it if the physics allow, or fix it."
    yield from not_determined(accuracy)


def _cure(run: Run) -> str:
    status = run.status.lower().replace("_", " ")
    if run.status in CUT_SHORT[1:]:
        return "give it more time"
    if "iterations" in status or "relaxations" in status:
        return "give it more iterations (the option max_iter of the solver)"
    return (
        "start elsewhere, narrow the start boxes, or fix parameters that the data do not determine"
    )
