"""The page as a document: sections, links, what is left out."""

import re
from dataclasses import replace
from datetime import date
from importlib import import_module

import numpy as np
import pytest
from page_results import lag

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import Tilt
from greybox.reporting.html_report.fit_section import Entry, fit_section
from greybox.reporting.html_report.report import page


@pytest.fixture(scope="module")
def fit():
    return lag()


def headings(text):
    return re.findall("<h2>([^<]*)</h2>", text)


def test_one_result_has_its_sections_and_links_to_them(fit):
    text = page([Entry("lag", fit, fit.to_dict())], None, "a <title>")
    sections = [
        *("Verdict", "Parameters", "Equation", "Frequency response", "Time history", "Starts"),
        "Data and provenance",
    ]
    assert headings(text) == sections
    assert re.findall('<section id="([^"]*)"', text) == [
        name.lower().replace(" ", "-") for name in sections
    ]
    nav = text.partition("<nav")[2].partition("</nav>")[0]
    links = re.findall('<a href="#([^"]*)">([^<]*)</a>', nav)
    assert links == [(name.lower().replace(" ", "-"), name) for name in sections]
    assert "<h1>a &lt;title&gt;</h1>" in text
    assert "<title>a &lt;title&gt;</title>" in text


def test_several_results_have_details_that_are_open_up_to_three(fit, monkeypatch):
    # The name of the file is that of the function, too.
    file = import_module("greybox.reporting.html_report.report")
    assert file.OPEN == 3
    monkeypatch.setattr(file, "OPEN", 2)  # a smaller page
    alike = replace(fit, parts=fit.parts[:1], models=None)
    for count in (2, 3):
        text = page(
            [Entry(f"fit {k}", alike, alike.to_dict()) for k in range(count)], None, "several"
        )
        assert headings(text) == ["Comparison", *(f"fit {k}" for k in range(count))]
        assert re.findall('<section id="([^"]*)"', text) == [
            "comparison",
            *(f"result-fit-{k}" for k in range(count)),
        ]
        assert text.count("<details open") >= count * (count <= 2)
        assert ("<details open" in text) == (count <= 2)
    kept = [
        Entry("shown", fit, fit.to_dict()),
        Entry("kept", None, fit.to_dict()),
        Entry("bad", None, error="no log"),
    ]
    text = page(kept, None, "several")
    assert "Below are details of 1 result." in text
    assert headings(text) == ["Comparison", "shown"]


def test_what_cannot_be_reported_is_told(fit, tmp_path):
    with pytest.raises(ValueError, match="there is nothing to report: give at least one fit"):
        gb.report([], tmp_path / "x.html")
    with pytest.raises(TypeError, match="a result is 3: give fits, such as"):
        gb.report([fit, 3], tmp_path / "x.html")
    with pytest.raises(TypeError, match=r"a result is <Record .*: give fits, such as"):
        gb.report(gb.Record([0.0, 1.0], {"u": [1.0, 2.0]}), tmp_path / "x.html")
    with pytest.raises(TypeError, match=r"comparison is 3: give what gb\.compare returns"):
        gb.report(fit, tmp_path / "x.html", comparison=3)
    for margins in (3, [3]):
        with pytest.raises(TypeError, match=r"margins is 3: give what gb\.margins returns"):
            gb.report(fit, tmp_path / "x.html", margins=margins)
    with pytest.raises(ValueError, match=r"x\.pdf is not the name of a page: .* ends in \.html"):
        gb.report(fit, tmp_path / "x.pdf")
    assert list(tmp_path.iterdir()) == []


def test_the_title_is_that_of_the_fit_or_their_number(fit, tmp_path):
    brief = replace(fit, parts=fit.parts[:1], models=None)
    for fits, title in ((brief, fit.name), ([brief] * 2, "2 results side by side")):
        gb.report(fits, tmp_path / "x.html")
        assert f"<h1>{title}</h1>" in (tmp_path / "x.html").read_text(encoding="utf-8")
    gb.report(brief, tmp_path / "x.html", title="own", author="A. <b>")
    assert f'<h1>own</h1><p class="soft">A. &lt;b&gt;, {date.today()}</p>' in (
        tmp_path / "x.html"
    ).read_text(encoding="utf-8")
    assert np.geterr()["invalid"] != "ignore"


def captions(elements):
    return ["".join(title.itertext()) for element in elements for title in element.iter("strong")]


def test_of_many_records_the_worst_are_drawn(fit):
    response, record = fit.parts
    zero = replace(record.simulated, signals={"y": 0 * record.simulated["y"]})
    bad = replace(record, data=replace(record.data, name="bad"), simulated=zero)
    many = replace(fit, parts=(response, *(record,) * 3, bad, *(record,) * 3), models=None)
    sections = dict(fit_section(Entry("many", many)))
    said, drawn, residuals = sections["Time history"]
    assert said.text == "Of 7 records, the 6 with the worst fit are drawn."
    titles = captions([drawn])
    assert titles.count("Time history, bad") == 1
    assert (
        titles
        == ["Time history, flight"] * 3 + ["Time history, bad"] + ["Time history, flight"] * 2
    )
    assert len([c for c in captions([residuals]) if c.startswith("Residuals of")]) == 6
    few = dict(
        fit_section(Entry("few", replace(fit, parts=(response, *(record,) * 6), models=None)))
    )
    assert [element.tag for element in few["Time history"]] == ["div", "div"]


def test_remarks_explain_the_columns(fit):
    texts = [
        element.text
        for element in dict(fit_section(Entry("lag", fit, fit.to_dict())))["Parameters"][1:]
    ]
    assert texts[0].startswith("CR is the Cramér-Rao bound")


def test_a_page_without_some_of_the_details_says_how_to_see_them(fit):
    whole = [Entry("one", fit, fit.to_dict()), Entry("two", None, error="no start converged")]
    assert "of another member" not in page(whole, None, "study")
    some = page([*whole, Entry("three", None)], None, "study")
    assert "Below are details of 1 result." in some


def test_the_margins_of_one_loop_need_no_list(fit, tmp_path):
    answer = gb.margins(Tilt(), AttitudeController(rate=400, signals={"q": "theta_dot"}), {})
    gb.report(replace(fit, parts=fit.parts[:1], models=None), tmp_path / "x.html", margins=answer)
    assert headings((tmp_path / "x.html").read_text())[-1] == "Stability margins"
