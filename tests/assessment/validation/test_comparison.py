"""The table of a comparison, as values and as text."""

import math

import pytest

from greybox.assessment.validation.comparison import Comparison, Row
from greybox.data.files.numbers_in_text import p_text

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
    assert lines[4] == "  a is better."


def test_p_values_in_sentences():
    assert [p_text(p) for p in (0.0, 9e-5, 1e-4, 0.0123, 0.5)] == [
        "p < 0.0001",
        "p < 0.0001",
        "p = 0.0001",
        "p = 0.012",
        "p = 0.5",
    ]
    assert p_text(math.nan) == "p = -"


def test_tiny_p_values_are_limits_in_the_table():
    rows = (Row("held-out", "x", "  white (p)", "", (5.6e-165, 0.36)),)
    words = str(Comparison(("a", "b"), "all", rows, ())).split()
    assert words[-3:] == ["<", "0.0001", "0.36"]


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
