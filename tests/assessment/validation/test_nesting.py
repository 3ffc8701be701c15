"""Fits are nested where criterion, class or user say so, or the formulas agree at zero; never by names alone."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, Lag, LagLagDelay, measured
from drag_flights import Drag, LinearDrag, QuadraticDrag, fitted, flight

import greybox as gb
from greybox.assessment.validation.nesting import NotNestedError, nested_values
from greybox.models.tilt import PAPER_G

pytestmark = pytest.mark.usefixtures("unjudged_file")

NAMES = ("small", "large")


@pytest.fixture(scope="module")
def record():
    return flight({"a5": 0.2, "C_x": 0.05}, 8, duration=6.0)


FITS = {}


NOTHING = {}


def place(record, small, large, at=NOTHING, **options):
    """The values of the terms in the smaller model; both are fitted to a record, each only once."""
    fits = [
        fitted_once(record, model, **{k: v[i] for k, v in options.items() if v[i]})
        for i, model in enumerate((small, large))
    ]
    return nested_values(*fits, NAMES, at)


def fitted_once(record, model, **options):
    key = f"{type(model).__name__} {options}"
    if key not in FITS:
        # Four steps a sample need no refinement, which takes longer than the fits.
        method = gb.MultipleShooting(integrator=gb.RungeKutta(4))
        FITS[key] = fitted(model, record, method, **options)
    return FITS[key]


class OtherDrag(Drag):
    """The parameters of `Drag`, and no value of `C_x` that makes it linear."""

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v - (p.C_x + 0.3) * abs(x.v) * x.v,)


class PositiveDrag(Drag):
    """Drag that is never linear, by its bounds."""

    C_x = gb.Parameter(0.05, bounds=(0.01, 2))


class PowerDrag(LinearDrag):
    """Drag with an exponent, which is one where the drag is linear."""

    n = gb.Parameter(1.5, bounds=(0.5, 3))

    def derivative(self, x, u, p):
        return (
            PAPER_G * gb.tan(u.theta) - p.a5 * x.v * gb.exp((p.n - 1) * gb.log(abs(x.v) + 1e-9)),
        )


class SaturatingDrag(LinearDrag):
    """Friction of Coulomb's kind, of which the width has no effect without its size."""

    c = gb.Parameter(0.1, bounds=(-2, 2))
    v_s = gb.Parameter(0.5, bounds=(0.01, 5))

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v - p.c * gb.tan(x.v / (20 * p.v_s)),)


class LaggedDrag(LinearDrag):
    """With a second state that a gain of zero removes."""

    states = ("v", "w")
    k = gb.Parameter(0.1, bounds=(-1, 1))

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v + p.k * x.w, x.v - 2 * x.w)


class LaggedQuadraticDrag(LaggedDrag):
    """With a quadratic term beside."""

    c = gb.Parameter(0.05, bounds=(-1, 2))

    def derivative(self, x, u, p):
        slope, lag = super().derivative(x, u, p)
        return (slope - p.c * abs(x.v) * x.v, lag)


class RenamedDrag(Drag):
    """The same in a state of another name."""

    states = ("speed",)

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.speed - p.C_x * abs(x.speed) * x.speed,)

    def output(self, x, u, p):
        return (x.speed,)


class LagLag(gb.TransferFunction):
    """Two lags without a delay."""

    K, T1, T2 = LagLagDelay.K, LagLagDelay.T1, LagLagDelay.T2

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1))


class Squared(LinearDrag):
    """A term that is absent at its bound."""

    w = gb.Parameter(0.9, bounds=(0.5, 3))

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v - (p.w**2 - 0.25) * abs(x.v) * x.v,)


def test_a_term_that_is_zero_fixed_or_tied_makes_a_model_nested(record):
    assert place(record, LinearDrag(), Drag()) == {"C_x": 0.0}
    assert place(record, QuadraticDrag(), Drag()) == {"a5": 0.0}
    assert place(record, Drag(), Drag(), fixed=({"C_x": 0.04}, None)) == {"C_x": 0.04}
    tied = place(record, Drag(), Drag(), tied=({"C_x": lambda p: 0.25 * p.a5}, None))
    assert list(tied) == ["C_x"]


class StatedPower(PowerDrag):
    """States what it contains, for comparisons that nobody can ask."""

    def contains(self, other):
        return {"n": 1.0} if isinstance(other, LinearDrag) else None


