"""The answer as a person reads it: verdict, table, limits, and details on request.

The numbers of a fit as plain values, for JSON.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from textwrap import indent
from typing import Any, NamedTuple

import numpy as np

from greybox.assessment.fitted_part import FittedRecord, FittedResponse, FittedSpectrum
from greybox.assessment.response_band import t_quantile
from greybox.assessment.verdict import verdict
from greybox.data.files.arrays import all_finite
from greybox.data.files.grouping import unique
from greybox.data.files.json_numbers import plain
from greybox.data.files.named_values import attributes
from greybox.data.files.numbers_in_text import number, percent, with_error
from greybox.data.files.text_table import text_table, titled
from greybox.data.files.wording import counted, listed, some
from greybox.data.intersample import described_unstated_hold
from greybox.engine.solve.minima import Multistart
from greybox.engine.solve.runs import SCREENED, Runs
from greybox.modeling.formulation.spectrum_criteria import EquationError
from greybox.statistics.metrics import rms

# Largest number of records of which each has a line.
MANY = 10
# Fewer points may hide a correlation of 0.8 between neighbors: with 12 points, 95 % intervals
# contain the truth in 87 to 94 % of fits; with 24 points, in 95 %
# (benchmarks/results/neighbor_coverage.txt).
FEW = 16


class Table(NamedTuple):
    """A table of texts: its header, its rows, and the columns that are flush left."""

    header: list[str]
    rows: list[list[str]]
    left: tuple[int, ...]


def text(fit: Any, table: str = "") -> str:
    """Return a `Fit` as text: the verdict, the table, what limits it, and how close it is.

    A table of other numbers than the parameters stands in the place of theirs.
    """
    table = table or table_of_parameters(fit)
    remarks = []
    if fit.misfit:
        remarks += [cause.remedy for cause in fit.misfit.likely]
    remarks += [f"warning: {line}" for line in fit.warnings]
    remarks += [f"note: {line}" for line in fit.notes]
    if not fit.converged:
        lines = [f"FAILED: {fit.status}.", *remarks]
        if fit.best_effort:
            lines += ["", "best effort, no estimate:", "", table]
        return titled(title(fit), lines)

    judged = verdict(fit)
    table_lines = [table]
    if fit.directions:
        table_lines += ["", error_statement(fit)]
    sections = (
        [judged.level, *judged.sentences],
        table_lines,
        _profile_lines(fit),
        remarks,
        [_labeled(closeness(fit))],
    )
    paragraphs = ["\n".join(lines) for lines in sections if lines]
    return titled(title(fit), ["\n\n".join(paragraphs)])


def has_systematic_errors(fit: Any) -> bool:
    """Return whether a standard error contains an error that all points of a response share."""
    return any(q.systematic > 0 for q in fit.quantities)


def table_of_parameters(fit: Any) -> str:
    """Return the table of all quantities as text."""
    parameters = parameter_table(fit)
    return text_table(parameters.header, parameters.rows, parameters.left)


def details(fit: Any) -> str:
    """Return what the text of a `Fit` leaves out: starts, cost, delay, correlations, time."""
    return indent(_labeled(facts(fit)), "  ")


def _labeled(pairs: Sequence[tuple[str, str]]) -> str:
    """Return lines of a label and a text."""
    return "\n".join(f"{label:<10} {fact}" for label, fact in pairs)


def title(fit: Any) -> str:
    """Return the problem and its models."""
    return f"{fit.name}: {', '.join(fit.labels)}"


def facts(fit: Any) -> list[tuple[str, str]]:
    """Return starts, cost, delay, correlations and time as pairs of a label and a text."""
    delay = fit.delay
    for part in fit.responses:
        if part.pade_error is not None:
            delay += f"; Padé phase error up to {part.pade_error:.2g}° ({part.name})"

    pairs = [("starts", _starts_text(fit)), ("cost", f"{fit.cost:.6g}  ({fit.rule})")]
    if costs := _magnitude_phase_text(fit.responses):
        pairs.append(("agreement", costs))
    pairs.append(("delay", delay))
    correlated = () if fit.directions is None else fit.identifiability.correlated
    if correlated:
        texts = ", ".join(f"{a} and {b} ({value:.2f})" for a, b, value in correlated)
        pairs.append(("correlated", f"beyond 0.9: {texts.replace('-', '−')}"))
    pairs.append(("time", f"{fit.seconds:.2f} s"))
    return pairs


def _starts_text(fit: Any) -> str:
    """Say how many starts converged, and how many agree on the best minimum."""
    # Screened starts were evaluated but not run: they cannot agree on a minimum.
    tried = Multistart(fit.runs, fit.minima)
    screened = len(fit.runs) - len(tried.brought)
    only_screened = f" ({screened} of {len(fit.runs)} starts were screened out)" if screened else ""
    minima = counted(len(fit.minima), "distinct minimum", "distinct minima")
    return (
        f"{tried.converged} of {len(tried.brought)} converged{only_screened}; "
        f"{counted(fit.agreeing, 'agrees', 'agree')} on the best of {minima}; {fit.starts}"
    )


def _magnitude_phase_text(responses: Sequence[FittedResponse]) -> str:
    """Say the cost of CIFER with its guidelines, of the worst pairs too; empty if not finite."""
    costs = [(part.magnitude_phase_cost, part.name) for part in responses]
    costs.sort(reverse=True)
    if not costs or not all(math.isfinite(cost) for cost, _ in costs):
        return ""
    mean = number(sum(cost for cost, _ in costs) / len(costs), 3)
    if len(costs) == 1:
        return f"{mean} by magnitude and phase (guideline: at most 100)"
    by_pair = some([f"{name} {number(cost, 3)}" for cost, name in costs], 3)
    return f"{mean} on average by magnitude and phase (guideline: at most 100); {by_pair} (200)"


def closeness(fit: Any) -> list[tuple[str, str]]:
    """Return data, priors, inputs and how closely the model follows, as labels with texts."""
    # Without a test of misfit no part was tested; with it, all parts but rows without a time.
    untested = [part for part in fit.parts if not fit.misfit]
    if fit.misfit:
        untested = [part for part in fit.records if not part.data.has_time]
    model_texts = []
    if untested:
        names = some([part.name for part in untested])
        model_texts.append(f"not tested for candidate terms in {names}")

    texts = (
        ("data", [data_text(fit)]),
        ("prior", _prior_texts(fit)),
        ("clock", _gap_texts(fit.records)),
        ("inputs", _input_texts(fit.records)),
        ("output", _output_texts(fit.records)),
        ("hold", _hold_texts(fit.responses)),
        ("response", _response_texts(fit.responses)),
        ("output", _spectrum_texts(fit.spectra)),
        ("model", model_texts),
    )
    return [(label, line) for label, lines in texts for line in lines]


def parameter_table(fit: Any) -> Table:
    """Return the table of all quantities; of a failed fit the values where its best run ended."""
    rows = []
    if not fit.converged:
        header = ["parameter", "value", "unit", "bounds", "", "meaning"]
        values = fit.best_effort or {}
        for q in fit.quantities:
            if q.name in values:
                rows.append([q.name, number(values[q.name]), q.unit, *_bounds_and_note(q), q.about])
        return Table(header, rows, left=(0, 2, 4, 5))

    header = ["parameter", "estimate", "± error", "unit", "bounds", "", "meaning"]
    systematic_is_shown = has_systematic_errors(fit)
    if systematic_is_shown:
        header.insert(3, "systematic")
    for q in fit.quantities:
        # The biases and noise of a hundred records would fill pages.
        if not _is_of_later_record(q.name, len(fit.records)):
            value, error = with_error(q.value, q.standard_error)
            systematic = [number(q.systematic, 2) if q.systematic > 0 else "-"]
            errors = [error, *systematic] if systematic_is_shown else [error]
            rows.append([q.name, value, *errors, q.unit, *_bounds_and_note(q), q.about])
    if len(rows) < len(fit.quantities):
        rest = len(fit.quantities) - len(rows)
        rows.append([f"... and {rest} more", *[""] * (len(header) - 1)])

    unit = header.index("unit")
    return Table(header, rows, left=(0, unit, unit + 2, unit + 3))


def data_text(fit: Any) -> str:
    """Return how many points, lines, samples and rows the data have, and how many were compared."""
    texts = []
    parts = [part for part in fit.parts if not part.is_prior]
    for nouns in unique(part.nouns for part in parts):
        element, elements, kind = nouns
        same_kind = [part for part in parts if part.nouns == nouns]
        count = sum(len(part.data) for part in same_kind)
        compared = sum(part.compared for part in same_kind)
        share = "" if compared == count else f"{compared} of "
        texts.append(
            f"{share}{counted(count, element, elements)} in {counted(len(same_kind), kind)}"
        )

    return " and ".join(texts)


def error_statement(fit: Any) -> str:
    """Say what ± means, and for which errors of the data."""
    conditions = "; ".join(unique(part.condition for part in fit.parts))
    # With every parameter at a bound, there is no interval to compare.
    if fit.independent is not None and np.any(fit.covariance.diagonal() > 0):
        _, independent_dof = fit.independent
        width = t_quantile(0.95, independent_dof) / t_quantile(0.95, fit.dof)
        percent = 100 * width / math.sqrt(fit.inflation)
        between = " or between responses" if len(fit.responses) > 1 else ""
        conditions += (
            f"; correlated along frequency{between} like the residuals (intervals for independent "
            f"errors would be {percent:.0f} % as wide)"
        )
    # Responses that do not state that their errors are independent.
    elif assumed := [part for part in fit.responses if not part.data.has_independent_errors]:
        extent = " like the residuals"
        # Slow errors beneath white ones as large are not always seen, even in many points.
        if any(len(part.data) < FEW for part in assumed):
            extent = f", which fewer than {FEW} points hardly show"
        conditions += f"; independent along frequency{extent}"

    interval = ""
    if math.isfinite(fit.dof):
        freedom = counted(round(fit.dof), "degree of", "degrees of")
        interval = (
            f" (95 % interval: ± {t_quantile(0.95, fit.dof):.1f} times this, {freedom} freedom)"
        )

    is_wrong = fit.misfit and not fit.misfit.explains
    valid = ", valid only if the model explains the data" if is_wrong else ""
    common = ""
    if has_systematic_errors(fit):
        common = (
            "; it includes what is systematic: the effect of errors that all points of a response "
            "share, which longer tests do not reduce"
        )
    return f"±: standard error{interval}, for {conditions}{_bias_text(fit)}{valid}{common}."


def _bias_text(fit: Any) -> str:
    """Name the quantities whose intervals are corrected for a bias."""
    # With a bias of 0.3 standard errors, a 95 % interval without the correction would cover 94 %.
    biased = [q for q in fit.quantities if abs(q.bias) > 0.3 * q.standard_error > 0]
    # The largest biases in standard errors first, since only three are named.
    biased.sort(key=lambda q: -abs(q.bias) / q.standard_error)
    if not biased:
        return ""
    names = some([f"{q.name} {-q.bias:+.2g}" for q in biased], 3)
    return f"; intervals are corrected for the bias by the noise ({names})"


def _profile_lines(fit: Any) -> list[str]:
    """Return the intervals by profile likelihood, with a line before them."""
    if not fit.profiles:
        return []
    profiles = fit.profiles.profiles
    width = max(len(profile.name) for profile in profiles)
    return [
        f"{100 * fit.profiles.level:g} % intervals by profile likelihood, where the standard "
        "error is missing or misleads:",
        *(f"  {profile.name:<{width}}  {profile}" for profile in profiles),
    ]


def _prior_texts(fit: Any) -> list[str]:
    """Return the priors with their shares in the information on each parameter."""
    if not fit.priors:
        return []
    priors = []
    for name, (mean, sigma) in fit.priors.items():
        value = " ± ".join(with_error(mean, sigma))
        share = number(100 * fit.prior_share.get(name, math.nan), 2)
        priors.append(f"{name} = {value} ({share} %)")

    return [
        f"{some(priors, MANY)}; in parentheses its share in the information (maximum a posteriori)"
    ]


def _input_texts(records: Sequence[FittedRecord]) -> list[str]:
    """Say how the inputs ran between their samples, one line for all that ran alike."""
    # Most inputs of a flight are sampled alike, so one line suffices.
    inputs_by_text: dict[str, list[str]] = {}
    for part in records:
        for name, text in part.between.items():
            inputs_by_text.setdefault(text, []).append(name)
    return [f"{', '.join(unique(names))} {text}" for text, names in inputs_by_text.items()]


def _gap_texts(records: Sequence[FittedRecord]) -> list[str]:
    """Say how long steps were treated, in the first records only if there are many."""
    with_gaps = [part for part in records if part.gaps]
    texts = []
    for part in with_gaps[:MANY]:
        place = f" ({part.name})" if len(records) > 1 else ""
        texts.append(f"{part.gaps}{place}")
    rest = len(with_gaps) - len(texts)
    if rest:
        texts.append(f"and long steps in {counted(rest, 'more record')}")
    return texts


def _hold_texts(responses: Sequence[FittedResponse]) -> list[str]:
    """Say for which inputs of responses the hold is not stated, and what it may do to delays."""
    inputs_by_text: dict[str, list[str]] = {}
    for part in responses:
        if text := described_unstated_hold(part.data.about):
            inputs_by_text.setdefault(text, []).append(part.data.input)
    return [f"of {listed([*unique(names)])} {text}" for text, names in inputs_by_text.items()]


def _output_texts(records: Sequence[FittedRecord]) -> Iterator[str]:
    """Say how well every output of every record is reproduced; for many records, the range."""
    # Twenty records with three outputs would take a page.
    if len(records) <= MANY:
        for part in records:
            for output in part.outputs:
                yield _output_text(part, output)
        return
    for output in unique(output for part in records for output in part.outputs):
        parts = [part for part in records if output in part.outputs]
        percents = [part.fit_percent(output) for part in parts]
        worst = parts[percents.index(min(percents))]
        yield (
            f"{output} in {counted(len(parts), 'record')}: fit {min(percents):.1f} to "
            f"{max(percents):.1f} % (least in {worst.name!r})"
        )


def _output_text(part: FittedRecord, output: str) -> str:
    """Say how well an output of a record is reproduced."""
    place = f" ({part.name})"
    size = rms(part.residual(output))
    if math.isnan(size):
        return f"{output}{place}: never measured"
    residual = f"{number(size)} {part.data.units.get(output, '')}".rstrip()
    # NaN for an output that never changes.
    share = part.fit_percent(output)
    fit_text = "" if math.isnan(share) else f", fit {share:.1f} %"
    return f"{output}{place}: residual {residual} rms{fit_text}"


def _response_texts(responses: Sequence[FittedResponse]) -> list[str]:
    """Say how far the points are from the model; of many responses, for the worst three."""
    texts = []
    sizes = []
    for part in responses:
        error = part.relative_residuals
        # A response that contains a zero has no relative residual: it has no line.
        if all_finite(error):
            worst = np.argmax(error)
            place = f" ({part.name})" if len(responses) > 1 else ""
            sizes.append(rms(error))
            texts.append(
                f"residual {percent(rms(error))} % rms, largest {percent(error[worst])} % at "
                f"{part.data.omega[worst]:.4g} rad/s{place}"
            )

    # If there are many responses, the worst three show what is wrong.
    if len(texts) > MANY:
        worst_first = sorted(range(len(texts)), key=lambda k: (-sizes[k], texts[k]))
        texts = [texts[k] for k in worst_first[:3]]
    return texts


def _spectrum_texts(spectra: Sequence[FittedSpectrum]) -> Iterator[str]:
    """Say how well every output of every manoeuvre is reproduced, and the noise of one sample."""
    for part in spectra:
        place = f" ({part.name})" if len(spectra) > 1 else ""
        by_equation = part.criterion == EquationError().name
        for k, output in enumerate(part.outputs):
            noise = number(part.noise[k, k] ** 0.5)
            if by_equation:
                noise = f"error of its equation {noise}"
            else:
                noise = f"noise of a sample {noise} {part.data.units.get(output, '')}".rstrip()
            yield f"{output}{place}: {noise}, fit {part.fit_percent(output):.1f} %"


def _bounds_and_note(q: Any) -> tuple[str, str]:
    """Return the bounds of a free quantity and whether one is active; of others, the kind."""
    if q.kind != "free":
        return "", q.kind
    # Bounds that were computed from the data are no statement of the reader's.
    low, high = q.bounds
    bounds = "" if q.has_computed_bounds else f"[{low:g}, {high:g}]"
    return bounds, "AT BOUND" if q.at_bound else ""


def _is_of_later_record(name: str, records: int) -> bool:
    """Return whether a name ends with the number of a record beyond the third of many."""
    # `several` numbers what each record has for itself: x_bias_1, x_bias_2 ...
    number_of_record = re.search(r"_(\d+)$", name)
    return records > MANY and number_of_record is not None and int(number_of_record[1]) > 3


def data_names(parts: Iterable[Any], models: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the data of parts; without one, those of the problems, or checksums.

    A problem without a name is named by its model, and two models may be fitted to the same data.
    """
    return unique(
        part.data.name
        # Parts of one name are numbered: Lag 1, Lag 2.
        or (part.data.checksum[:8] if re.sub(r" \d+$", "", part.name) in models else part.name)
        for part in parts
    )


