"""The page in a browser.

Figures are there and can be read and zoomed, tables sorted, and names do no harm.
"""

import math
import os
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from page_results import MARKUP, crafted, lag
from scipy import stats

import greybox as gb
from greybox.reporting.html_report.report import members_of

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)


@pytest.fixture(scope="module")
def fit():
    return lag()


@pytest.fixture(scope="module")
def browser():
    driver = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install playwright"
    )
    if CHROMIUM is None:
        pytest.skip("no Chromium in the path: apt-get install chromium")
    with driver.sync_playwright() as playwright:
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def one(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "lag.html"
    gb.report(fit, path)
    return path


def open_page(browser, path, **options):
    """Open a page; what it complains of and what it asks the network for is gathered."""
    shown = browser.new_page(**options)
    shown.trouble = []
    shown.on("console", lambda message: shown.trouble.append(message.text))
    shown.on("pageerror", lambda error: shown.trouble.append(str(error)))
    shown.on(
        "request",
        lambda request: None if request.url == path.as_uri() else shown.trouble.append(request.url),
    )
    shown.goto(path.as_uri())
    shown.wait_for_selector(".area svg .panel")
    return shown


@pytest.fixture
def show(browser):
    """Open pages of a test's own."""
    opened = []

    def open_another(path, **options):
        opened.append(open_page(browser, path, **options))
        return opened[-1]

    yield open_another
    for shown in opened:
        assert shown.trouble == []
        shown.close()


@pytest.fixture(scope="module")
def opened(browser, one):
    return open_page(browser, one)


@pytest.fixture
def shown(opened):
    """The open page of the fit, which a test leaves as it was but for what is focused or sorted."""
    yield opened
    assert opened.trouble == []


def test_every_figure_is_drawn_and_shows_its_numbers(shown, fit):
    titles = shown.locator("figcaption strong").all_inner_texts()
    assert {"Bode diagram, y/u", "Nyquist diagram, y/u", "Time history, flight", "Starts"} <= set(
        titles
    )
    assert len(titles) == shown.locator(".plot").count()
    for plot in shown.locator(".plot").all():
        assert plot.locator(".panel").count() >= 1
        sizes = "paths => paths.map(path => path.getBoundingClientRect()).map(b => Math.max(b.width, b.height))"
        assert min(plot.locator("path.line, path.marks").evaluate_all(sizes)) > 3
    # One subpath a measured point, inside the frame.
    marks = shown.locator(".plot >> nth=0 >> .panel >> nth=0 >> path.marks")
    assert marks.get_attribute("d").count("M") == len(fit.parts[0].data)
    assert shown.locator("tbody tr").count() >= len(fit.quantities) + len(fit.parts)


def test_every_axis_has_a_scale_and_points_their_frequencies(show, one):
    for width in (1200, 390):
        shown = show(one, viewport={"width": width, "height": 900})
        scales = (
            "panels => panels.map(panel => panel.querySelectorAll('text[text-anchor=end]').length)"
        )
        assert min(shown.locator(".panel").evaluate_all(scales)) >= 2
        (plane,) = shown.locator("figure:has-text('Nyquist')").all()
        assert plane.locator("text.beside").count() >= 3
        assert plane.locator("path.band").count() == 1  # the confidence ellipses of the curve


def test_seconds_since_1970_are_counted_from_a_round_number(show, fit, tmp_path):
    _, record = fit.parts
    late = replace(record.data, time=1.7e9 + record.data.time)
    simulated = replace(record.simulated, time=late.time)
    part = replace(record, data=late, simulated=simulated)
    gb.report(replace(fit, parts=(part,), models=None), tmp_path / "late.html")
    area = show(tmp_path / "late.html").locator(".area").first
    assert {"2", "4", "6", "8", "Time, s +1.7e9"} <= {*ticks(area)}


def test_frequencies_are_in_hertz_on_request(shown, fit):
    plots = shown.locator(".plot")
    bode, plane = plots.nth(0), plots.nth(1)
    in_radians = [float(text) for text in plane.locator("text.beside").all_text_contents()]
    assert bode.locator("text.label").all_text_contents()[-1] == "ω, rad/s"
    shown.locator("#unit").click()
    assert bode.locator("text.label").all_text_contents()[-1] == "Frequency, Hz"
    in_hertz = [float(text) for text in plane.locator("text.beside").all_text_contents()]
    for frequency in in_hertz:
        assert np.min(np.abs(frequency * 2 * np.pi / fit.parts[0].data.omega - 1)) < 0.006
    assert max(in_hertz) == pytest.approx(max(in_radians) / (2 * np.pi), rel=0.01)
    bode.locator(".area").focus()
    shown.keyboard.press("ArrowRight")
    first = float(fit.parts[0].data.omega.min()) / (2 * np.pi)
    text = bode.locator(".readout b").inner_text()
    assert text.startswith("Frequency = ")
    assert float(text.split()[2]) == pytest.approx(first, rel=1e-3)
    shown.locator("#unit").click()
    assert bode.locator("text.label").all_text_contents()[-1] == "ω, rad/s"


def test_circles_in_the_plane_have_the_radius_of_the_regions_of_points(shown, fit):
    data = fit.parts[0].data
    (plot,) = (
        p for p in shown.locator("figure").all() if "Nyquist" in p.locator("strong").inner_text()
    )
    (circles,) = plot.locator("path.bars").all()
    number = r"(-?[\d.]+)"
    rows = re.findall(f"M{number},{number}a{number},", circles.get_attribute("d"))
    left, y, radii = np.array(rows, dtype=float).T
    middles = left + radii - 1j * y
    per_unit = abs(np.ptp(middles.real)) / np.ptp(data.alpha)
    expected = np.sqrt(data.variance / 2 * stats.chi2.ppf(0.95, 2))
    assert radii == pytest.approx(per_unit * expected, abs=0.1)  # px: what the page rounds to
    places = np.diff(data.response) * per_unit
    assert np.diff(middles) == pytest.approx(places, abs=0.3)


def test_measured_points_are_read_by_mouse_and_keyboard(shown, fit):
    area = shown.locator(".area").first
    omega = fit.parts[0].data.omega
    area.focus()
    shown.keyboard.press("Home")
    for _ in range(3):
        shown.keyboard.press("ArrowRight")
    said = area.locator(".readout").inner_text()
    assert said.startswith(f"ω = {omega[3]:.5g} rad/s")
    decibel = 20 * math.log10(abs(fit.parts[0].data.response[3]))
    assert f"{decibel:.3f}".replace("-", "−")[:5] in said

    box = area.bounding_box()
    shown.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
    assert "rad/s" in area.locator(".readout").inner_text()


def ticks(area):
    return area.locator("text[text-anchor=middle]").all_text_contents()


def test_figures_are_zoomed_by_drag_keys_and_buttons_and_shown_whole_again(show, one):
    shown = show(one)
    area = shown.locator(".area").first
    whole = ticks(area)
    area.scroll_into_view_if_needed()
    box = area.bounding_box()
    shown.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 60)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 62, steps=3)
    shown.mouse.up()
    assert ticks(area) != whole
    shown.get_by_role("button", name="Show all: Bode diagram, y/u").click()
    assert ticks(area) == whole

    area.focus()
    shown.keyboard.press("+")
    zoomed = ticks(area)
    assert zoomed != whole
    shown.keyboard.press("0")
    assert ticks(area) == whole
    shown.get_by_role("button", name="Zoom in: Bode diagram, y/u").click()
    assert ticks(area) == zoomed

    legend = shown.locator(".legend >> nth=0 >> button >> nth=0")
    lines = area.locator("path.line").count()
    legend.click()
    assert legend.get_attribute("aria-pressed") == "false"
    assert area.locator("path.line").count() < lines


