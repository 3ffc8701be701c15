"""What a comparison of fits answers, in plain values that print themselves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from greybox.files.html_text import html_list, html_table, html_text
from greybox.files.text_table import counted, number, one_line, text_table
from greybox.simulation.prediction import Prediction
from greybox.simulation.windows import seconds

IDENTIFICATION = "identification"
HELD_OUT = "held-out"
FREQUENCIES = "frequencies"  # left out of fits of responses, and predicted by the fit to the rest

# p-value below which a difference counts: the customary 5 %, one false alarm in twenty comparisons.
SIGNIFICANT = 0.05

# Difference of AIC below which neither of two models is preferred: Burnham and Anderson (2002),
# section 2.6.
EQUAL_AIC = 2.0

# Rows of the table beyond which its text leaves out details: what a page holds beside titles and
# sentences.
PAGE = 45
MOST_SIGNALS = 3  # that an output is shown to be correlated with: the largest findings


@dataclass(frozen=True)
class Row:
    """One measure, for every fit: None where it is not known or does not exist.

    Attributes
    ----------
    data : str
        "fit"; on which records the windows lie: "identification" or "held-out"; or what was left
        out and predicted by the fit to the rest: "frequencies" or "parts".
    output : str
        Empty for what belongs to the whole fit.
    measure, unit : str
    values : tuple of float or None
        In the order of the fits.
    signal : str
        Of a p-value of no correlation between the errors of the output and a signal, that signal;
        of what belongs to such a row too.
    is_detail : bool
        Whether the text leaves it out where it would be longer than a page.
    """

    data: str
    output: str
    measure: str
    unit: str
    values: tuple[float | None, ...]
    signal: str = ""
    is_detail: bool = False

    @property
    def is_p_value(self) -> bool:
        """Whether it is a p-value."""
        return self.measure.endswith("(p)")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several fits side by side. Printing it answers the reader's questions in order.

    Attributes
    ----------
    labels : tuple of str
        Of the fits.
    data : str
        Whether the fits have the same data, and which, in words.
    rows : tuple of Row
        The measures.
    statements : tuple of str
        What they mean, in sentences.
    window, lead : float or None
        Lengths of the windows in s, as used in the first record in time: whole samples; None
        without one.
    windows : mapping of str to int
        How many there are on identification data and on held-out records.
    predictions : mapping of str to tuple of tuples
        For every fit the `Prediction` of every record, for figures.
    supported : str
        The label of the smallest structure that the data support; empty where that cannot be told.
    verdict : str
        Why, in one sentence.
    """

    labels: tuple[str, ...]
    data: str
    rows: tuple[Row, ...]
    statements: tuple[str, ...]
    window: float | None = None
    lead: float | None = None
    windows: Mapping[str, int] = field(default_factory=dict)
    predictions: Mapping[str, tuple[tuple[Prediction, ...], ...]] = field(
        default_factory=dict, repr=False
    )
    supported: str = ""
    verdict: str = ""

    @property
    def table(self) -> list[dict[str, Any]]:
        """The rows as plain values: data, output, measure, unit, and the value by label."""
        return [
            {"data": r.data, "output": r.output, "measure": r.measure, "unit": r.unit}
            | {"values": dict(zip(self.labels, r.values, strict=True))}
            for r in self.rows
        ]

    def value(self, measure: str, label: str, data: str = "fit", output: str = "") -> float | None:
        """Return one number of the table.

        Raises
        ------
        ValueError
            If there is none of that name.
        """
        found = [r for r in self.rows if (r.data, r.output, r.measure) == (data, output, measure)]
        if not found or label not in self.labels:
            raise ValueError(
                f"there is no {measure!r} of {label!r} for {data!r} and output {output!r} in the table."
            )
        return found[0].values[self.labels.index(label)]

    def __repr__(self) -> str:
        return one_line(self, f"of {', '.join(self.labels)}", counted(len(self.rows), "row"))

    def __str__(self) -> str:
        lines = [f"Comparison of {', '.join(self.labels)}", "", f"  data  {self.data}", ""]
        lines += [f"  {self.verdict}", ""] if self.verdict else []
        shown = self._shown()
        lines += self._section([r for r in shown if r.data == "fit"])
        rows = [r for r in self.rows if r.data == FREQUENCIES]
        if rows:
            lines += ["  left-out frequencies, predicted by the fit to the others", ""]
            lines += self._section(rows)
        for data in (IDENTIFICATION, HELD_OUT):
            rows = [r for r in self.rows if r.data == data]
            if rows:
                lines += [f"  {data} data: {self._windows(data)}", ""]
            for output in dict.fromkeys(r.output for r in rows):
                lines += self._section(
                    [r for r in shown if r.data == data and r.output == output], output
                )
        if len(shown) < len(self.rows):
            lines += [
                f"  The most telling {len(shown)} of {len(self.rows)} rows; `table` has all.",
                "",
            ]
        return "\n".join([*lines, *(f"  {text}" for text in self.statements)]).rstrip()

    def _shown(self) -> list[Row]:
        """Return the rows of the text: correlated signals first, and no details beyond a page."""
        outputs = dict.fromkeys((r.data, r.output) for r in self.rows)
        of_outputs = {key: [r for r in self.rows if (r.data, r.output) == key] for key in outputs}
        shown = [row for rows in of_outputs.values() for row in _without_uncorrelated(rows)]
        return shown if len(shown) <= PAGE else [row for row in shown if not row.is_detail]

    def _repr_html_(self) -> str:
        rows = [
            [r.data, r.output, r.measure, r.unit, *(_cell(v) for v in r.values)] for r in self.rows
        ]
        table = html_table(["data", "output", "measure", "unit", *self.labels], rows, (0, 1, 2, 3))
        title = html_text(f"Comparison of {', '.join(self.labels)}", "b") + html_text(
            f"Data: {self.data}"
        )
        return title + table + html_list(self.statements)

    def _windows(self, data: str) -> str:
        """Say how many windows there are and how long, as used: whole samples of records that may differ."""
        of = self.predictions[data][0]
        rows = [p for p in of if not p.data.has_time]
        of = [p for p in of if p.data.has_time]
        texts = [f"{counted(sum(map(len, rows)), 'row')}, each by itself"] if rows else []
        return " and ".join([*texts, *([self._windows_in_time(of)] if of else [])])

    def _windows_in_time(self, of: Sequence[Prediction]) -> str:
        window, lead = (
            " to ".join(dict.fromkeys((seconds(min(lengths)), seconds(max(lengths)))))
            for lengths in ([p.horizon for p in of], [p.lead for p in of])
        )
        samples = f" ({counted(of[0].rows.shape[1], 'sample')})" if len(of) == 1 else ""
        return f"{counted(sum(map(len, of)), 'window')} of {window} s{samples}, each from {lead} s before it"

    def _section(self, rows: Sequence[Row], title: str = "") -> list[str]:
        if not rows:
            return []
        cells = [[r.measure, r.unit, *(_cell(v) for v in r.values)] for r in rows]
        table = text_table([title, "", *self.labels], cells, left=(0, 1))
        return [*("  " + line for line in table.splitlines()), ""]


