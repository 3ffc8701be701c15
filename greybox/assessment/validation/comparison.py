"""The result of a comparison: plain values that print themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from greybox.assessment.simulation.prediction import Prediction, seconds
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import grouped, unique
from greybox.data.files.numbers_in_text import number, probability
from greybox.data.files.printed import Printed, one_line
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table, titled
from greybox.data.files.wording import counted

IDENTIFICATION = "identification"
HELD_OUT = "held-out"

# p-value below which a difference counts: the customary 5 %, one false alarm in twenty comparisons.
SIGNIFICANT = 0.05

# Difference of AIC below which neither of two models is preferred: Burnham and Anderson (2002),
# section 2.6.
EQUAL_AIC = 2.0


@dataclass(frozen=True)
class Row:
    """One measure of every fit.

    Attributes
    ----------
    data : str
        "fit", or the records that were predicted: "identification" or "held-out".
    output : str
        Empty for a measure of the whole fit.
    measure, unit : str
    values : tuple of float or None
        In the order of the fits; None where it is not known or does not exist.
    """

    data: str
    output: str
    measure: str
    unit: str
    values: tuple[float | None, ...]

    @property
    def is_known(self) -> bool:
        """Whether any fit has a value."""
        return any(value is not None for value in self.values)

    @property
    def texts(self) -> list[str]:
        """The values as a person reads them."""
        texts = []
        for value in self.values:
            if self.measure.endswith("(p)") and value is not None:
                texts.append(probability(value))
            else:
                texts.append(number(value))
        return texts


@public
@frozen
class Comparison(Printed):
    """Several fits side by side. Printing it gives the verdict, its reasons, and the table.

    Attributes
    ----------
    labels : tuple of str
        One for every fit.
    data : str
        The data of the fits, in words.
    rows : tuple of Row
        The measures.
    statements : tuple of str
        The meaning of the measures.
    predictions : mapping of str to tuple of tuples
        By kind of data, "identification" and "held-out": for every fit the `Prediction` of every
        record.
    supported : str
        The label of the smallest structure that the data support, by BIC or, for two fits of
        records, by the test of nested models; empty if neither decides.
    verdict : str
        The reason, in one sentence.
    """

    labels: tuple[str, ...]
    data: str
    rows: tuple[Row, ...]
    statements: tuple[str, ...]
    predictions: Mapping[str, tuple[tuple[Prediction, ...], ...]] = field(default_factory=dict)
    supported: str = ""
    verdict: str = ""

    @property
    def table(self) -> list[dict[str, Any]]:
        """The rows as plain values: data, output, measure, unit, and the value by label."""
        return [
            vars(row) | {"values": dict(zip(self.labels, row.values, strict=True))}
            for row in self.rows
        ]

    def value(self, measure: str, label: str, data: str = "fit", output: str = "") -> float | None:
        """Return one number of the table.

        Raises
        ------
        ValueError
            If the table does not have it.
        """
        values = {(row.data, row.output, row.measure): row.values for row in self.rows}
        if (data, output, measure) in values and label in self.labels:
            return values[data, output, measure][self.labels.index(label)]
        raise ValueError(
            f"there is no {measure!r} of {label!r} for {data!r} and output {output!r} in the table."
        )

    def __repr__(self) -> str:
        return one_line(self, f"of {', '.join(self.labels)}", counted(len(self.rows), "row"))

    def __str__(self) -> str:
        sentences = [text for text in (self.verdict, *self.statements) if text]
        lines = [f"data  {self.data}", "", *sentences, ""]
        for data in unique(row.data for row in self.rows):
            if data in self.predictions:
                lines += [f"{data} data: {self._windows(data)}", ""]
            rows = [row for row in self.rows if row.data == data]
            for rows_of_output in grouped(rows, lambda row: row.output):
                lines += [self._table(rows_of_output), ""]
        return titled(f"Comparison of {', '.join(self.labels)}", lines).rstrip()

    def _windows(self, data: str) -> str:
        """Return number and length of the windows."""
        # All fits predict the same windows.
        predictions = self.predictions[data][0]
        rows = [p for p in predictions if not p.data.has_time]
        in_time = [p for p in predictions if p.data.has_time]
        texts = []
        if rows:
            texts.append(f"{counted(sum(map(len, rows)), 'row')}, each by itself")
        if in_time:
            window = _range_text([p.horizon for p in in_time])
            lead = _range_text([p.lead for p in in_time])
            count = counted(sum(map(len, in_time)), "window")
            texts.append(f"{count} of {window} s, each from {lead} s before it")
        return " and ".join(texts)

    def _table(self, rows: Sequence[Row]) -> str:
        """Return the table of one output, with a column for each fit."""
        cells = [[row.measure, row.unit, *row.texts] for row in rows]
        return text_table([rows[0].output, "", *self.labels], cells, left=(0, 1))


def _range_text(lengths: Sequence[float]) -> str:
    """Return the range of lengths in s; one number if they print alike."""
    # Records with different rates have windows of slightly different length: whole samples.
    return " to ".join(unique((seconds(min(lengths)), seconds(max(lengths)))))