def test_tables_are_sorted_by_size_both_ways(shown, fit):
    table = shown.locator("table").first
    header = table.get_by_role("button", name="estimate")
    column = "tr => [...tr.closest('table').tBodies[0].rows].map(row => row.cells[0].textContent)"
    expected = sorted((q for q in fit.quantities), key=lambda q: q.value)
    header.press("Enter")
    assert table.locator("tbody tr").first.evaluate(column) == [q.name for q in expected]
    header.press("Enter")
    assert table.locator("tbody tr").first.evaluate(column) == [q.name for q in expected][::-1]
    assert table.locator("th[aria-sort=descending]").inner_text().startswith("estimate")


def test_a_narrow_screen_a_dark_one_and_print(show, one):
    narrow = show(one, viewport={"width": 360, "height": 700})
    assert narrow.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert narrow.locator(".area svg").first.bounding_box()["width"] <= 360
    assert narrow.locator(".area svg.narrow").count() > 0
    narrow.set_viewport_size({"width": 1100, "height": 700})
    beyond = "tables => tables.some(table => table.scrollWidth > table.clientWidth)"
    assert not narrow.locator(".scroll").evaluate_all(beyond)

    background = "getComputedStyle(document.body).backgroundColor"
    dark = show(one, color_scheme="dark")
    assert dark.evaluate(background) == "rgb(20, 24, 28)"
    button = dark.locator("#theme")
    button.click()
    assert button.inner_text() == "Colors: light"
    assert dark.evaluate(background) == "rgb(255, 255, 255)"
    button.click()
    assert dark.evaluate(background) == "rgb(20, 24, 28)"

    dark.emulate_media(media="print")
    assert dark.evaluate(background) == "rgb(255, 255, 255)"
    assert not dark.locator(".tools").first.is_visible()
    assert len(dark.pdf()) > 10_000


