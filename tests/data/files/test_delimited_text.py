"""Tables as spreadsheets, loggers and numpy write them: one truth in every spelling, and no number read wrongly."""

import io
import itertools

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import greybox as gb
from greybox.data.files.delimited_text import read_delimited

RANDOM = np.random.default_rng(3)
TRUTH = np.column_stack([0.02 * np.arange(1, 31), RANDOM.normal(size=(30, 2)).round(5)])
NAMES = ("time [s]", "pitch [deg]", "Böe")
RESPONSE = ("omega_rad_s", "alpha", "beta")


def spelled(names, table, separator=",", comma=False, end="\n", before="", between=""):
    """Write a table of numbers in one of the usual ways."""
    rows = [
        separator.join(names),
        *(separator.join(f"{value!r}" for value in row.tolist()) for row in table),
    ]
    text = end.join([*rows[:3], *([between] if between else []), *rows[3:], ""])
    head, _, body = text.partition(end)
    return before + head + end + (body.replace(".", ",") if comma else body)


def saved(folder, text, encoding="utf-8", name="flight.csv"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


SPELLINGS = [
    {"separator": s, "comma": c, "end": e, "before": b, "between": m}
    for s, c, e, (b, m) in itertools.product(
        ",;\t",
        (False, True),
        ("\n", "\r\n", "\r"),
        (("", ""), ("# made by a logger\n", "# here the wind rose, 5.5 m/s")),
    )
    if not (c and s == ",")
]


@pytest.mark.parametrize(
    "how", SPELLINGS, ids=lambda how: repr(how["separator"] + "," * how["comma"] + how["end"])
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
def test_one_truth_in_every_spelling(tmp_path, how, encoding):
    record = gb.read(saved(tmp_path, spelled(NAMES, TRUTH, **how), encoding))["flight"]
    assert list(record.signals) == ["pitch", "Böe"]
    assert_array_equal(np.column_stack([record.time, record["pitch"], record["Böe"]]), TRUTH)
    response = gb.read_response(
        saved(tmp_path, spelled((*RESPONSE[:2], "beta"), TRUTH, **how), encoding)
    )
    assert_array_equal(np.column_stack([response.omega, response.alpha, response.beta]), TRUTH)


def test_the_header_that_numpy_writes_is_a_comment(tmp_path):
    text = io.StringIO()
    np.savetxt(text, TRUTH, delimiter=",", header="flight 7\ntime,u,y")
    assert_array_equal(gb.read(saved(tmp_path, text.getvalue()))["flight"]["y"], TRUTH[:, 2])
    text = text.getvalue().replace("time,u,y", ",".join(RESPONSE))
    assert_array_equal(gb.read_response(saved(tmp_path, text)).beta, TRUTH[:, 2])


def test_separators_that_excel_states_and_adds(tmp_path):
    text = "sep=;\n" + spelled(NAMES, TRUTH, ";", comma=True).replace("\n", ";;\n")
    assert_array_equal(gb.read(saved(tmp_path, text))["flight"]["pitch"], TRUTH[:, 1])
    quoted = "t;x\n" + "".join(f'"0,{k}";"{k},5"\n' for k in range(5))
    assert_array_equal(gb.read(saved(tmp_path, quoted))["flight"]["x"], np.arange(5) + 0.5)


def test_a_typographic_minus_is_a_minus(tmp_path):
    assert_array_equal(gb.read(saved(tmp_path, "t,x\n0,−1.5\n1,2\n"))["flight"]["x"], [-1.5, 2])


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            ["1,5;2;3", "2.5;3;4"],
            r"line 2, has '1,5' where line 3 has '2\.5': write all numbers with one decimal mark",
        ),
        (["1;2.5;3", "2;1,000;4"], r"line 3, has '1,000' where line 2 has '2\.5'"),
        (
            ["1;2;3", "2;1,000;4"],
            "line 3: '1,000' may have a decimal comma or a thousands separator",
        ),
        (["1;2;3", "2;1.234,5;4"], r"line 3: '1\.234,5' has a thousands separator"),
        (["1;2;3", "2;1,234.5;4"], r"line 3: '1,234\.5' has a thousands separator"),
        (["1;2;3", "2;3;4;5"], "line 3, has 4 cells where the header, .*, has 3: name all columns"),
        (["1,5,2,5,3", "2,5,3,5,4"], "line 2, has 5 cells where the header, .*, has 3"),
    ],
)
@pytest.mark.parametrize("kind", ["record", "response"])
def test_what_can_be_read_in_two_ways_is_refused_with_its_line(tmp_path, rows, words, kind):
    separator = ";" if ";" in rows[0] else ","
    names = ("time", "u", "y") if kind == "record" else RESPONSE
    path = saved(tmp_path, "\n".join([separator.join(names), *rows, ""]))
    with pytest.raises(ValueError, match=words):
        gb.read(path) if kind == "record" else gb.read_response(path)


def test_a_comma_in_a_text_column_decides_nothing(tmp_path):
    record = gb.read(saved(tmp_path, "t;x;note\n0;0.5;calm, then gusts\n1;1.5;gain 3, 4\n"))[
        "flight"
    ]
    assert_array_equal(record["x"], [0.5, 1.5])


