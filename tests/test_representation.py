"""`repr` of what can be large is one line, so that a bare name at a prompt does not flood the screen."""

from dataclasses import replace
from functools import cache
from html.parser import HTMLParser

from declared_models import TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from drag_flights import QUADRATIC, Drag, LinearDrag, fitted, flight

import greybox as gb
from greybox.data.spectral.frequency_points import FiniteFrequency
from greybox.engine.solve.minima import Multistart
from greybox.models.yaw import YawAngle

RECORD = flight(QUADRATIC, 1, duration=10.0)
RESPONSE = measured(
    LagLagDelay(), TWO_LAGS_OMEGA, noise=0.02, name="a name of a test that is long " * 10
)
PROBLEM = gb.Problem(Lag(), RESPONSE)


@cache
def response_fit():
    return gb.fit(PROBLEM, starts=3)


@cache
def drag_fits():
    return fitted(LinearDrag(), RECORD), fitted(Drag(), RECORD)


@cache
def values():
    """One value of every kind; made in a test, since every worker collects this file."""
    fit = response_fit()
    small, large = drag_fits()
    return {
        "Comparison": gb.compare(small, large),
        "EquationErrorEstimate": gb.regression.equation_error(Drag(), RECORD),
        "Excitation": gb.experiment.multisine(0.5, 5.0, 20.0, 50.0),
        "FiniteFrequency": FiniteFrequency(RESPONSE, ()),
        "Fit": fit,
        "FittedRecord": small.parts[0],
        "FittedResponse": fit.parts[0],
        "FrequencyResponse": RESPONSE,
        "LinearSystem": gb.modeling.linearize(Drag(), {"a5": 0.2, "C_x": 0.1}, {"v": 1.0}),
        "Listed": gb.solve.Listed([{"K": 1.0, "T": 2.0}] * 20),
        "Minimum": fit.minima[0],
        "Multistart": Multistart(fit.runs, fit.minima),
        "NestedTest": gb.validation.nested_test(small, large),
        "Prediction": gb.predict(small),
        "Problem": PROBLEM,
        "Quality": gb.spectral.check(RECORD, input="theta", output="v"),
        "Quantity": fit.quantities[0],
        "RationalFit": gb.regression.levy(RESPONSE, 2, 0),
        "Record": RECORD,
        "Recording": gb.data.Recording({f"M{k}": RECORD for k in range(40)}, source="flight.BIN"),
        "Run": fit.runs[0],
        "Segment": gb.data.Segment(1.0, 2.0, "sweep", "pitch", band=(1.0, 10.0)),
        "Sum": gb.several(Drag(), [RECORD, flight(QUADRATIC, 2, duration=5.0)]),
    }


def test_the_repr_is_one_short_line():
    for kind, value in values().items():
        assert type(value).__name__ == kind
        text = repr(value)
        assert len(text) < 120, kind
        assert "\n" not in text, kind
        assert text.startswith((f"<{kind}", f"{kind}(")), kind


def test_what_prints_itself_has_its_first_line_and_is_shown_in_notebooks():
    signal = gb.experiment.sweep(1, 10, 30, 100)
    assert repr(signal).startswith("<Excitation logarithmic sweep on u: 30.0 s")
    assert f"<pre>{signal}</pre>" == signal._repr_html_()
    # Other values have their fields, those of a derived class, too.
    assert repr(gb.OutputError(errors="huber")).endswith("errors='huber')")


def test_the_repr_says_what_it_is():
    assert repr(RECORD) == f"<Record {RECORD}>"
    assert repr(drag_fits()[0]).startswith("<Fit 'flight 1', converged, cost ")
    assert repr(response_fit().minima[0]).endswith(", 3 runs, 1 variant>")


# --- in notebooks


class Elements(HTMLParser):
    """What a browser would see: the elements, balanced, and the text."""

    def __init__(self, html):
        super().__init__()
        self.open, self.seen, self.text = [], set(), ""
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.seen.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += f"{data} "


def test_a_notebook_shows_what_else_is_printed_as_it_is():
    fit = response_fit()
    for thing in (fit, values()["Comparison"], fit.identifiability, gb.draws(fit, 4)):
        shown = Elements(thing._repr_html_())
        assert shown.seen == {"pre"}
        assert shown.text.strip() == str(thing).strip()


def test_a_notebook_shows_the_equation_of_a_model():
    assert YawAngle()._repr_markdown_().startswith("**YawAngle**\n\nYaw angle")
    assert r"$$P_\psi(s) = \frac{" in YawAngle()._repr_markdown_()


def test_names_from_files_are_text_and_never_markup():
    evil = "<script>alert(1)</script>"
    fit = response_fit()
    things = [
        replace(fit, name=evil, warnings=(evil,), notes=(evil,)),
        replace(fit, name=evil, minima=(), warnings=(evil,)),
        replace(gb.draws(fit, 4), name=evil),
    ]
    for thing in things:
        assert "script" not in Elements(thing._repr_html_()).seen
        assert evil in Elements(thing._repr_html_()).text


def test_a_notebook_shows_the_unknowns_of_a_problem():
    shown = Elements(PROBLEM._repr_html_()).text
    for name, parameter in PROBLEM.parameters.items():
        assert f"{name} " in shown
        assert parameter.unit in shown
        assert parameter.fixed or f"[{parameter.bounds[0]:g}, {parameter.bounds[1]:g}]" in shown