def test_names_of_strangers_are_text(show, fit, tmp_path):
    gb.save(crafted(fit), tmp_path / "crafted.h5")
    loaded = gb.load(tmp_path / "crafted.h5")
    gb.report([loaded, fit], tmp_path / "crafted.html")
    shown = show(tmp_path / "crafted.html")
    # The only images are formulas, as data in the page.
    formula = "img[src^='data:image/svg+xml;base64,']"
    assert shown.locator(f"img:not({formula}), iframe, object, embed, link").count() == 0
    assert shown.locator("script").count() == 1
    assert shown.evaluate("typeof pwned") == "undefined"
    assert MARKUP in shown.locator("body").inner_text()
    assert "is needed and was not found" in shown.locator("body").inner_text()
    assert "greybox fit '; rm -rf ~'" in shown.locator("body").inner_text()  # one word for a shell
    # The legend and the readout are made by the script.
    assert shown.locator(".legend button", has_text="onerror").count() > 0
    assert shown.locator(".plot").count() > 4


def test_the_page_runs_no_script_but_its_own(show, one, tmp_path):
    text = one.read_text(encoding="utf-8")
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in text
    assert one.stat().st_size < 200_000
    # Even markup that came in unescaped would not run: the policy names the hash of the script.
    planted = tmp_path / "planted.html"
    planted.write_text(text.replace("<main>", "<main><script>pwned = 1</script>"), encoding="utf-8")
    shown = show(planted)
    assert shown.evaluate("typeof pwned") == "undefined"
    assert any("Content Security Policy" in told for told in shown.trouble)
    shown.trouble.clear()


def test_a_failed_fit_shows_where_its_best_run_ended(fit, tmp_path):
    beyond = [lambda p: p.a0 - 1e6]  # its bounds
    failed = gb.fit(
        gb.Problem(fit.models[0], fit.parts[0].data, constraints=beyond), starts=1, progress=False
    )
    assert not failed.converged
    gb.report(failed, tmp_path / "failed.html")
    text = (tmp_path / "failed.html").read_text(encoding="utf-8")
    assert "There is no estimate: no start converged" in text
    assert "<button" in text
    assert "ended at" in text
    assert "× failed" in text


def test_a_study_is_summed_up_and_its_table_is_filtered(show, small_study, tmp_path):
    page = tmp_path / "study.html"
    gb.report(small_study, page)
    shown = show(page)
    text = shown.locator("main > section").first.inner_text()
    assert "11 members: 10 done, 1 failed" in text
    assert "Lag (2 free) is supported" in text
    assert "reason and cure" in text
    evidence = shown.locator("figure").first
    assert evidence.locator("text", has_text="LagLead").count() == 1
    assert evidence.locator("path.marks, path.line").count() >= 3
    # The same fit from another seed is folded.
    names = [
        row.inner_text() for row in shown.locator("table >> nth=1 >> tbody td:first-child").all()
    ]
    assert "fast, Lag and 1 alike" in names
    assert "fast again" not in names
    rows = shown.locator("table >> nth=1 >> tbody tr:visible")
    assert rows.count() == 10
    shown.get_by_label("Filter rows").first.fill("slow laglead")
    assert rows.count() == 1
    # A row is read by its point, and its bar lies across.
    costs = shown.locator(".area").nth(2)
    costs.focus()
    shown.keyboard.press("Home")
    assert "hover, Gain: " in costs.locator(".readout").inner_text()


def test_only_the_first_members_of_a_study_are_read():
    def member(number, status="done"):
        answer = {"cost": 20.0 - number} if status == "done" else {}
        reason = "" if status == "done" else "no log"
        factors = {"status": status, "model": "ML", "seed": "0"}
        return SimpleNamespace(
            name=f"pitch{number}",
            number=number,
            status=status,
            answer=answer,
            factors=factors,
            reason=reason,
            fit=f"fit of pitch{number}",
        )

    members = [*map(member, range(14)), member(14, "failed"), member(15, "unfinished")]
    made = members_of(SimpleNamespace(members=members))
    assert [each.label for each in made] == [each.name for each in members]
    fits = [f"fit of pitch{k}" for k in range(12)]
    assert [each.fit for each in made] == [*fits, None, None, None, None]
    assert [each.error for each in made] == [""] * 14 + ["no log"] * 2
