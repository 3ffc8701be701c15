"""Whether the answer is the global minimum, and the only one."""

from collections.abc import Iterator

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import Accuracy
from greybox.estimate.equivalent_minima import equivalent_estimates, said
from greybox.solve.minima import Multistart, agreeing_runs
from greybox.solve.outcome import TOO_COARSE

# Share of agreeing starts below which the best minimum is in doubt. On the paper's tables 75 to 100
# % of the starts reach it; one that only one start in ten finds may well hide another that none has
# found.
FEW_STARTS = 0.1

# Share of runs below which it is worth saying that the others failed: the majority.
MOST_RUNS = 0.5

# Relative difference of costs below which a second minimum is a rival. A sum of n relative errors
# is itself uncertain by 0.52 / √n of its size (they are Rayleigh distributed), which is 10 % for 24
# points: a tenth of that ranks nothing.
RIVAL_COST = 0.01

# Difference of negative log-likelihoods below which it is: at 3 the other minimum is twenty times
# less likely.
RIVAL_LIKELIHOOD = 3.0


def few_agreeing_starts(nlp: CompiledProblem, search: Multistart) -> Iterator[str]:
    """Say so where few starts reached the best minimum, or most failed."""
    count = len(search.brought)
    numbers = sum(part.numbers for part in nlp.parts)
    is_likelihood = any(part.is_likelihood for part in nlp.parts)
    agreeing = len(
        agreeing_runs(search.runs, search.minima, numbers=numbers, is_likelihood=is_likelihood)
    )
    if len(search.runs) == 1:
        yield "one start only: whether this is the global minimum is not known; use more starts."
    elif agreeing == 1 or agreeing < FEW_STARTS * count:
        yield f"only {agreeing} of {count} starts reached the best minimum: a better one may exist; use more starts."
    if search.converged < MOST_RUNS * count:
        yield f"only {search.converged} of {count} runs converged ({search.failures})."


def unfinished_runs(search: Multistart) -> Iterator[str]:
    """Name a run that ended at a lower cost than the answer, and did not converge."""
    best = search.minima[0].cost
    unfinished = [
        run
        for run in search.brought
        if not run.converged and run.status != TOO_COARSE and run.cost < best
    ]
    if unfinished:
        lowest = min(unfinished, key=lambda run: run.cost)
        yield (
            f"run {lowest.index} ended at a lower cost, {lowest.cost:.6g} instead of {best:.6g}, but did not converge "
            f"({lowest.status}): give it more iterations, solver_options={{'max_iter': ...}}, or start there."
        )


def rival_minima(nlp: CompiledProblem, search: Multistart) -> Iterator[str]:
    """Name another minimum that the data hardly tell from the best."""
    best = search.minima[0]
    is_likelihood = any(part.is_likelihood for part in nlp.parts)
    for other in search.minima[1:]:
        if is_likelihood and other.cost <= best.cost + RIVAL_LIKELIHOOD:
            excess = other.cost - best.cost
            yield f"another minimum with a different response is only exp({excess:.2g}) times less likely."
            return
        if not is_likelihood and 0 < other.cost <= best.cost * (1 + RIVAL_COST):
            percent = 100 * (other.cost / best.cost - 1)
            yield f"another minimum costs only {percent:.2g} % more and has a different response."
            return


def several_estimates_of_one_response(
    nlp: CompiledProblem, search: Multistart, accuracy: Accuracy
) -> Iterator[str]:
    """Say so where clearly different parameters give the best response, such as two lags that swap."""
    vectors = equivalent_estimates(nlp, search)
    if len(vectors) > 1 and not accuracy.combinations:
        yield said(nlp.free, vectors)


def discontinuous_costs(nlp: CompiledProblem) -> Iterator[str]:
    """Name delays at whose whole samples the cost is discontinuous, since a held input reaches an output directly."""
    delays = {
        name: pair
        for part in nlp.parts
        for name, pair in part.discontinuous_delays.items()
        if name in nlp.free
    }
    for name, (input_, output) in delays.items():
        yield (
            f"the held input {input_} reaches {output} directly, so the cost is discontinuous where {name} is a whole "
            f"number of samples: some start must lie in the right sample interval, and the standard error of {name} "
            "holds within that interval."
        )
