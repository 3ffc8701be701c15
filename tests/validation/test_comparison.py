"""The table of a comparison, as values and as text."""

import math
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from greybox.validation.comparison import Comparison, Row, _without_uncorrelated, p_text

ROWS = (
    Row("fit", "", "AIC", "", (3.0, None)),
    Row("fit", "", "free parameters", "", (2.0, 4.0)),
)


def test_values_are_found_by_measure_and_label():
    found = Comparison(("a", "b"), "the same for all", ROWS, ("a is better.",))
    assert found.value("AIC", "a") == 3.0
    assert found.value("AIC", "b") is None
    for arguments in (
        ("BIC", "a"),
        ("AIC", "c"),
        ("AIC", "a", "held-out"),
        ("AIC", "a", "fit", "v"),
    ):
        with pytest.raises(ValueError, match="there is no"):
            found.value(*arguments)
    assert found.table[1] == {
        "data": "fit",
        "output": "",
        "measure": "free parameters",
        "unit": "",
        "values": {"a": 2.0, "b": 4.0},
    }


def test_it_prints_the_table_and_the_sentences():
    text = str(Comparison(("a", "b"), "the same for all", ROWS, ("a is better.",)))
    lines = text.splitlines()
    assert lines[0] == "Comparison of a, b"
    assert lines[2] == "  data  the same for all"
    assert any(line.split() == ["AIC", "3", "-"] for line in lines)
    assert lines[-1] == "  a is better."


def test_many_signals_fill_no_page():
    signals = [f"u{k}" for k in range(17)]
    rows = []
    for data, output in ((d, o) for d in ("identification", "held-out") for o in ("p", "q", "r")):
        rows += [
            Row(data, output, f"measure {k}", "", (1.0, 2.0), is_detail=k > 3) for k in range(14)
        ]
        for k, name in enumerate(signals):
            p = (0.4, 1e-9 if k == 11 else 1e-4 if k == 5 else 0.2)
            rows.append(Row(data, output, f"  not correlated with {name} (p)", "", p, name))
            rows.append(
                Row(
                    data,
                    output,
                    f"  lags of {name} beyond 99 %",
                    "",
                    (1.0, 7.0),
                    name,
                    is_detail=True,
                )
            )
    windows = dict.fromkeys(("identification", "held-out"), ((),))
    found = Comparison(
        ("a", "b"), "the same for all", (*ROWS, *rows), predictions=windows, statements=()
    )
    text = str(found).splitlines()
    assert len(text) < 75  # a page; all rows are 290
    said = [line.split()[3] for line in text if line.lstrip().startswith("not correlated")]
    assert said == ["u11", "u5"] * 6  # the largest findings, and these first
    assert sum("15 other signals (least p)" in line for line in text) == 6
    assert len(found.table) == len(ROWS) + 6 * 48


def test_p_values_in_sentences():
    assert [p_text(p) for p in (0.0, 9e-5, 1e-4, 0.0123, 0.5)] == [
        "p < 0.0001",
        "p < 0.0001",
        "p = 0.0001",
        "p = 0.012",
        "p = 0.5",
    ]
    assert p_text(math.nan) == "p = nan"


def test_one_signal_that_is_not_correlated_is_told_by_itself_and_several_by_the_least():
    def row(name, *values):
        return Row("held-out", "p", f"  not correlated with {name} (p)", "", values, name)

    plain, found, one = (
        Row("held-out", "p", "fit", "%", (1.0, 2.0)),
        row("u", 1e-9, 0.4),
        row("w", 0.4, 0.2),
    )
    assert _without_uncorrelated([plain, one, found]) == [plain, found, one]
    last = _without_uncorrelated([plain, one, found, row("z", 0.3, None)])[-1]
    assert (last.measure, last.values) == ("  2 other signals (least p)", (0.3, 0.2))


