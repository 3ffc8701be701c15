"""Whether fits have the same data, and whether their costs may be compared."""

from collections.abc import Sequence

from greybox.assessment.result import Fit, Fits
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.grouping import unique
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import numbered_where_alike


def check_fits(fits: Fits) -> None:
    """Raise TypeError or ValueError for other things, a single fit, or one without an estimate."""
    for fit in fits:
        require_kind("a fit to compare", fit, Fit, "fits, such as gb.fit(problem) returns")
        fit.require_estimate()
    if len(fits) < 2:
        raise ValueError(f"there is {len(fits) or 'no'} fit to compare: give at least two.")


def labels_of(fits: Fits) -> tuple[str, ...]:
    """Return the names of the models, with problems or numbers where they are alike."""
    # Names of models are the most useful. Only if these are equal, names of problems or numbers are
    # needed.
    models = [", ".join(fit.labels) for fit in fits]
    with_problems = [f"{model} ({fit.name})" for model, fit in zip(models, fits, strict=True)]
    for labels in (models, with_problems):
        if len(set(labels)) == len(labels):
            return tuple(labels)
    return tuple(numbered_where_alike(models))


def data_difference(fits: Fits, names: Sequence[str]) -> str:
    """Return how the data of a fit differ from those of the first; empty if they do not."""
    first = fits[0].parts
    for fit, name in zip(fits[1:], names[1:], strict=True):
        if len(fit.parts) != len(first):
            return (
                f"{name} was fitted to {len(fit.parts)} sets of data and {names[0]} to "
                f"{len(first)} (a prior counts as one)"
            )
        for a, b in zip(first, fit.parts, strict=True):
            if type(a.data) is not type(b.data) or not a.data.is_same_as(b.data):  # type: ignore[arg-type]
                # Excerpts have the checksum of the whole log.
                titles = [
                    f"({p.data.name or p.name!r}, {p.compared_numbers} numbers, checksum "
                    f"{p.data.checksum[:8]})"
                    for p in (b, a)
                ]
                return f"{name} was fitted to other data {titles[0]} than {names[0]} {titles[1]}"
            outputs = [", ".join(part.outputs) for part in (b, a)]
            if outputs[0] != outputs[1]:
                return (
                    f"{name} was fitted to the outputs {outputs[0]} and {names[0]} to {outputs[1]}"
                )
    return ""


def shared_data(fits: Fits) -> str:
    """Say which data the fits share."""
    parts = [f"{part.data.name or part.name} ({part.data.checksum[:8]})" for part in fits[0].parts]
    count = sum(part.compared_numbers for part in fits[0].parts)
    return f"the same for all: {', '.join(parts)}, {count} numbers"


def count_unknowns(fit: Fit) -> int:
    """Return how many numbers were estimated: parameters, initial states, noise variances."""
    return len(fit.free) + sum(part.nuisances for part in fit.parts)


def is_likelihood(fit: Fit) -> bool:
    """Return whether the cost is the negative logarithm of a likelihood."""
    return all(part.weight == 1 and part.is_likelihood for part in fit.parts)


def other_samples(fits: Fits, names: Sequence[str]) -> str:
    """Return how the samples left out differ from those of the first fit; empty if they do not."""
    for k, first in enumerate(fits[0].parts):
        count = first.compared_numbers
        for fit, name in zip(fits[1:], names[1:], strict=True):
            rival_count = fit.parts[k].compared_numbers
            if rival_count != count:
                return (
                    f"{names[0]} was fitted to {count} numbers of "
                    f"{first.data.name or first.name!r} "
                    f"and {name} to {rival_count} (the longest delay that the bounds allow leaves "
                    "out the first samples, and PredictionError those that miss an output)"
                )
    return ""


def why_not_comparable(fits: Fits, names: Sequence[str]) -> str:
    """Return why the costs of fits to the same data cannot be compared; empty where they can.

    Costs in time and those of MaximumLikelihood are negative log-likelihoods; those of other
    criteria can only be compared with themselves.
    """
    samples = other_samples(fits, names)
    if samples:
        return samples
    bounded = next((name for fit, name in zip(fits, names, strict=True) if _is_robust(fit)), "")
    if bounded:
        return (
            f"the large errors of {bounded} are bounded, errors='huber' or another one, by values "
            "in place of the measured ones"
        )
    # A weight is a factor on the cost: costs in different units have no difference.
    weights = unique(tuple(part.weight for part in fit.parts) for fit in fits)
    if len(weights) > 1:
        rows = (", ".join(number(weight, 15) for weight in row) for row in weights)
        return f"their data are weighted differently ({'; '.join(rows)})"
    alike = all(
        a.has_criterion_of(b)
        for fit in fits[1:]
        for a, b in zip(fits[0].parts, fit.parts, strict=True)
    )
    if not alike and not all(is_likelihood(fit) for fit in fits):
        criteria = unique(map(_criteria, fits))
        return f"they are of different criteria ({'; '.join(criteria)})"
    return ""


def _is_robust(fit: Fit) -> bool:
    """Return whether the errors of a record have another distribution than the normal one."""
    return any(part.errors != "normal" for part in fit.records)


def _criteria(fit: Fit) -> str:
    """Return the criteria of a fit with their settings, such as ``huber (threshold = 2.0)``."""
    texts = []
    for part in fit.parts:
        settings = ", ".join(f"{name} = {value!r:.40}" for name, value in part.settings.items())
        texts.append(f"{part.criterion} ({settings})" if settings else part.criterion)
    return ", ".join(unique(texts))