def summary(result: Any, level: float = 0.95) -> dict[str, Any]:
    """Return the numbers of a `Fit`; None for one that is unknown or not finite."""
    parameters = [q for q in result.quantities if q.kind != "derived"]
    free = [q for q in parameters if q.kind == "free"]
    runs = Runs.of(result.runs)
    misfit = result.misfit
    named = ("criterion", "rule", "delay", "seed", "agreeing", "cost", "costs", "status")
    named += ("estimate", "best_effort", "standard_error", "derived", "dof")
    named += ("warnings", "notes", "checksum", "seconds", "versions")
    return plain(
        {
            "problem": result.name,
            "model": list(result.labels),
            "data": data_names(result.parts, result.labels),
            **attributes(result, *named),
            "starts": len(runs),
            "screened": np.count_nonzero(runs.stage == SCREENED),
            "converged": np.count_nonzero(runs.converged),
            "minima": len(result.minima),
            "verdict": verdict(result),
            "misfit": misfit
            and vars(misfit) | attributes(misfit, "explains", "is_conditional", "p_value"),
            "level": level,
            "interval": result.interval(level),
            "profiles": {} if result.profiles is None else result.profiles.intervals_in_words(),
            "covariance": {"names": result.names, "values": result.covariance},
            "bounds": {q.name: q.bounds for q in free},
            "starts_box": {q.name: q.box for q in free},
            "unit": {q.name: q.unit for q in parameters},
            "fixed": {q.name: q.value for q in parameters if q.kind == "fixed"},
            "tied": [q.name for q in parameters if q.kind == "tied"],
            "at": {name: x for part in result.responses for name, x in part.at.items()},
            "prior": {
                name: {
                    "mean": mean,
                    "standard_deviation": sigma,
                    "share": result.prior_share.get(name, math.nan),
                }
                for name, (mean, sigma) in result.priors.items()
            },
            "outputs": [
                {
                    "part": part.name,
                    "output": name,
                    "unit": part.data.units.get(name, ""),
                    "fit_percent": part.fit_percent(name),
                    # The diagonal of the covariance of the residuals, given or estimated.
                    "noise": math.sqrt(part.noise[k, k]),
                }
                for part in (*result.records, *result.spectra)
                for k, name in enumerate(part.outputs)
            ],
            "gaps": [
                {
                    "part": part.name,
                    "text": part.gaps,
                    "stretches": max(map(len, part.initial.values()), default=1),
                    "unused": part.unused,
                }
                for part in result.records
                if part.gaps
            ],
            "responses": [
                {"part": part.name, "magnitude_phase_cost": part.magnitude_phase_cost}
                for part in result.responses
            ],
            "at_bound": result.at_bound,
        }
    )
