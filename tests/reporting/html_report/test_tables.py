"""Tables of the page, read cell by cell."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import Lag, measured
from page_results import lag

import greybox as gb
from greybox.assessment.printed import error_statement
from greybox.assessment.validation.comparison import Comparison, Row
from greybox.data.files.numbers_in_text import number, with_error
from greybox.reporting.html_report.comparison_section import comparison_section, overview
from greybox.reporting.html_report.elements import Cell, number_cell, parameter_table, table
from greybox.reporting.html_report.fit_section import Entry, data_summary, provenance, remarks


@pytest.fixture(scope="module")
def fit():
    return lag()


def texts(element):
    """The rows of a table, its header first."""
    return [["".join(cell.itertext()) for cell in row] for row in element.iter("tr")]


def facts(element):
    """A list of terms with what they are."""
    said = ["".join(part.itertext()) for part in element]
    return dict(zip(said[::2], said[1::2], strict=True))


@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_what_is_not_known_is_a_dash(value):
    assert number_cell(value).text == "–"
    assert number_cell(value).value is None


def test_columns_with_a_number_are_sorted_by_it():
    rows = [
        [Cell("a"), Cell("-1.5", -1.5)],
        [Cell("a-b"), Cell("–")],
        [Cell("x" * 25), Cell("∞", math.inf, "doubt")],
    ]
    made = table(["name", "value"], rows)
    assert texts(made) == [["name", "value"], ["a", "−1.5"], ["a-b", "–"], ["x" * 25, "∞"]]
    assert [cell.get("class") for cell in made.iter("th")] == [None, "number"]
    cells = list(made.iter("td"))
    assert [cell.get("class") for cell in cells] == [
        None,
        "number",
        None,
        "number",
        "prose",
        "doubt number",
    ]
    assert [cell.get("data-value") for cell in cells] == [None, "-1.5", None, None, None, None]


def test_parameters_stand_with_errors_intervals_and_shares(fit):
    bound = replace(
        fit, quantities=(replace(fit.quantities[0], at_bound=True), *fit.quantities[1:])
    )
    header, *rows = texts(parameter_table(fit))
    assert header[3] == "95 % interval"
    judged = fit.identifiability
    for q, row in zip(fit.quantities, rows, strict=True):
        value, error = with_error(q.value, q.standard_error)
        low, high = fit.interval(0.95)[q.name]
        k = judged.names.index(q.name)
        share, alone = (100 * float(s[k]) for s in (judged.error, judged.insensitivity))
        assert row[:3] == [q.name, value.replace("-", "−"), error]
        ends = [float(end.replace("−", "-")) for end in row[3].split(" to ")]
        assert ends == pytest.approx([low, high], abs=0.03 * (high - low))
        assert len(row[3]) < 20  # no more digits than the error has
        assert [float(cell.removesuffix(" !")) for cell in row[4:6]] == pytest.approx(
            [share, alone], rel=0.06
        )
        # Bounds that the model computed say nothing.
        bounds = "" if q.has_computed_bounds else f"[{q.bounds[0]:g}, {q.bounds[1]:g}]"
        assert row[6:] == [q.unit, bounds, "", q.about]
    assert texts(parameter_table(bound))[1][8] == "AT BOUND"
    plain = replace(fit, quantities=(replace(fit.quantities[0], unit="1"),))
    sides = {head.text: head.get("class") for head in parameter_table(plain).iter("th")}
    assert (sides["estimate"], sides["unit"]) == ("number", None)
    symbol = replace(fit.quantities[0], about=r"lag $\tau$")
    meaning = next(parameter_table(replace(fit, quantities=(symbol,))).iter("tbody"))[0][-1]
    assert (meaning.text, meaning[0].tag, meaning[0].get("alt")) == ("lag ", "img", r"\tau")


def test_provenance_of_a_response_has_the_costs_of_other_criteria():
    omega = np.geomspace(0.2, 20, 12)
    data = measured(Lag(), omega, {"K": 3.0, "T": 0.5}, noise=0.05)
    fit = gb.fit(gb.Problem(Lag(), data), starts=[{}], progress=False)
    stated = facts(provenance(fit)[0])["other criteria"]
    others = {name: cost for name, cost in fit.costs.items() if name != fit.criterion}
    assert math.isnan(others.pop("maximum-likelihood"))
    assert "maximum-likelihood" not in stated
    assert all(f"{name} {number(cost)}" in stated for name, cost in others.items())


def test_provenance_says_where_everything_came_from(fit):
    fact, data, *_ = provenance(replace(fit, independent=None, command=("fit", "my lag")))
    said = facts(fact)
    assert said.pop("time").endswith(" s")
    assert said.pop("correlated", "beyond 0.9: ").startswith("beyond 0.9: ")
    assert said.pop("versions").startswith("greybox")
    assert said == {
        "made by": "greybox fit 'my lag'",
        "starts": f"3 of 3 converged; 3 agree on the best of 1 distinct minimum; {fit.starts}",
        "agreement": said["agreement"],
        "cost": f"{fit.cost:.6g}  ({fit.rule})",
        "delay": fit.delay,
        "seed": "0",
        "standard errors": error_statement(replace(fit, independent=None)),
    }
    said = facts(provenance(replace(fit, seed=None, dof=1.0))[0])
    assert "other criteria" not in said
    assert said["seed"] == "none"
    assert "made by" not in said
    assert "1 degree of freedom" in said["standard errors"]
    assert "standard errors" not in facts(provenance(replace(fit, directions=None))[0])

    response, record = fit.parts
    at = f"input u of {record.name}"
    assert facts(provenance(fit)[2]) == {
        f"solved by of {record.name}": record.method,
        at: record.between["u"],
    }
    first, second = (part.data.checksum for part in fit.parts)
    assert texts(data)[1:] == [
        [
            response.name,
            response.label,
            "u → y",
            "12 points",
            "1 to 20 rad/s",
            response.criterion,
            "1",
            "sweep.csv",
            first,
        ],
        [
            record.name,
            record.label,
            "u → y",
            "200 samples",
            "9.95 s at 20 Hz",
            record.criterion,
            "1",
            "–",
            second,
        ],
    ]
    assert data_summary(fit) == (
        f"{response.label} with 2 free parameters, fitted to 12 points in 1 frequency response and "
        f"{record.compared} samples in 1 record by {fit.rule}."
    )


def test_results_side_by_side_stand_in_one_table(fit):
    failed = Entry("bad", None, error="no log")
    warned = replace(fit, name="warned", warnings=("one", "two"))
    entries = [
        Entry("lag", fit, fit.to_dict()),
        Entry("warned", warned, warned.to_dict()),
        failed,
        Entry("none", None),
    ]
    header, first, second, *rest = texts(overview(entries))
    assert header == [
        "result",
        "verdict",
        "model",
        "criterion",
        "cost",
        "starts agreeing",
        "warnings",
        "data",
    ]
    answer = fit.to_dict()
    models, data = ", ".join(answer["model"]), ", ".join(answer["data"])
    agreeing = f"{fit.agreeing} of {answer['starts']}"
    cost = number(fit.cost, 6).replace("-", "−")
    grade = {"good": "good", "doubt": "in doubt"}
    assert first == [
        "lag",
        grade[answer["verdict"]["grade"]],
        models,
        fit.criterion,
        cost,
        agreeing,
        str(len(fit.warnings)),
        data,
    ]
    assert second[6] == "2"
    assert [row[:2] for row in rest] == [["bad", "no log"], ["none", "no result"]]
    assert [a.get("href") for a in overview(entries).iter("a")] == [
        "#result-lag",
        "#result-warned",
    ]


def test_estimates_of_several_fits_stand_with_their_errors(fit):
    other = replace(
        fit,
        name="other",
        quantities=(replace(fit.quantities[0], standard_error=math.nan), fit.quantities[1]),
    )
    heading, estimates, *compared = comparison_section(
        [Entry("a", fit, fit.to_dict()), Entry("b", other, other.to_dict())], None
    )
    assert heading.text == "Estimates with standard errors"
    names = [q.name for q in fit.quantities]
    header, first, second = texts(estimates)
    assert header == ["result", *names]
    for q, cell in zip(fit.quantities, first[1:], strict=True):
        assert cell == " ± ".join(with_error(q.value, q.standard_error)).replace("-", "−")
    assert "±" not in second[1]
    assert "±" in second[2]
    assert [part.text for part in compared if part.tag == "h3"] == ["Comparison"]
    assert compared[-1].get("class") == "figures"
    titles = ["".join(title.itertext()) for title in compared[-1].iter("strong")]
    assert titles == ["Bode diagram, y/u", "Nyquist diagram, y/u", "Time history, flight"]
    # One fit alone is compared with nothing, and seven are too many for a figure.
    assert [
        part.text
        for part in comparison_section([Entry("a", fit, fit.to_dict())], None)
        if part.tag == "h3"
    ] == [heading.text]
    many = [Entry(str(k), fit, fit.to_dict()) for k in range(7)]
    assert [part.tag for part in comparison_section(many, None)] == ["h3", "div"]


def entry(label, **known):
    """A result whose fit is not loaded: values by name, and their errors."""
    values = {name: pair[0] for name, pair in known.items()}
    errors = {name: pair[1] for name, pair in known.items()}
    numbers = {"converged": True, "estimate": values, "derived": {}, "standard_error": errors}
    return Entry(label, None, numbers)


def test_quantities_that_a_result_has_not_are_empty_and_unknown_ones_a_dash():
    first, second = entry("one", a=(2.0, 0.25), b=(None, None)), entry("two", c=(3.0, None))
    _, made = comparison_section([first, second], None)
    assert texts(made) == [
        ["result", "a", "b", "c"],
        ["one", "2.00 ± 0.25", "–", ""],
        ["two", "", "", "3"],
    ]


def test_a_page_shows_small_probabilities_as_the_text_does():
    rows = (Row("held-out", "x", "  white (p)", "", (5.6e-165, 0.3612)),)
    *_, made = comparison_section([], Comparison(("a", "b"), "all", rows, ()))
    assert texts(made)[1][-2:] == ["< 0.0001", "0.36"]


def test_combinations_are_told_below_the_parameters():
    judged = SimpleNamespace(combinations=("a b", "c / d"))
    unprofiled = SimpleNamespace(directions=(), identifiability=judged)
    _, combined = (part.text for part in remarks(unprofiled))
    assert combined == "Determined in combination: a b; c / d."
    assert remarks(SimpleNamespace(directions=None)) == []
