"""The page as a document: sections, links, what is left out."""

import re

import numpy as np
import pytest
from page_results import lag

import greybox as gb
from greybox.html_report.entry import Entry
from greybox.html_report.page import LARGEST, page
from greybox.html_report.report import with_bootstraps, write_page


@pytest.fixture(scope="module")
def fit():
    return lag()


def headings(text):
    return re.findall("<h2>([^<]*)</h2>", text)


def test_one_result_has_its_sections_and_links_to_them(fit):
    text = page([Entry("lag", fit)], None, "a <title>")
    sections = [
        "Verdict", "Parameters", "Equation", "Frequency response", "Time history", "What the data tell", "Starts",
        "Data and provenance",
    ]  # fmt: skip
    assert headings(text) == sections
    assert re.findall('<section id="([^"]*)"', text) == [name.lower().replace(" ", "-") for name in sections]
    nav = text.partition("<nav")[2].partition("</nav>")[0]
    links = re.findall('<a href="#([^"]*)">([^<]*)</a>', nav)
    assert links == [(name.lower().replace(" ", "-"), name) for name in sections]
    assert "<h1>a &lt;title&gt;</h1>" in text
    assert "<title>a &lt;title&gt;</title>" in text


def test_several_results_have_details_that_are_open_up_to_three(fit):
    for count in (3, 4):
        text = page([Entry(f"fit {k}", fit) for k in range(count)], None, "several")
        assert headings(text) == ["Comparison", *(f"fit {k}" for k in range(count))]
        assert re.findall('<section id="([^"]*)"', text) == ["comparison", *(f"result-{k + 1}" for k in range(count))]
        assert text.count("<details open") >= count * (count <= 3)
        assert ("<details open" in text) == (count <= 3)
        assert "left out" not in text
        assert len(text.encode()) < LARGEST
    kept = [Entry("shown", fit), Entry("kept", None, fit.to_dict()), Entry("bad", None, error="no log")]
    text = page(kept, None, "several")
    assert "Below are details of 1 result, the best of each data set and criterion or those asked for;" in text
    assert headings(text) == ["Comparison", "shown"]


def test_what_cannot_be_reported_is_told(fit, tmp_path):
    with pytest.raises(ValueError, match="there is nothing to report: give at least one fit"):
        write_page([], tmp_path / "x.html")
    with pytest.raises(TypeError, match="cannot report 3: give fits, such as"):
        gb.report([fit, 3], tmp_path / "x.html")
    with pytest.raises(TypeError, match=r"comparison is 3: give what gb\.compare returns"):
        gb.report(fit, tmp_path / "x.html", comparison=3)
    with pytest.raises(ValueError, match="a bootstrap is not understood: give what greybox bootstrap"):
        with_bootstraps([Entry("lag", fit)], [{"problem": "lag"}])
    said = {"about": "x", "replicates": 9, "failed": 0, "seed": 5, "level": 0.9, "warnings": [], "quantities": {}}
    with pytest.raises(ValueError, match="there is a bootstrap of 'lead', and no fit of that name on this page"):
        with_bootstraps([Entry("lag", fit)], [{**said, "problem": "lead"}])
    first, second = with_bootstraps([Entry("lag", fit), Entry("none", None)], [{**said, "problem": fit.name}])
    assert (first.bootstrap["seed"], second.bootstrap) == (5, {})
    assert list(tmp_path.iterdir()) == []


def test_the_title_is_that_of_the_fit_or_their_number(fit, tmp_path):
    for entries, title in (([Entry("a", fit)], fit.name), ([Entry("a", fit)] * 2, "2 results side by side")):
        write_page(entries, tmp_path / "x.html")
        assert f"<h1>{title}</h1>" in (tmp_path / "x.html").read_text(encoding="utf-8")
    write_page([Entry("a", fit)], tmp_path / "x.html", title="own")
    assert "<h1>own</h1>" in (tmp_path / "x.html").read_text(encoding="utf-8")
    assert np.geterr()["invalid"] != "ignore"
