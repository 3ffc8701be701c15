"""Printed answers are those of tests/golden/answers.txt, which tests/support/printed_answers.py renews."""

import json

import numpy as np
import pytest
from printed_answers import GOLDEN, Line, differences, printed

import greybox as gb
from greybox.problems import pitch_hover


def test_answers_are_printed_as_before():
    found = [*differences(GOLDEN.read_text(encoding="utf-8"), printed())]
    assert not found, "renew it if this is meant:\n" + "\n".join(found)


def test_words_and_numbers_are_compared_but_not_the_last_digit():
    assert not [*differences("a = 2.77 ± 0.49 of 1.00e-3", "a  = 2.78 ± 0.48 of 1.01e-3")]
    assert [*differences("a = 2.77", "a = 2.79")]
    assert [*differences("a = 2.77", "b = 2.77")]
    assert [*differences("a", "a\nb")]


def test_details_name_correlated_parameters_and_the_text_begins_with_the_verdict():
    random = np.random.default_rng(0)
    u = random.normal(4.0, 1.0, size=60)
    y = 2 * u + 1 + 0.1 * random.normal(size=60)
    rows = gb.Record(np.arange(60.0), {"u": u, "y": y}, has_time=False)
    fit = gb.fit(gb.Problem(Line(), rows), starts=2, progress=False)
    # Of a straight line by least squares, -mean(u) / rms(u).
    expected = -u.mean() / np.sqrt(np.mean(u**2))
    assert (
        f"beyond 0.9: slope and offset ({expected:.2f})".replace("-", "\N{MINUS SIGN}")
        in fit.details
    )
    assert "correlated" not in str(fit)
    assert str(fit).split("\n\n")[1].split()[0] in ("Good:", "In")


@pytest.mark.parametrize("options", [{}, {"max_iter": 1}], ids=["converged", "failed"])
def test_names_units_and_meanings_begin_below_their_headings(options):
    problem = pitch_hover.problem()
    fit = gb.fit(problem, starts=2, solver_options=options, profiles=False, progress=False)
    lines = str(fit).splitlines()
    k = next(k for k, line in enumerate(lines) if line.startswith("  parameter"))
    heading, rows = lines[k], lines[k + 2 :]
    # What goes on in a further row is indented to its column.
    for name, row in zip(fit.free, [row for row in rows if row[2:3] != " "], strict=False):
        assert row[heading.index("parameter") :].startswith(f"{name} ")
        assert row[heading.index("unit") :].startswith(f"{fit.by_name[name].unit} ")
        assert fit.by_name[name].about.startswith(row[heading.index("meaning") :])


def test_data_without_a_name_are_named_by_their_problem_unless_that_is_only_its_model():
    x = np.arange(9.0)
    tables = [
        gb.Record(x, {"u": x, "y": 2 * x + 1 + scatter * (x % 2)}, has_time=False)
        for scatter in (0.1, 0.2)
    ]
    label = Line().label
    named = gb.Problem(Line(), tables[0], name=f"{label} of steel")
    alike = gb.Problem(Line(), tables[0]) + gb.Problem(Line(), tables[1])
    fits = [gb.fit(problem, starts=1, progress=False) for problem in (named, alike)]
    assert json.loads(fits[0].to_json())["data"] == [f"{label} of steel"]
    assert json.loads(fits[1].to_json())["data"] == [table.checksum[:8] for table in tables]