def test_terms_that_vanish_elsewhere_are_stated_by_the_class_or_the_user(record):
    for model, at in ((PowerDrag(), {"n": 1.0}), (Squared(), {"w": 0.5})):
        with pytest.raises(NotNestedError, match=r"large is not small where . is 0; .* at=\{"):
            place(record, LinearDrag(), model)
        assert place(record, LinearDrag(), model, at) == at
    assert place(record, LinearDrag(), StatedPower()) == {"n": 1.0}

    small, large = (fitted_once(record, model) for model in (LinearDrag(), PowerDrag()))
    stated = fitted_once(record, StatedPower())
    test = gb.validation.nested_test(small, large, at={"n": 1.0})
    assert test == replace(gb.validation.nested_test(small, stated), large="PowerDrag")
    assert str(test).startswith("n is ")
    with pytest.raises(ValueError, match="is not shown to be PowerDrag with terms removed"):
        gb.validation.nested_test(small, large)
    with pytest.raises(ValueError, match="has no term 'a5'; it has n"):
        gb.validation.nested_test(small, large, at={"a5": 1.0})
    # At a value that the larger model cannot have, it is not the smaller one.
    with pytest.raises(ValueError, match=r"cannot have n = 0: it is fixed or bounded elsewhere"):
        gb.validation.nested_test(small, large, at={"n": 0.0})

    assert gb.compare(small, stated).verdict.startswith("StatedPower contains LinearDrag, and n is")
    assert "contains" not in gb.compare(small, large).verdict


def test_biases_and_gains_of_a_criterion_are_terms_that_are_zero(record):
    output = gb.OutputError()
    found = place(record, Drag(), Drag(), criterion=(output, gb.PredictionError()))
    assert found == {"K_v_v": 0.0}
    biased = gb.OutputError(biases=["theta", "v"])
    both = place(record, LinearDrag(), Drag(), criterion=(output, biased))
    assert both == {"C_x": 0.0, "theta_bias": 0.0, "v_bias": 0.0}
    bounded = gb.OutputError(errors="huber")
    for criteria in (
        (bounded, gb.PredictionError()),
        (output, bounded),
        (output, gb.OutputError(noise={"v": 0.1})),
        (output, gb.OutputError(inputs="held")),
        (gb.PredictionError(), output),
        (biased, output),
    ):
        with pytest.raises(NotNestedError, match="differ in their criteria"):
            place(record, LinearDrag(), Drag(), criterion=criteria)


def test_names_alone_do_not_make_models_nested(record):
    with pytest.raises(NotNestedError, match="large is not small where C_x is 0"):
        place(record, LinearDrag(), OtherDrag())
    with pytest.raises(NotNestedError, match=r"large is not small$"):
        place(record, Drag(), OtherDrag(), fixed=({"C_x": 0.0}, None))
    with pytest.raises(NotNestedError, match="estimates no more numbers"):
        place(record, LinearDrag(), QuadraticDrag())
    with pytest.raises(NotNestedError, match="large cannot have C_x = 0"):
        place(record, LinearDrag(), PositiveDrag())
    with pytest.raises(NotNestedError, match="estimates no more numbers"):
        place(record, LinearDrag(), LinearDrag())


def test_a_parameter_that_is_held_elsewhere_makes_another_model(record):
    with pytest.raises(NotNestedError, match="large has a5 fixed, and small has not"):
        place(record, LinearDrag(), SaturatingDrag(), fixed=(None, {"a5": 0.3}))
    small, large = LaggedDrag(), LaggedQuadraticDrag()
    with pytest.raises(NotNestedError, match="large has a5 fixed, and small has not"):
        place(record, small, large, fixed=({"a5": 0.3}, {"a5": 0.2}))
    assert place(record, small, large, fixed=({"a5": 0.3}, {"a5": 0.3})) == {"c": 0.0}


def test_of_a_model_with_more_states_the_user_says_so(record):
    with pytest.raises(NotNestedError, match="is not small where k is 0"):
        place(record, LinearDrag(), LaggedDrag())
    assert place(record, LinearDrag(), LaggedDrag(), {"k": 0.0}) == {"k": 0.0}
    with pytest.raises(NotNestedError, match="is not small where C_x"):
        place(record, LinearDrag(), RenamedDrag())


def test_a_term_without_effect_where_another_is_zero_is_reported(record):
    with pytest.raises(ValueError, match="v_s of large has no effect"):
        place(record, LinearDrag(), SaturatingDrag(), {"v_s": 0.5})
    with pytest.raises(ValueError, match="v_s of large has no effect"):
        place(record, SaturatingDrag(), SaturatingDrag(), fixed=({"c": 0.0, "v_s": 0.5}, None))
    held = place(record, LinearDrag(), SaturatingDrag(), fixed=(None, {"v_s": 0.5}))
    assert held == {"c": 0.0}


def test_a_parameter_of_every_record_is_one_of_all_where_they_are_equal(record):
    records = [record, flight({"a5": 0.2, "C_x": 0.05}, 9, duration=12.0)]
    one, own = (
        gb.fit(gb.several(Drag(), records, own=names), starts=1, progress=False)
        for names in ((), ("C_x",))
    )
    value = one.estimate["C_x"]
    assert nested_values(one, own, NAMES) == {"C_x_1": value, "C_x_2": value}
    assert gb.validation.nested_test(one, own).dof[0] == 1
    with pytest.raises(NotNestedError):
        nested_values(own, one, NAMES)


