"""Wrong arguments of figures: every figure names what it cannot draw, and what it draws."""

import numpy as np
import pytest

from greybox import plotting

FIGURES = [
    (plotting.bode, (), "FrequencyResponse"),
    (plotting.nyquist, (), "FrequencyResponse"),
    (plotting.plot, (), "Fit"),
    (plotting.starts, (), "Fit"),
    (plotting.residuals, (), "Fit"),
    (plotting.time_history, (), "Prediction"),
    (plotting.spectrum, (), "TransientSpectrum"),
    (plotting.profiles, (), "Profiles"),
    (plotting.pairs, (), "columns"),
    (plotting.loop, (), "Margins"),
    (plotting.gains, (), "SafeGains"),
    (plotting.trend, ("K", "v"), "Study"),
    (plotting.estimates, ("K",), "(fits|a Fit)"),
    (plotting.structures, (), "Study"),
    (plotting.traces, (), "Record"),
    (plotting.recording, (), "Recording"),
]


@pytest.mark.parametrize("wrong", [["a fit"], "fit.h5", None, 3, np.ones(3)], ids=repr)
@pytest.mark.parametrize(
    ("draw", "more", "kind"), FIGURES, ids=[draw.__name__ for draw, *_ in FIGURES]
)
def test_a_wrong_argument_is_named_with_what_can_be_drawn(draw, more, kind, wrong):
    with pytest.raises(TypeError, match=rf"cannot draw .*: give .*{kind}"):
        draw(wrong, *more)


def test_every_figure_of_the_namespace_is_tried():
    figures = {name for name, value in vars(plotting).items() if callable(value)}
    assert figures == {draw.__name__ for draw, _, _ in FIGURES}