def test_digits_with_underscores_are_no_numbers(tmp_path):
    with pytest.raises(ValueError, match="line 2: beta is '1_5', which is not a number"):
        gb.read_response(saved(tmp_path, "omega_rad_s,alpha,beta\n1,2,1_5\n"))
    recording = gb.read(saved(tmp_path, "t [s],x\n0,1\n1,1_5\n2,2\n"))
    assert_array_equal(recording["flight"]["x"], [1, np.nan, 2])
    assert recording.findings == (
        "cells that are not finite numbers, which count as missing: x (1 cell, the first '1_5' in line 3).",
    )


def test_unicode_text_of_a_spreadsheet_is_read(tmp_path):
    # Excel saves "Unicode Text" as UTF-16 with tabs.
    [record] = gb.read(saved(tmp_path, "t\tBöe\n0\t1,5\n1\t2,5\n", "utf-16")).records.values()
    assert record["Böe"].tolist() == [1.5, 2.5]


def test_zero_bytes_are_refused_with_the_cure(tmp_path):
    path = tmp_path / "data.csv"
    path.write_bytes(b"t,x\n0,1\n\x00\x00,2\n")
    for read in (gb.read, gb.read_response):
        with pytest.raises(ValueError, match=r"is not a CSV text file.*: save it as UTF-8"):
            read(path)


@pytest.mark.parametrize(
    "text",
    [
        "time  x\n 0.0  1.5\n 0.1  2.5\n",
        "  time [s]   x [mm]\n  0.0   1.5\n  0.1   2.5\n",
        "# gain: 2 of 3\n# time x\n0 1.5\n0.1 2.5\n",
        "time\tx y\n0.0\t1.5\n0.1\t2.5\n",
        "time x\n[s] [mm]\n0.0 1.5\n0.1 2.5\n",
    ],
)
def test_blanks_separate_numbers(tmp_path, text):
    [record] = gb.read(saved(tmp_path, text, "utf-8")).records.values()
    assert record.time.tolist() == [0.0, 0.1]
    [values] = record.signals.values()
    assert values.tolist() == [1.5, 2.5]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ('t, x\n0, "1.5"\n1, "2.5"\n', [1.5, 2.5]),  # blanks before quotes
        ('"t", "x"\n0,1.5\n1,2.5\n', [1.5, 2.5]),
        ("t,x,\n0,1.5,\n1,2.5, , \n", [1.5, 2.5]),  # separators at the end of lines
        ("sep=;\nt;x\n0;1.5\n1;2.5\n", [1.5, 2.5]),
        ("sep=,\nt,x\n0,1.5\n1,2.5\n", [1.5, 2.5]),
        ("SEP=;\nt;x, y\n0;1.5\n1;2.5\n", [1.5, 2.5]),
        ("# t,x\n0,1.5\n1,2.5\n", [1.5, 2.5]),
        ("% t;x\n\n0;1.5\n1;2.5\n", [1.5, 2.5]),
        ("t;x\n0;1,5\n1;2\n", [1.5, 2]),
        ("t;x\n0;1,5000\n1;2,125\n", [1.5, 2.125]),  # four digits are no thousands
        ("t;x\n0;0,125\n1;2,125\n", [0.125, 2.125]),  # nor is a zero
        ("t;x\n0;+1,5e1\n1;-,5\n", [15, -0.5]),
        ("t;x\n0;1,\n1;2,\n", [1, 2]),
        ("t;x\n0;1.\n1;.5\n", [1, 0.5]),
        ("x\n1.5\n2.5\n", [1.5, 2.5]),  # one column
    ],
)
def test_the_second_column_is_read_in_each_spelling(tmp_path, text, values):
    (record,) = gb.read(saved(tmp_path, text)).values()
    assert_array_equal(next(iter(record.signals.values())), values)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "t;x\n0;1,234\n1;12,345\n",
            "line 2: '1,234' may have a decimal comma or a thousands separator",
        ),
        ("t;x\n0;1,5\n1;2.5\n", r"line 2, has '1,5' where line 3 has '2\.5'"),
        ("t;x\n0;2.5\n1;1,5\n2;7,5\n3;2.6\n", r"line 3, has '1,5' where line 2 has '2\.5'"),
        ("t;x\n0;1,234,567\n", "line 2: '1,234,567' has a thousands separator: leave it out"),
        (
            "t,x\n0,1,2\n",
            "line 2, has 3 cells where the header, t,x, has 2: name all columns, .*, if its numbers",
        ),
        (
            "t;x\n\n# wind\n0;1\n1;2;3\n",
            "line 5, has 3 cells where the header, t;x, has 2: name all columns, .* with #\\.",
        ),
    ],
)
def test_the_line_of_a_mistake_is_named(tmp_path, text, words):
    with pytest.raises(ValueError, match=words):
        gb.read(saved(tmp_path, text))


@pytest.mark.parametrize(
    "above",
    [
        '"Flight 12, elevator; CG 25 %"\n',
        "Record Length,2500\nSample Interval,2E-4\n",
        "Model,DS1054Z\n\nLabel,supply,current\n",
    ],
)
def test_a_title_and_settings_above_the_header_are_skipped(tmp_path, above):
    path = tmp_path / "scope.csv"
    rows = "".join(f"{0.1 * k:.1f},{k}.5,{-k}.5\n" for k in range(12))
    raw = f"{above}TIME,CH1,CH2\n{rows}"
    table = read_delimited(path, raw.encode())
    assert table.header == ("TIME", "CH1", "CH2")
    assert len(table.lines) == 12
    assert table.line_numbers[0] == above.count("\n") + 2
