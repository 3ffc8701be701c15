"""Whether the answer is the global minimum, and the only one."""

from collections.abc import Iterator

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import Accuracy
from greybox.files.text_table import listed
from greybox.solve.minima import Multistart
from greybox.solve.runs import TOO_COARSE

# Difference of negative log-likelihoods up to which another minimum is a rival: at 3 it is twenty
# times less likely.
RIVAL_LIKELIHOOD = 3.0


def few_agreeing_starts(search: Multistart, agreeing: int) -> Iterator[str]:
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


def unfinished_runs(search: Multistart) -> Iterator[str]:
    """Name the run that ended at the lowest cost below the answer, but did not converge."""
    best = search.minima[0].cost
    # A run on too coarse an integration has a cost that no finer one would have.
    unfinished = [
        run
        for run in search.brought
        if not run.converged and run.status != TOO_COARSE and run.cost < best
    ]

    if unfinished:
        lowest = min(unfinished, key=lambda run: run.cost)
        yield (
            f"run {lowest.index} ended at a lower cost, {lowest.cost:.6g} instead of {best:.6g}, "
            f"but did not converge ({lowest.status}): give it more iterations "
            "(the option max_iter of the solver), or start there."
        )


def rival_minima(nlp: CompiledProblem, search: Multistart) -> Iterator[str]:
    """Warn of another minimum with a different response and nearly the same cost."""
    if len(search.minima) < 2:
        return
    best, rival = search.minima[:2]
    excess = rival.cost - best.cost
    if any(part.is_likelihood for part in nlp.parts):
        if excess <= RIVAL_LIKELIHOOD:
            yield (
                f"another minimum with a different response is only exp({excess:.2g}) times less "
                "likely."
            )
    # A sum of n relative errors is itself uncertain by 0.52 / √n of its size (they are Rayleigh
    # distributed), which is 10 % for 24 points: a tenth of that ranks nothing.
    elif 0 < rival.cost <= best.cost * 1.01:
        percent = 100 * excess / best.cost
        yield f"another minimum costs only {percent:.2g} % more and has a different response."


def several_estimates_of_one_response(
    nlp: CompiledProblem, search: Multistart, accuracy: Accuracy
) -> Iterator[str]:
    """Warn where clearly different parameters give the best response, as two lags that swap."""
    best = search.minima[0]
    if best.variants < 2 or accuracy.combinations:
        return

    ends = nlp.scaling.to_solver(search.runs.estimate[list(best.runs)])
    # Zero and 4e-9 s of a delay up to 0.05 s are one value.
    differs = np.ptp(ends, axis=0) > 0.05 * np.abs(ends).max(axis=0) + 1e-6
    names = listed([name for name, is_other in zip(nlp.free, differs, strict=True) if is_other])
    yield (
        f"at least {best.variants} clearly different parameter vectors give this same response: "
        f"{names} differ. Add an ordering constraint, such as constraints=[lambda p: p.T1 - p.T2], "
        "or fix a parameter to choose one of them."
    )


def discontinuous_costs(nlp: CompiledProblem) -> Iterator[str]:
    """Warn where the cost jumps at whole samples of a delay."""
    delays = {
        name: pair
        for part in nlp.parts
        for name, pair in part.discontinuous_delays.items()
        if name in nlp.free
    }
    for name, (input_, output) in delays.items():
        yield (
            f"the held input {input_} reaches {output} directly, so the cost is discontinuous "
            f"where {name} is a whole number of samples: some start must lie in the right sample "
            f"interval, and the standard error of {name} holds within that interval."
        )