def test_models_of_responses_are_nested_by_their_responses():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)

    def fit(model, **options):
        return gb.fit(gb.Problem(model, data, **options), starts=4, progress=False)

    large = fit(LagLagDelay())
    held = fit(LagLagDelay(), fixed={"tau": 0.05})
    assert nested_values(held, large, NAMES) == {"tau": 0.05}
    with pytest.raises(NotNestedError):
        nested_values(fit(Lag()), large, NAMES)
    assert nested_values(fit(LagLag()), large, NAMES) == {"tau": 0.0}
    with pytest.raises(NotNestedError):  # equal at the first frequency and nowhere else
        nested_values(fit(EqualAtOneFrequency()), large, NAMES)
    with pytest.raises(NotNestedError, match="differ in their criteria"):
        nested_values(fit(LagLag(), criterion=gb.SquaredRelativeError()), large, NAMES)
    with pytest.raises(NotNestedError, match="differ in their criteria, delays"):
        nested_values(fit(LagLag(), delay="pade:2"), large, NAMES)


class EqualAtOneFrequency(LagLag):
    """At the first frequency a gain like another, and nowhere else."""

    def response(self, s, p):
        return super().response(s, p) * (1 + 0.3 * (s * s / TWO_LAGS_OMEGA[0] ** 2 + 1))


def test_loaded_fits_need_their_models(record, tmp_path):
    for name, model in (("linear", LinearDrag()), ("drag", Drag())):
        gb.save(fitted_once(record, model), tmp_path / f"{name}.h5")
    paths = [tmp_path / f"{name}.h5" for name in ("linear", "drag")]
    with pytest.raises(LookupError, match=r"models=\["):
        nested_values(*map(gb.load, paths), NAMES)
    models = [LinearDrag, Drag]
    assert nested_values(*(gb.load(p, models=models) for p in paths), NAMES) == {"C_x": 0.0}


class Third(gb.TransferFunction):
    """A lag beside a gain that is like one in no place."""

    K, T1, T2 = LagLagDelay.K, LagLagDelay.T1, LagLagDelay.T2
    c = gb.Parameter(0.5, bounds=(-1, 2))

    def response(self, s, p):
        return p.K / ((p.T1 * s + 1) * (p.T2 * s + 1)) + (p.c + 0.3) * s / (s + 50)


def test_transfer_functions_of_records_are_compared_in_the_plane():
    time = 0.02 * np.arange(150)
    u = np.sin(time) + np.sin(4 * time)
    made = gb.Record(time, {"u": u})
    y = gb.simulate(LagLag(), {"K": 2.0, "T1": 0.5, "T2": 0.1}, made)["y"]
    record = made.with_signals(y=y + 0.01 * np.random.default_rng(0).normal(size=150))

    def fit(model):
        return gb.fit(gb.Problem(model, record), starts=1, progress=False, profiles=False)

    small, delayed, third = map(fit, (LagLag(), LagLagDelay(), Third()))
    assert nested_values(small, delayed, NAMES) == {"tau": 0.0}
    with pytest.raises(NotNestedError, match="large is not small where c is 0"):
        nested_values(small, third, NAMES)

    class InTime(gb.StateSpace):
        """A state where the other is a formula in s."""

        states, inputs, outputs = ("y",), ("u",), ("y",)
        K, T1, T2 = LagLag.K, LagLag.T1, LagLag.T2
        c, d = (gb.Parameter(0.5, bounds=(-2, 2)) for _ in range(2))

        def derivative(self, x, u, p):
            return ((p.K * u.u - x.y) / p.T1 + p.c * x.y + p.T2 + p.d * u.u,)

        def output(self, x, u, p):
            return (x.y,)

    with pytest.raises(NotNestedError):
        nested_values(small, fit(InTime()), NAMES)


def test_many_terms_are_removed_together():
    """Four lags that are one where four time constants are zero."""

    class Lags(gb.TransferFunction):
        K, T1, T2 = LagLag.K, LagLag.T1, LagLag.T2
        T3, T4, T5, T6 = (gb.Parameter(0.01 * k, bounds=(0, 1)) for k in (1, 2, 3, 4))

        def response(self, s, p):
            more = (p.T3 * s + 1) * (p.T4 * s + 1) * (p.T5 * s + 1) * (p.T6 * s + 1)
            return LagLag().response(s, p) / more

    data = measured(LagLag(), TWO_LAGS_OMEGA, {"K": 2.0, "T1": 0.5, "T2": 0.1}, noise=0.02)
    small, large = (
        gb.fit(gb.Problem(model, data), starts=1, progress=False) for model in (LagLag(), Lags())
    )
    assert nested_values(small, large, NAMES) == dict.fromkeys(("T3", "T4", "T5", "T6"), 0.0)