def _without_uncorrelated(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of one output with the signals that its errors are most clearly correlated with, first.

    The others are one row with the least of their p-values. Many signals are many tests: a p-value
    counts below its share of the limit (Bonferroni).
    """
    signals = list(dict.fromkeys(r.signal for r in rows if r.signal))
    least = {
        name: min(
            v
            for r in rows
            if r.signal == name and r.is_p_value
            for v in (*r.values, 1.0)
            if v is not None
        )
        for name in signals
    }
    found = [
        name
        for name in sorted(signals, key=lambda name: least[name])
        if least[name] < SIGNIFICANT / len(signals)
    ]
    told = found[:MOST_SIGNALS]
    result = [r for r in rows if not r.signal] + [
        r for name in told for r in rows if r.signal == name
    ]
    others = [r for r in rows if r.signal and r.signal not in told and r.is_p_value]
    if len(others) > 1:
        columns = zip(*(r.values for r in others), strict=True)
        values = tuple(
            min((v for v in column if v is not None), default=None) for column in columns
        )
        row = others[0]
        result.append(
            Row(row.data, row.output, f"  {len(others)} other signals (least p)", "", values)
        )
        return result
    return result + [r for r in rows if r.signal and r.signal not in told]


def _cell(value: float | None) -> str:
    return "-" if value is None else number(value, 5)


def p_text(p: float) -> str:
    """Return a p-value as it stands in a sentence."""
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
