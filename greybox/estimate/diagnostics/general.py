"""What a careful colleague would say about an answer: warnings in sentences."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.part import Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.text_table import counted
from greybox.estimate.covariance import Accuracy
from greybox.formulation.problem import Problem
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import has_branches
from greybox.solve.minima import Minimum, Multistart

PHASE_LIMIT = 1.0  # degrees of Padé error over the fitted band
FEW = 0.1  # share of agreeing starts below which the minimum is in doubt
NEAR = 0.01  # relative distance of costs below which a second minimum is a rival
CLOSE = 3.0  # negative log-likelihood: twenty times less likely
NOISY = 0.1  # relative noise from which the bias of the measured normalization shows


def warnings(
    nlp: Nlp,
    search: Multistart,
    accuracy: Accuracy,
    pade_errors: list[float | None],
    trajectories: Sequence[Trajectory | None] = (),
) -> tuple[str, ...]:
    """Return everything a reader should know before believing the estimate, most serious first."""
    return (
        *_undetermined(nlp, accuracy),
        *_unknown_constants(nlp, accuracy),
        *_size(nlp),
        *_bounds(nlp, search.minima[0], accuracy),
        *(f"{limit} holds with equality: the errors take it as exact." for limit in accuracy.active),
        *_agreement(nlp, search),
        *_variants(search, accuracy),
        *_pade(nlp, pade_errors),
        *_noise(nlp, search.minima[0], accuracy),
        *_record_noise(nlp, trajectories),
        *_jumps(nlp),
    )


def pade_error(part: Problem, values: dict[str, float]) -> float | None:
    """Return the largest phase error (degrees) of a Padé delay over the fitted band; None with exact delay."""
    if delay_order(part.delay) is None:
        return None
    data = part.response
    omega = np.unique(np.concatenate([np.geomspace(data.omega.min(), data.omega.max(), 200), data.omega]))
    signals = {"input": data.input, "output": data.output, "at": part.at}
    exact = frequency_response(part.model, values, omega, **signals)
    approximate = frequency_response(part.model, values, omega, **signals, delay=part.delay)
    return float(np.degrees(np.abs(np.angle(approximate.response / exact.response))).max())


def _undetermined(nlp: Nlp, accuracy: Accuracy) -> Iterator[str]:
    for combination in sorted(accuracy.combinations, key=lambda c: -c.index):
        names = _listed(combination.names)
        if math.isinf(combination.index) and len(combination.names) == 1:
            yield (
                f"{names} is not determined: it does not change the response to these data at this estimate at all; "
                f"fix it{_inactive(nlp, combination.names)}."
            )
        elif math.isinf(combination.index):
            yield (
                f"{names} are not determined: at this estimate the data see only a combination of them, so no standard "
                f"error is given; fix one of them{_inactive(nlp, combination.names)}."
            )
        else:
            yield (
                f"{names} are hardly determined: the Jacobian is nearly rank deficient, since changes of them "
                f"compensate one another (collinearity index {combination.index:.0f}); fix one of them or add data "
                "that tell them apart."
            )


def _inactive(nlp: Nlp, names: tuple[str, ...]) -> str:
    """Return what to do besides where a model of these parameters has branches."""
    parts = [part for part in nlp.problem.parts if any(part.rename.get(n, n) in names for n in part.declared)]
    if not any(has_branches(part.model) for part in parts):
        return ""
    return (
        ", unless it acts in a branch or beyond a limit of the model (gb.where, gb.minimum, gb.maximum) that is not "
        "active at this estimate: then try starts at which it is active"
    )


def _unknown_constants(nlp: Nlp, accuracy: Accuracy) -> Iterator[str]:
    errors = np.diag(accuracy.covariance)[len(nlp.free) :]
    held = nlp.problem.held_estimates
    unknown = tuple(name for name, e in zip(nlp.constants, errors, strict=True) if name in held and np.isnan(e))
    if unknown:
        yield (
            f"the earlier fit gives {_listed(unknown)} no standard error, so none can be given here; "
            "fix it at a number to take it as exact."
        )


def _size(nlp: Nlp) -> Iterator[str]:
    numbers = sum(part.numbers for part in nlp.parts)
    unknowns = len(nlp.free)
    initial = sum(part.unknown_initial_states for part in nlp.parts)
    if numbers <= unknowns + initial:
        states = f" and {counted(initial, 'initial state')}" if initial else ""
        leave = "leaves" if numbers == 1 else "leave"
        yield (
            f"{counted(numbers, 'real number')} of data for {counted(unknowns, 'unknown')}{states} {leave} nothing to "
            "judge the errors by: add data."
        )


def _bounds(nlp: Nlp, best: Minimum, accuracy: Accuracy) -> Iterator[str]:
    dead = [c.names[0] for c in accuracy.combinations if len(c.names) == 1]
    for name in (n for n in accuracy.at_bound if n not in dead):
        k = nlp.free.index(name)
        side = "lower" if best.estimate[k] - nlp.lower[k] < nlp.upper[k] - best.estimate[k] else "upper"
        bound = nlp.lower[k] if side == "lower" else nlp.upper[k]
        yield (
            f"{name} ended at its {side} bound {bound:g}, where the other standard errors take it to be exactly: "
            "widen the bound if the physics allow, or fix the parameter."
        )


def _agreement(nlp: Nlp, search: Multistart) -> Iterator[str]:
    runs, best = search.runs, search.minima[0]
    agreeing = len(best.runs)
    if len(runs) == 1:
        yield "one start only: whether this is the global minimum is not known; use more starts."
    elif agreeing == 1 or agreeing < FEW * len(runs):
        yield (
            f"only {agreeing} of {len(runs)} starts reached the best minimum: a better one may exist; use more starts."
        )
    if search.converged < 0.5 * len(runs):
        yield f"only {search.converged} of {len(runs)} runs converged ({search.failures})."
    if nlp.has_states:
        rivals = [m for m in search.minima[1:] if m.cost <= best.cost + CLOSE]
        if rivals:
            excess = rivals[0].cost - best.cost
            yield f"another minimum with a different response is only exp({excess:.2g}) times less likely."
        return
    rivals = [m for m in search.minima[1:] if 0 < m.cost <= best.cost * (1 + NEAR)]
    if rivals:
        excess = 100 * (rivals[0].cost / best.cost - 1)
        yield f"another minimum costs only {excess:.2g} % more and has a different response."


def _variants(search: Multistart, accuracy: Accuracy) -> Iterator[str]:
    variants = search.minima[0].variants
    if variants > 1 and not accuracy.combinations:
        yield (
            f"at least {variants} clearly different parameter vectors give this same response: "
            "add an ordering constraint or fix a parameter to choose one of them."
        )


def _pade(nlp: Nlp, errors: list[float | None]) -> Iterator[str]:
    for part, error in zip(nlp.problem.parts, errors, strict=True):
        if error is not None and error > PHASE_LIMIT:
            yield (
                f"{part.delay} is wrong by up to {error:.2g}° of phase over the band of {part.name!r}: "
                "use a higher order or delay='exact'."
            )


def _noise(nlp: Nlp, best: Minimum, accuracy: Accuracy) -> Iterator[str]:
    for part, noise in zip(nlp.problem.parts, accuracy.noise, strict=True):
        bias = part.criterion.gain_bias * noise**2
        if bias and noise > NOISY:
            other = "model" if bias < 0 else "measured"
            yield (
                f"{part.name!r} misses the model by {100 * noise:.0f} % in each component: if that is noise, the gain "
                f"is about {100 * abs(bias):.0f} % too {'low' if bias < 0 else 'high'}; "
                f"compare with normalized='{other}', which errs to the other side."
            )
        if isinstance(part.data, FrequencyResponse) and part.criterion.known_noise:
            yield from _misfit(part, nlp, best.estimate)


def _misfit(part: Problem, nlp: Nlp, x: NDArray[np.float64]) -> Iterator[str]:
    position = [response.problem for response in nlp.response_parts].index(part)
    ratio = float(nlp.part_costs(x)[position]) / max(len(part.data) - len(nlp.free) / 2, 0.5)
    if not 0.4 <= ratio <= 2.5:
        yield (
            f"the residuals of {part.name!r} are {ratio:.2g} times what the given variances say: "
            + (
                "the model misses something or the variances are too small; the errors are widened by that."
                if ratio > 1
                else "they are too large."
            )
        )


def _record_noise(nlp: Nlp, trajectories: Sequence[Trajectory | None]) -> Iterator[str]:
    """Say where given standard deviations of outputs are far from those of the residuals."""
    for part, trajectory in zip(nlp.parts, trajectories, strict=False):
        if not isinstance(part, RecordPart) or trajectory is None or part.covariance.known is None:
            continue
        found = np.sqrt(np.diag(trajectory.products) / np.maximum(part.covariance.counts, 1))
        for name, given, there in zip(part.outputs, part.covariance.known, found, strict=True):
            if not 0.6 <= there / given <= 1.6:
                yield (
                    f"the residual of {name} in {part.problem.name!r} is {there / given:.2g} times the given standard "
                    "deviation: the model misses something or that is wrong; the errors follow the residuals."
                )


def _jumps(nlp: Nlp) -> Iterator[str]:
    """Name delays with which the cost jumps, since a held input reaches an output directly."""
    found = {name: why for part in nlp.parts for name, why in part.discontinuous_delays.items() if name in nlp.free}
    for name, (input_, output) in found.items():
        yield (
            f"the held input {input_} reaches {output} directly, so the cost jumps where {name} passes a whole sample: "
            f"the starts must find the right interval of a sample, and the error of {name} holds within that."
        )


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
