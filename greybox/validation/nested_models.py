"""The test of nested models: whether the data need the terms that only the larger model has.

Whether one model is another one with parameters removed.

A parameter has the same name in both models. Those that only the larger fit estimates must
remove their terms at zero, at one, at a bound, or where the smaller fit holds them. The equations
of both models are then compared at random values.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.estimate.fitted_part import FittedPart, FittedResponse
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, all_finite
from greybox.files.named_values import Values, array_of, without
from greybox.files.numbers_in_text import number, p_text
from greybox.files.printed import Printed
from greybox.files.wording import listed
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model
from greybox.modeling.realization import dynamics
from greybox.modeling.state_space import StateSpace
from greybox.validation.comparison import SIGNIFICANT
from greybox.validation.same_data import (
    check_fits,
    count_unknowns,
    data_difference,
    is_likelihood,
    labels_of,
    other_samples,
)


@dataclass(frozen=True, repr=False)
class NestedTest(Printed):
    """Whether the data need the terms that only the larger model has; printed, it is a sentence.

    Attributes
    ----------
    small, large : str
        Labels of the models.
    terms : tuple of str
        The parameters that are free only in the larger model.
    likelihood_ratio : float
        Twice the difference of the costs.
    scale : float
        By what the ratio is divided: how much the correlation of the residuals inflates it, or the
        size of the errors on the scale of the criterion.
    statistic : float
        Compared with the F distribution.
    dof : (float, float)
        Degrees of freedom of that distribution; the second is `Fit.dof` of the larger fit.
    p_value : float
    """

    small: str
    large: str
    terms: tuple[str, ...]
    likelihood_ratio: float
    scale: float
    statistic: float
    dof: tuple[float, float]
    p_value: float

    def __str__(self) -> str:
        verb = "is" if len(self.terms) == 1 else "are"
        rejected = f"rejected by the test against {self.large}"
        if self.p_value < SIGNIFICANT:
            verdict = f"{verb} needed: {self.small} is {rejected}"
        # With fewer than three degrees of freedom, F of one term is significant only above 18.
        elif self.dof[1] < 3 or f_tail(self.statistic, round(self.dof[0]), math.inf) < SIGNIFICANT:
            # The same ratio would be significant with more degrees of freedom.
            verdict = (
                f"may be needed: the residuals are too correlated, or too few, to tell "
                f"{self.small} from {self.large}"
            )
        else:
            verdict = f"{verb} not shown to be needed: {self.small} is not {rejected}"

        r, dof = self.dof
        statistic = f"F({r:g}, {dof:.0f}) = {number(self.statistic, 4)}"
        scale = "" if self.scale == 1.0 else f"; scaled by {number(self.scale, 3)}"
        return f"{', '.join(self.terms)} {verdict} ({statistic}, {p_text(self.p_value)}{scale})."


def nested_test(small: Fit, large: Fit) -> NestedTest:
    """Test whether the parameters that only `large` has free are needed.

    `large` contains `small` if, with equal parameters under the same names, the equations agree
    where the other parameters of `large` are zero, one or at a bound, or as `small` fixes or ties
    them.

    The test compares twice the difference of the costs with an F distribution. First it divides by
    the variance that the standard errors give these parameters over the variance that the curvature
    of the cost implies, so that it keeps its size where residuals are correlated. For rows without
    a time it is the F test of least squares. Where one of the values is on a bound, half of the
    distribution has one degree of freedom less; where several are, the p-value is an upper limit.
    Process noise is tested in the same way: `OutputError` against
    `PredictionError(process_noise=...)`.

    Parameters
    ----------
    small, large : Fit
        Fits of the same data.

    Raises
    ------
    ValueError
        If the data differ, `small` is not shown to be `large` with terms removed, the costs have no
        likelihood ratio, or `large` costs more.
    LookupError
        If a loaded fit does not know its model.

    Sources: Rotnitzky and Jewell (1990), Biometrika 77; Satorra and Bentler (1994); Klein and
    Morelli, chapter 5; Self and Liang (1987), Journal of the American Statistical Association 82.
    """
    fits = small, large
    check_fits(fits)
    first, second = labels_of(fits)
    labels = first, second
    different = data_difference(fits, labels) or other_samples(fits, labels)
    if different:
        raise ValueError(f"{different}: a nested test needs fits of the same data.")

    try:
        values = nested_values(small, large, labels)
    except NotNestedError as reason:
        raise ValueError(
            f"{labels[0]} is not shown to be {labels[1]} with terms removed: {reason}. Use "
            "gb.compare, which needs no nesting."
        ) from None
    return nested_test_at(values, small, large, labels)


def nested_test_at(
    values: Values,
    small: Fit,
    large: Fit,
    labels: tuple[str, str],
    *,
    independent: bool = False,
) -> NestedTest:
    """Test a fit against a larger one that is the same model where its terms have these `values`.

    With `independent`, errors count as independent along frequency, and as of equal size if `large`
    does not explain the data.

    Raises
    ------
    ValueError
        If the data do not determine the terms, there is no likelihood ratio, or `large` costs more.
    """
    on_bound = {
        name
        for name, value in values.items()
        if any(math.isclose(value, bound, rel_tol=1e-9) for bound in large.by_name[name].bounds)
    }
    # A term that ended at another bound may explain more beyond it: the ratio would be too small.
    stuck = {name for name in values if large.by_name[name].at_bound}
    if not stuck <= on_bound:
        raise ValueError(
            f"{listed(sorted(stuck))} of {labels[1]} ended at a bound: widen it before testing."
        )
    # A term that ended at the bound where the smaller model has it adds nothing, and has no error.
    rows = [k for k, name in enumerate(large.free) if name in values and name not in stuck]
    covariance = large.covariance_of(large.free)[np.ix_(rows, rows)]
    dof = large.dof
    if independent and large.independent is not None:
        alone, dof = large.independent
        covariance = np.where(np.isnan(covariance), np.nan, alone[np.ix_(rows, rows)])
    if not (dof > 0 and all_finite(covariance) and np.all(np.linalg.eigvalsh(covariance) > 0)):
        raise ValueError(
            f"the data do not determine {listed(list(values))} of {labels[1]}: nothing can be "
            "tested."
        )
    responses_alone = len(large.responses) == len(large.parts)
    if large.white is None or not (responses_alone or all(map(is_likelihood, (small, large)))):
        raise ValueError(f"the costs of {labels[0]} and {labels[1]} have no likelihood ratio.")

    removed = count_unknowns(large) - count_unknowns(small)
    ratio = _likelihood_ratio(small, large, labels)
    # If all terms ended there, the models are the same, and the ratio is rounding. Its sign must
    # not decide: at zero, the probability jumps from one to a half.
    gained = max(ratio, 0.0) if rows else 0.0
    scale = 1.0
    if all(_estimates_variance(part) for part in large.parts):
        # The variance is estimated: the ratio is n log(1 + x) of the relative decrease x of the
        # squares, for which F is x (n - p) / r.
        numbers = sum(part.compared_numbers for part in large.parts)
        statistic = math.expm1(gained / numbers) * dof / removed
    else:
        if rows:
            white = large.white[np.ix_(rows, rows)]
            scale = float(np.trace(np.linalg.solve(white, covariance))) / len(rows)
        if independent and not large.is_explained:
            # Where a misfit counts as noise, the noise of the responses that lack another term is
            # so large that no term of theirs would be found: errors count as equal.
            scale = 1.0 if is_likelihood(large) or math.isinf(dof) else 2 * large.cost / dof
        statistic = gained / (scale * removed)
    p_value = f_tail(statistic, removed, dof, on_bound=bool(on_bound))
    return NestedTest(*labels, tuple(values), ratio, scale, statistic, (removed, dof), p_value)


def cost_scale(fit: Fit) -> float:
    """Return the divisor of twice a difference of costs for log-likelihoods; NaN if unknown.

    It is the mean, over the directions that the data determine, of the variance by the standard
    errors, for errors that are independent along frequency, over the variance by the curvature of
    the cost.
    """
    if fit.white is None or fit.directions is None:
        return math.nan
    directions = fit.directions.of(range(len(fit.free)))
    size = np.outer(directions.size, directions.size)
    # 1e-14, rounding twice: below it the data do not see a direction.
    inverse = np.linalg.pinv(fit.white / size, rcond=1e-14, hermitian=True)
    rank = int(np.linalg.matrix_rank(inverse, tol=0.0))
    covariance = directions.covariance if fit.independent is None else fit.independent[0]
    return float(np.trace(inverse @ (covariance / size))) / max(rank, 1)


def f_tail(statistic: float, r: int, dof: float, *, on_bound: bool = False) -> float:
    """Return the probability of a larger statistic, F with r and `dof` degrees of freedom."""
    from scipy.special import fdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    dof = min(dof, 1e9)  # F is then chi-square / r to all digits
    p_value = float(fdtrc(r, dof, statistic))
    if not on_bound:
        return p_value
    # If a term is truly on its bound, in half of all experiments the estimate stays there, and the
    # ratio has one degree of freedom less (Self and Liang).
    fewer = float(fdtrc(r - 1, dof, statistic * r / (r - 1))) if r > 1 else float(statistic <= 0)
    return 0.5 * (p_value + fewer)


def _estimates_variance(part: FittedPart) -> bool:
    """Return whether the data of a part are rows or lines of a variance that the fit estimates."""
    if isinstance(part, FittedResponse) or getattr(part.data, "has_time", False):
        return False
    return not isinstance(part.settings.get("noise"), Mapping)


def _likelihood_ratio(small: Fit, large: Fit, labels: tuple[str, str]) -> float:
    ratio = 2 * (small.cost - large.cost)
    # 0.02, while 3.84 is significant: the two fits may have been integrated with different steps.
    # 1e-9: the tolerance of the solvers relative to a large cost.
    if ratio < -max(0.02, 1e-9 * abs(large.cost)):
        # The filter of little process noise may settle more slowly than a short record lasts: the
        # fit then ends above zero.
        unless = (
            "these data show no process noise, or "
            if any(part.driven for part in large.records)
            else ""
        )
        raise ValueError(
            f"{labels[1]} costs more than {labels[0]}, which it contains: {unless}its fit has not "
            "reached the minimum; give it more starts."
        )
    return ratio


Equations = Mapping[tuple[str, str], NDArray[np.inexact]]  # of 40 points each, by kind and name

# What a criterion may add to that of the smaller model: parameters.
ADDED_SETTINGS = ("biases", "corrected", "process_noise", "disturbance")


class NotNestedError(ValueError):
    """The reason why one model is not another one with parameters removed."""


def nested_values(small: Fit, large: Fit, labels: tuple[str, str]) -> Values:
    """Return the values at which the parameters that only `large` has free make it `small`.

    Raises
    ------
    NotNestedError
        If there are no such values.
    ValueError
        If the models are nested, but have no valid test.
    LookupError
        If a loaded fit does not know its model.
    """
    parts = ([_Part(fit.model_of(k), p) for k, p in enumerate(fit.parts)] for fit in (small, large))
    pairs = list(zip(*parts, strict=True))
    if not all(b.extends(a) for a, b in pairs):
        raise NotNestedError(
            f"{' and '.join(labels)} differ in their criteria, delays, ties or other settings"
        )
    # Standard deviations of sensors are parameters if there is process noise, else implicit.
    implicit = {
        b.names[name]
        for _, b in pairs
        for name in b.part.added
        if name.startswith("v_") and not name.endswith("_bias")
    }
    terms = [name for name in large.free if name not in {*small.free, *implicit}]
    if not terms or count_unknowns(large) <= count_unknowns(small):
        raise NotNestedError(f"{labels[1]} estimates no more numbers than {labels[0]}")

    sources = {b.names[n]: a.names[n] for a, b in pairs for n in b.names if n in a.names}
    # The larger model has the values that are drawn, except where it fixes them.
    shared = {n: source for n, source in sources.items() if large.by_name[n].kind != "fixed"}
    draws = [(d, large.estimate | {n: d[shared[n]] for n in shared}) for d in _draws(small)]

    def is_small(values: Values) -> bool:
        """Return whether the larger model is the smaller one where its terms have these values."""
        return all(
            _agree(a.equations(draw), b.equations({**other, **values}))
            for draw, other in draws
            for a, b in pairs
        )

    held = {name: small.estimate[sources[name]] for name in terms if name in sources}
    of_models = {b.names[name] for _, b in pairs for name in b.model.parameters}
    unknown = [name for name in terms if name not in held]
    choices = []
    for name in unknown:
        # A term vanishes at zero, a factor or an exponent at one, and some only at a bound. A bias
        # or a gain, which the criterion adds and not the model, is absent at zero.
        low, high = large.by_name[name].bounds
        values = (0.0, 1.0, low, high) if name in of_models else (0.0,)
        choices.append([v for v in values if low <= v <= high and math.isfinite(v)])
    # 256 are all combinations of four terms; of more terms, the first ones are zero.
    combinations = itertools.islice(itertools.product(*choices), 256)
    candidates = (dict(zip(unknown, values, strict=True)) for values in combinations)
    removed = next(filter(is_small, candidates), None)
    if removed is None:
        place = f" where {listed(unknown)} is 0, 1 or at a bound" if unknown else ""
        raise NotNestedError(f"{labels[1]} is not {labels[0]}{place}")

    values = {name: {**held, **removed}[name] for name in terms}
    # Davies (1977), Biometrika 64: the ratio does not have the distribution of the test.
    moved = {name: values[name] + 0.1 * max(abs(values[name]), 1.0) for name in terms}
    idle = [n for n in terms if n in of_models and is_small(removed | {n: moved[n]})]
    if idle:
        raise ValueError(
            f"{listed(idle)} of {labels[1]} has no effect where the other terms are as in "
            f"{labels[0]}, so no nested test is valid: fix {listed(idle)} to test the others."
        )
    return values


def _draws(fit: Fit) -> list[Values]:
    """Return five sets of values about the estimate; fixed ones as they are."""
    # Formulas that differ agree at a random point with probability zero.
    random = np.random.default_rng(0)
    moving = {q.name: q.value for q in fit.quantities if q.kind != "fixed"}
    return [
        fit.estimate | {n: v + 0.3 * (abs(v) or 1.0) * random.normal() for n, v in moving.items()}
        for _ in range(5)
    ]


class _Part:
    """A part of a fit, with its model and the names of its parameters in the fit."""

    def __init__(self, model: Model, part: FittedPart) -> None:
        self.model = model
        self.part = part
        self.names = {name: part.outside(name) for name in (*model.parameters, *part.added)}
        self._dynamics = dynamics(model) if isinstance(model, StateSpace) else None

    def extends(self, other: "_Part") -> bool:
        """Return whether this part differs from a smaller one in nothing but the equations."""
        has_all_terms = {*other.part.added} <= {*self.part.added} and self.part.tied in (
            {},
            other.part.tied,
        )
        return has_all_terms and self._settings() == other._settings()

    def _settings(self) -> list[object]:
        part = self.part
        # Only output error may assume errors that are not normal.
        settings = {"errors": "normal", **part.settings}
        settings = without(settings, ADDED_SETTINGS)
        # Output error is prediction error with gains of zero.
        criterion = part.criterion_class.replace("PredictionError", "OutputError")
        others = [getattr(part, name, None) for name in ("at", "sine", "inputs")]
        return [criterion, settings, part.delay, part.weight, sorted(part.constraints), *others]

    def equations(self, values: Values) -> Equations:
        """Return derivatives, outputs and delays by name, or the response, at 40 points."""
        p = {name: values[self.names[name]] for name in self.model.parameters}
        system = self._dynamics
        if system is None:
            response = frequency_response(self.model, p, np.geomspace(0.01, 30, 40))
            return {("response", ""): response.response}
        x, u = (np.reshape([*map(_signal, n)], (-1, 40)) for n in (system.states, system.inputs))
        point = np.tile(np.reshape([*p.values()], (-1, 1)), 40)
        blocks = (
            ("derivative", system.states, system.derivative(x, u, point)),
            ("output", system.outputs, system.output(x, u, point)),
            ("delay", system.inputs, system.delay(point)),
        )
        return {
            (kind, name): row
            for kind, names, rows in blocks
            for name, row in zip(names, np.asarray(rows), strict=True)
        }


def _signal(name: str) -> Array:
    """Return 40 values of a state or an input, the same ones in every model."""
    # Values of either sign over decades: kinks, saturations and powers all have an effect there.
    random = np.random.default_rng([*name.encode()])
    return random.choice([-1.0, 1.0], 40) * 10 ** random.uniform(-2, 1.5, 40)


def _agree(expected: Equations, rows: Equations) -> bool:
    """Return whether all expected rows are there, equal up to rounding, and mostly finite."""
    if not expected.keys() <= rows.keys():
        return False
    a, b = (array_of(of, expected) for of in (expected, rows))
    sizes = np.abs(a[np.isfinite(a)])
    # A thousand times the rounding of a long formula; what cancels leaves 1e-14 of a term.
    atol = 1e-14 * np.max(sizes, initial=0.0)
    return 10 * sizes.size >= a.size and np.allclose(b, a, rtol=1e-9, atol=atol, equal_nan=True)