def test_rows_stand_under_their_data_and_output():
    rows = tuple(
        Row(data, output, f"{data} {output}", "", (float(k), None))
        for k, (data, output) in enumerate(
            (d, o) for d in ("identification", "held-out") for o in ("p", "q")
        )
    )
    windows = dict.fromkeys(("identification", "held-out"), ((),))
    found = Comparison(
        ("a", "b"), "the same for all", (*ROWS, *rows), predictions=windows, statements=()
    )
    lines = [line.split() for line in str(found).splitlines()]
    begins = [
        lines.index(next(w for w in lines if w[:2] == [kind, "data:"]))
        for kind in ("identification", "held-out")
    ]
    for kind, part in zip(
        ("identification", "held-out"),
        (lines[begins[0] : begins[1]], lines[begins[1] :]),
        strict=True,
    ):
        assert [words[:2] for words in part if words[:1] == [kind] and words[-1] == "-"] == [
            [kind, "p"],
            [kind, "q"],
        ]


def test_a_notebook_shows_all_rows_and_statements():
    shown = Comparison(("a", "b<"), "the same for all", ROWS, ("a is better.",))._repr_html_()
    body = ET.fromstring(f"<div>{shown}</div>")
    header, *rows = [["".join(cell.itertext()) for cell in row] for row in body.iter("tr")]
    assert header == ["data", "output", "measure", "unit", "a", "b<"]
    assert rows == [["fit", "", "AIC", "", "3", "-"], ["fit", "", "free parameters", "", "2", "4"]]
    said = "".join(body.itertext())
    assert said.startswith("Comparison of a, b<")
    assert "Data: the same for all" in said
    assert said.endswith("a is better.")
    assert repr(Comparison(("a", "b"), "", ROWS, ())) == "<Comparison of a, b, 2 rows>"


class Windows(list):
    """Predictions over so many windows of so many samples each, in s."""

    def __init__(self, count, samples=0, horizon=0.0, lead=0.0):
        super().__init__(range(count))
        self.data = SimpleNamespace(has_time=samples > 0)
        self.rows, self.horizon, self.lead = np.zeros((count, samples)), horizon, lead


@pytest.mark.parametrize(
    ("of", "said"),
    [
        ([Windows(7, 50, 1.0, 0.5)], "7 windows of 1 s (50 samples), each from 0.5 s before it"),
        (
            [Windows(7, 50, 1.0, 0.5), Windows(2, 40, 1.25, 0.5)],
            "9 windows of 1 to 1.25 s, each from 0.5 s before it",
        ),
        ([Windows(3), Windows(5)], "8 rows, each by itself"),
        (
            [Windows(3), Windows(1, 20, 2.0, 0.25)],
            "3 rows, each by itself and 1 window of 2 s (20 samples), each from",
        ),
    ],
)
def test_windows_are_counted_with_their_lengths(of, said):
    found = Comparison(("a",), "", (), (), predictions={"held-out": (tuple(of),)})
    assert found._windows("held-out").startswith(said)


def test_details_are_left_out_beyond_a_page_of_45_rows():
    for count, shown in ((45, 45), (46, 40)):
        rows = [Row("fit", "", f"m{k}", "", (1.0,), is_detail=k >= 40) for k in range(count)]
        text = str(Comparison(("a",), "", tuple(rows), ()))
        assert (
            sum(line.split()[:1] == [f"m{k}"] for k in range(count) for line in text.splitlines())
            == shown
        )
        assert (f"The most telling 40 of {count} rows; `table` has all." in text) == (shown < count)


def test_a_signal_counts_below_its_share_of_the_limit_and_three_are_told():
    def rows(*p_values):
        return [
            Row("held-out", "p", f"{k} (p)", "", (0.9, p), f"u{k}") for k, p in enumerate(p_values)
        ]

    told = _without_uncorrelated(rows(0.011, 0.009, 0.013, 0.0124))
    assert [row.measure for row in told] == [
        "1 (p)",
        "0 (p)",
        "3 (p)",
        "2 (p)",
    ]  # below 0.05 / 4, by size; then the other
    told = _without_uncorrelated(rows(4e-3, 3e-3, 2e-3, 1e-3, 5e-3))
    assert [row.measure for row in told] == [
        "3 (p)",
        "2 (p)",
        "1 (p)",
        "  2 other signals (least p)",
    ]
    assert told[-1].values == (0.9, 4e-3)
