"""Whether parameters of two fits to different data differ beyond their errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from greybox.estimate.result import Fit
from greybox.files.text_table import counted, listed, one_line, text_table, with_error
from greybox.modeling.model import require_known
from greybox.validation.comparison import SIGNIFICANT, p_text
from greybox.validation.same_data import check_fits, labels_of


@dataclass(frozen=True)
class Difference:
    """One parameter or derived quantity of two fits.

    Attributes
    ----------
    name, unit : str
    values, errors : (float, float)
    p_value : float
        Of as large a difference by chance, Welch's t; NaN where one of them has no standard error.
    p_of_all : float
        The same for the whole table, by Holm's correction.
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


@dataclass(frozen=True, eq=False)
class Differences:
    """All parameters that two fits share. Printing it gives the table and one sentence."""

    labels: tuple[str, str]
    quantities: tuple[Difference, ...]

    @property
    def verdict(self) -> str:
        """Which parameters differ, in one sentence."""
        told = [q for q in self.quantities if not math.isnan(q.p_value)]
        differ = [q.name for q in told if q.differs]
        alike = [q.name for q in told if not q.differs]
        unknown = [q.name for q in self.quantities if math.isnan(q.p_value)]
        texts = (
            [f"{listed(differ)} {'differs' if len(differ) == 1 else 'differ'} beyond the errors"]
            if differ
            else []
        )
        texts += [f"no difference of {listed(alike)} is beyond the errors"] if alike else []
        texts += (
            [f"of {listed(unknown)} nothing can be told without standard errors"] if unknown else []
        )
        return f"{'; '.join(texts)} (5 % for all {counted(len(told), 'test')} together, Holm)."

    def __getitem__(self, name: str) -> Difference:
        for quantity in self.quantities:
            if quantity.name == name:
                return quantity
        raise KeyError(
            f"there is no {name!r}; there are {', '.join(q.name for q in self.quantities)}."
        )

    def __repr__(self) -> str:
        return one_line(
            self,
            " and ".join(self.labels),
            counted(sum(q.differs for q in self.quantities), "difference"),
        )

    def __str__(self) -> str:
        rows = []
        for q in self.quantities:
            columns = [
                " ± ".join(with_error(v, e)) for v, e in zip(q.values, q.errors, strict=True)
            ]
            difference = " ± ".join(with_error(q.values[1] - q.values[0], math.hypot(*q.errors)))
            p = (
                "-"
                if math.isnan(q.p_of_all)
                else p_text(q.p_of_all).removeprefix("p = ").removeprefix("p ")
            )
            rows.append([q.name, *columns, difference, q.unit, p, "differs" if q.differs else ""])
        header = ["parameter", *self.labels, "difference", "unit", "p", ""]
        return "\n".join([text_table(header, rows, left=(0, 4, 6)), "", self.verdict])


def differences(
    first: Fit, second: Fit, names: Sequence[str] | None = None, *, labels: Sequence[str] = ()
) -> Differences:
    """Test which parameters of two fits to different data differ beyond their errors.

    Each by Welch's t, whose sizes of the errors are those of the two fits, and all of them together
    by Holm's correction. The data must be independent of one another. What both fits hold fixed is
    taken as known: an error that it has is common to both. Values are compared less their
    `Quantity.bias`.

    Parameters
    ----------
    first, second : Fit
    names : sequence of str, optional
        Parameters and derived quantities; by default all free parameters that both have.
    labels : sequence of str, optional
        For the two columns; by default the names of the problems.

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
    titles = tuple(labels) or (first.name, second.name)
    if len(titles) != 2 or titles[0] == titles[1]:
        titles = labels_of((first, second))
    one, other = ({q.name: q for q in fit.quantities} for fit in (first, second))
    wanted = [name for name in first.free if name in second.free] if names is None else list(names)
    for known, title in ((one, titles[0]), (other, titles[1])):
        require_known(wanted, known, "parameter", title)
    if not wanted:
        raise ValueError(f"{titles[0]} and {titles[1]} have no free parameter in common.")

    p_values = [
        _welch(*((q.value - q.bias, q.standard_error, q.dof) for q in (one[name], other[name])))
        for name in wanted
    ]
    return Differences(
        (titles[0], titles[1]),
        tuple(
            Difference(
                name,
                one[name].unit,
                (one[name].value, other[name].value),
                (one[name].standard_error, other[name].standard_error),
                p,
                of_all,
            )
            for name, p, of_all in zip(wanted, p_values, _holm(p_values), strict=True)
        ),
    )


def _welch(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    """Return the probability of as large a difference of two (value, standard error, degrees of freedom)."""
    from scipy.special import stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    variances = [error**2 for _, error, _ in (one, other)]
    if not 0 < sum(variances) < math.inf:
        return math.nan
    shares = sum(v**2 / dof for v, (_, _, dof) in zip(variances, (one, other), strict=True))
    dof = (
        sum(variances) ** 2 / shares if shares > 0 else 1e9
    )  # there Student's t is normal to all digits
    return float(2 * stdtr(min(dof, 1e9), -abs(one[0] - other[0]) / math.sqrt(sum(variances))))


def _holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values for all tests together; NaN where there is none."""
    order = sorted(
        (k for k, p in enumerate(p_values) if not math.isnan(p)), key=lambda k: p_values[k]
    )
    adjusted, largest = [math.nan] * len(p_values), 0.0
    for rank, k in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * p_values[k]))
        adjusted[k] = largest
    return adjusted
