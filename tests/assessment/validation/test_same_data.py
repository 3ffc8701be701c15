"""Which fits may be compared: by their data, and by their criteria's type and settings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from huber import Huber

import greybox as gb
from greybox.assessment.fitted_part import FittedSpectrum
from greybox.assessment.validation.same_data import (
    check_fits,
    data_difference,
    is_likelihood,
    labels_of,
    other_samples,
    shared_data,
    why_not_comparable,
)

DATA = measured(
    LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02, columns={"variance": np.full(30, 1e-4)}
)


@pytest.fixture(scope="module")
def fits():
    return {
        threshold: gb.fit(gb.Problem(Lag(), DATA, Huber(threshold)), starts=4)
        for threshold in (1.0, 2.0)
    }


def test_criteria_of_a_user_are_the_same_when_their_settings_are(fits, tmp_path):
    other = gb.fit(gb.Problem(LagLagDelay(), DATA, Huber(1.0)), starts=10)
    assert other.criterion == "huber"
    same, different = (
        gb.compare(fits[1.0], other),
        gb.compare(fits[2.0], other, labels=("two", "one")),
    )
    assert same.value("cost: huber", "Lag") == fits[1.0].cost
    assert different.value("cost", "two") is None
    said = "they are of different criteria (huber (threshold = 2.0); huber (threshold = 1.0))"
    assert any(said in text for text in different.statements)

    for name, fit in {"one": fits[1.0], "two": fits[2.0], "other": other}.items():
        gb.save(fit, tmp_path / f"{name}.h5")
    one, two, other = (gb.load(tmp_path / f"{name}.h5") for name in ("one", "two", "other"))
    assert one.parts[0].settings == {"threshold": 1.0}
    assert str(gb.compare(one, other)) == str(same)
    assert str(gb.compare(two, other, labels=("two", "one"))) == str(different)


def test_likelihoods_are_those_of_weight_one():
    fit = gb.fit(gb.Problem(Lag(), DATA, gb.MaximumLikelihood()), starts=3)
    assert is_likelihood(fit)
    assert not is_likelihood(replace(fit, parts=(replace(fit.parts[0], weight=2.0),)))
    assert not is_likelihood(gb.fit(gb.Problem(Lag(), DATA, gb.RelativeError()), starts=3))


def test_labels_tell_fits_of_one_model_apart(fits):
    one, two = fits[1.0], fits[2.0]
    assert labels_of([one, gb.fit(gb.Problem(LagLagDelay(), DATA), starts=3)]) == (
        "Lag",
        "LagLagDelay",
    )
    assert labels_of([one, replace(two, name="second")]) == ("Lag (made)", "Lag (second)")
    assert labels_of([one, two]) == ("Lag 1", "Lag 2")


def test_other_data_and_other_weights_are_told(fits):
    one, two = fits[1.0], fits[2.0]
    assert data_difference([one, two], ("a", "b")) == ""
    elsewhere = replace(
        two, parts=(replace(two.parts[0], data=measured(Lag(), TWO_LAGS_OMEGA, name="else")),)
    )
    assert data_difference([one, elsewhere], ("a", "b")).startswith(
        "b was fitted to other data ('else', "
    )
    twice = replace(two, parts=two.parts * 2)
    assert data_difference([one, twice], ("a", "b")).startswith("b was fitted to 2 sets of data")
    for weight in (3.0, 1.0004):
        heavy = replace(one, parts=(replace(one.parts[0], weight=weight),))
        told = f"their data are weighted differently (1; {weight:g})"
        assert why_not_comparable([one, heavy], ("a", "b")) == told
    assert why_not_comparable([one, one], ("a", "b")) == ""
    assert one.parts[0].compared_numbers == 60


def test_what_cannot_be_compared_is_told(fits):
    one, two = fits[1.0], fits[2.0]
    check_fits([one, two])
    for given, error, said in (
        ([one, 3], TypeError, "a fit to compare is 3: give fits, such as"),
        ([one], ValueError, "there is 1 fit to compare: give at least two"),
        ([], ValueError, "there is no fit to compare: give at least two"),
        (
            [one, replace(two, minima=(), name="lost")],
            ValueError,
            "fit 'lost' has no estimate: ",
        ),
    ):
        with pytest.raises(error, match=said):
            check_fits(given)


def test_numbers_of_data_and_outputs_are_counted_in_each_kind(fits):
    part = fits[1.0].parts[0]
    spectrum = FittedSpectrum.__new__(FittedSpectrum)
    lines = dict.fromkeys(("p", "r", "beta"), np.zeros(7, complex))
    vars(spectrum).update(data=SimpleNamespace(outputs=lines), fitted=lines, outputs=(*lines,))
    assert spectrum.compared_numbers == 2 * 7 * 3
    assert (
        shared_data([fits[1.0]]) == f"the same for all: made ({part.data.checksum[:8]}), 60 numbers"
    )
    points = np.arange(30) < 29
    shorter = replace(part, data=part.data.where(points), response=part.response[points])
    fewer = replace(fits[2.0], parts=(shorter,))
    assert other_samples([fits[1.0], fits[2.0]], ("a", "b")) == ""
    assert other_samples([fits[1.0], fewer], ("a", "b")).startswith(
        "a was fitted to 60 numbers of 'made' and b to 58 ("
    )
    assert why_not_comparable([fits[1.0], fewer], ("a", "b")).startswith(
        "a was fitted to 60 numbers of 'made' and b "
    )


def test_excerpts_of_one_record_are_told_apart():
    """They have one checksum, that of the whole."""
    time = np.arange(40.0)
    step = gb.Record(time, {"u": (time > 5) * 1.0, "y": np.maximum(time - 5, 0)})
    fits = [gb.fit(gb.Problem(Lag(), r), starts=1) for r in (step, step.between(0, 21))]
    with pytest.raises(ValueError, match=r"22 numbers, .* than Lag 1 \(.*, 40 numbers, "):
        gb.compare(*fits)
