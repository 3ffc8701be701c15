"""Whether parameters of two fits to different data differ beyond their errors."""

import math
from collections.abc import Sequence

import numpy as np

from greybox.assessment.result import Fit, Quantity
from greybox.assessment.validation.comparison import SIGNIFICANT
from greybox.assessment.validation.same_data import check_fits, labels_of
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import probability, with_error
from greybox.data.files.printed import Printed
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, listed
from greybox.modeling.model import require_known


@frozen
class Difference:
    """One parameter or derived quantity of two fits.

    Attributes
    ----------
    name, unit : str
    values, errors : (float, float)
    p_value : float
        Probability of as large a difference by chance, by Welch's t; NaN without both standard
        errors.
    p_of_all : float
        The same for all rows of the table together, by Holm's correction.
    """

    name: str
    unit: str
    values: tuple[float, float]
    errors: tuple[float, float]
    p_value: float
    p_of_all: float

    @property
    def differs(self) -> bool:
        """Whether they differ beyond their errors, at 5 % for the whole table."""
        return self.p_of_all < SIGNIFICANT


@public
@frozen
class Differences(Printed):
    """All parameters that two fits share. Printing it gives the verdict and the table."""

    labels: tuple[str, ...]
    quantities: tuple[Difference, ...]

    @property
    def verdict(self) -> str:
        """Which parameters differ, in one sentence."""
        tested = [q for q in self.quantities if not math.isnan(q.p_value)]
        differ = [q.name for q in tested if q.differs]
        alike = [q.name for q in tested if not q.differs]
        unknown = [q.name for q in self.quantities if math.isnan(q.p_value)]
        verb = "differs" if len(differ) == 1 else "differ"
        texts = [f"{listed(differ)} {verb} beyond the errors"] if differ else []
        texts += [f"no difference of {listed(alike)} is beyond the errors"] if alike else []
        texts += [f"{listed(unknown)} cannot be tested without standard errors"] if unknown else []
        return f"{'; '.join(texts)} (5 % for all {counted(len(tested), 'test')} together, Holm)."

    def __getitem__(self, name: str) -> Difference:
        by_name = {quantity.name: quantity for quantity in self.quantities}
        if name not in by_name:
            raise KeyError(f"there is no {name!r}; there are {', '.join(by_name)}.")
        return by_name[name]

    def __str__(self) -> str:
        rows = []
        for q in self.quantities:
            pairs = [*zip(q.values, q.errors, strict=True)]
            pairs.append((q.values[1] - q.values[0], math.hypot(*q.errors)))
            cells = [" ± ".join(with_error(*pair)) for pair in pairs]
            p = probability(q.p_of_all)
            rows.append([q.name, *cells, q.unit, p, "differs" if q.differs else ""])
        header = ["parameter", *self.labels, "difference", "unit", "p", ""]
        return "\n".join([self.verdict, "", text_table(header, rows, left=(0, 4, 6))])


@public
def differences(first: Fit, second: Fit, names: Sequence[str] | None = None) -> Differences:
    """Test which parameters of two fits to different data differ beyond their errors.

    Every parameter is tested by Welch's t, since the errors of two flights differ in size, and all
    together by Holm's correction. The data must be independent of one another. Values that both
    fits hold fixed are taken as known, because their error is common to both. Values are compared
    without their `Quantity.bias`.

    Parameters
    ----------
    first, second : Fit
    names : sequence of str, optional
        Parameters and derived quantities; by default all free parameters that both have.

    Raises
    ------
    ValueError
        For fits without an estimate or of the same data, and for names that one of them does not
        have.

    Sources: Welch (1947), Biometrika 34; Holm (1979), Scandinavian Journal of Statistics 6.
    """
    check_fits((first, second))
    if {part.data.checksum for part in first.parts} & {part.data.checksum for part in second.parts}:
        raise ValueError(
            "the fits share data, so that their errors are not independent: use gb.compare."
        )
    titles: tuple[str, ...] = (first.name, second.name)
    if titles[0] == titles[1]:
        titles = labels_of((first, second))
    shared = [name for name in first.free if name in second.free] if names is None else list(names)
    for fit, title in zip((first, second), titles, strict=True):
        require_known(shared, fit.by_name, "parameter", title)
    if not shared:
        raise ValueError(f"{titles[0]} and {titles[1]} have no free parameter in common.")

    pairs = [(first.by_name[name], second.by_name[name]) for name in shared]
    p_values = [welch(*pair) for pair in pairs]
    quantities = [
        Difference(
            a.name, a.unit, (a.value, b.value), (a.standard_error, b.standard_error), p, of_all
        )
        for (a, b), p, of_all in zip(pairs, p_values, holm(p_values), strict=True)
    ]
    return Differences(titles, tuple(quantities))


def welch(a: Quantity, b: Quantity) -> float:
    """Return the probability of as large a difference by chance."""
    from scipy.special import stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    # Two flights have noise of different sizes, so the variances are not pooled.
    variances = [q.standard_error**2 for q in (a, b)]
    total = sum(variances)
    if not 0 < total < math.inf:
        return math.nan
    shares = sum(v**2 / q.dof for v, q in zip(variances, (a, b), strict=True))
    dof = min(total**2 / shares if shares > 0 else math.inf, 1e9)  # then normal to all digits
    difference = a.value - a.bias - (b.value - b.bias)
    return float(2 * stdtr(dof, -abs(difference) / math.sqrt(total)))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values for all tests together; NaN where there is none."""
    # Among ten parameters that are equal, one would differ at 5 % in four of ten comparisons.
    # Holm's correction keeps one false alarm in twenty, and finds more than Bonferroni's.
    adjusted = np.array(p_values)
    order = np.argsort(adjusted)[: np.count_nonzero(np.isfinite(adjusted))]
    for_all = np.arange(len(order), 0, -1) * adjusted[order]
    adjusted[order] = np.minimum(np.maximum.accumulate(for_all), 1.0)
    return adjusted.tolist()
