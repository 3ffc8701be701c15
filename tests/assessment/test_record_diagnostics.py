"""What fits of records say of samples that they did not see, of rest, of poor fits and of unequal records."""

import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from gain_and_lag import Lag
from numpy.testing import assert_allclose
from sampled_lag import SampledLag, lag_record
from scipy.signal import lfilter

import greybox as gb
from greybox.assessment.checks import colored_predictions as module, feedback as feedback_module
from greybox.assessment.checks.colored_predictions import colored_predictions
from greybox.assessment.checks.feedback import feedback
from greybox.assessment.checks.unexplained_outputs import unexplained_outputs
from greybox.statistics.correlation_statistics import cross_correlation, whiteness
from greybox.statistics.noise_ratio import noise_ratio

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"K": 2.0, "T": 0.1, "d": 0.023}
STEP = 0.01


class Late(gb.StateSpace):
    """First order with a late input."""

    states = outputs = ("y",)
    inputs = ("u",)
    delays = {"u": "d"}
    K = gb.Parameter(1.0, bounds=(0, 50))
    T = gb.Parameter(0.3, bounds=(0.005, 10), unit="s")
    d = gb.Parameter(0.01, bounds=(0, 0.05), unit="s")

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)


class Later(Late):
    """With a lazy bound."""

    d = gb.Parameter(0.01, bounds=(0, 0.3), unit="s")


class Latest(Late):
    """With a very lazy bound."""

    d = gb.Parameter(0.01, bounds=(0, 0.7), unit="s")


HELD = gb.OutputError(inputs="held")


def fit(model, record, starts=1, criterion=HELD, **statement):
    problem = gb.Problem(model, record, criterion, **statement)
    return gb.fit(problem, starts=starts, progress=False, profiles=False)


def stepped(noise=0.01, n=120, before=10, seed=0):
    """The response to a step at `before` samples, analytic."""
    time = STEP * np.arange(n)
    since = np.maximum(time - STEP * before - TRUTH["d"], 0)
    y = TRUTH["K"] * (1 - np.exp(-since / TRUTH["T"]))
    u = np.where(np.arange(n) < before, 0.0, 1.0)
    return gb.Record(
        time, {"u": u, "y": y + noise * np.random.default_rng(seed).normal(size=n)}, name="step"
    )


def driven(n=600, noise=0.02, seed=0, hold=4, delay=2):
    """Held inputs that moved before the record began, exact between whole samples."""
    random, before = np.random.default_rng([seed, 5]), 200
    u = np.repeat(random.normal(size=(n + before) // hold + 1), hold)[: n + before]
    decay = np.exp(-STEP / TRUTH["T"])
    late = np.concatenate([np.zeros(delay + 1), u])[: n + before]
    y = lfilter([TRUTH["K"] * (1 - decay)], [1, -decay], late) + noise * random.normal(
        size=n + before
    )
    return gb.Record(STEP * np.arange(n), {"u": u[before:], "y": y[before:]}, name="driven")


def said(found, words):
    return [text for text in found.warnings if words in text]


def test_a_lazy_bound_of_a_delay_does_not_change_the_answer_of_a_step():
    record = stepped()
    found = [fit(model, record) for model in (Late(), Latest())]
    for one in found:
        assert one.records[0].compared == len(record)
        assert "120 samples in 1 record" in str(one)
        for name, value in TRUTH.items():
            assert abs(one.estimate[name] - value) < 4 * one.standard_error[name] < 0.2 * value
            assert one.estimate[name] == pytest.approx(found[0].estimate[name], rel=1e-4)
        assert one.cost == pytest.approx(found[0].cost, abs=1e-4)


def test_what_a_delay_takes_from_a_moving_record_is_counted():
    record = driven(400)
    tight, lazy = fit(Late(), record), fit(Later(), record)
    assert "395 of 400 samples in 1 record" in str(tight)
    assert lazy.records[0].compared == np.isfinite(lazy.records[0].residual("y")).sum() == 370
    assert "370 of 400 samples in 1 record" in str(lazy)
    assert lazy.dof < tight.dof <= 395
    for found in (tight, lazy):
        for name, value in {"K": 2.0, "T": 0.1, "d": 0.02}.items():
            assert abs(found.estimate[name] - value) < 4 * found.standard_error[name]


def test_numbers_that_no_fit_saw_are_no_data():
    """Of the 33 samples the bound leaves three, which is as many as there are unknowns."""
    (text,) = said(
        fit(Later(), driven(33), starts=[{}], fixed={"T": 0.1}), "leave no degrees of freedom"
    )
    assert text.startswith("3 real numbers of data for 2 unknowns and 1 initial state")


class Slide(gb.StateSpace):
    """A body that a motor drives, against drag."""

    states = ("x", "v")
    inputs = ("u",)
    outputs = ("x",)
    tau = gb.Parameter(1.0, bounds=(0.01, 10), unit="s")
    K = gb.Parameter(1.0, bounds=(0, 50), unit="m/s")

    def derivative(self, x, u, p):
        return (x.v, (p.K * u.u - x.v) / p.tau)

    def output(self, x, u, p):
        return (x.x,)


def slid(level, speed, n=200, noise=0.002, seed=0):
    """A record with a constant input, analytic: tau 0.4 s, K 3 m/s."""
    time = 0.01 * np.arange(n)
    end, gone = 3.0 * level, 1 - np.exp(-time / 0.4)
    x = end * time + (speed - end) * 0.4 * gone + noise * np.random.default_rng(seed).normal(size=n)
    return gb.Record(time, {"u": np.full(n, level), "x": x}, name=f"from {speed:g} m/s")


def test_a_coast_down_tells_the_time_constant():
    found = fit(Slide(), slid(0.0, 2.0), fixed={"K": 3.0})
    assert abs(found.estimate["tau"] - 0.4) < 4 * found.standard_error["tau"] < 0.1
    assert found.notes == ("the inputs never change (u): only the free response is informative.",)
    assert not said(found, "never change")
    free = fit(Slide(), slid(0.0, 2.0))
    assert said(free, "K is not determined: it does not change the response")


def test_a_response_from_rest_to_a_constant_input_tells_the_gain_too():
    found = fit(Slide(), slid(0.8, 0.0), criterion=gb.OutputError(initial={"v": 0.0}))
    for name, value in {"tau": 0.4, "K": 3.0}.items():
        assert abs(found.estimate[name] - value) < 4 * found.standard_error[name] < 0.2 * value


def test_rest_in_one_of_several_records_is_no_matter():
    moving = gb.virtual_flight(
        Slide(),
        {"tau": 0.4, "K": 3.0},
        excitation={"u": np.sign(np.sin(np.arange(300) / 20))},
        rate=100.0,
    )
    noisy = moving.with_signals(x=moving["x"] + 0.002 * np.random.default_rng(2).normal(size=300))
    found = gb.fit(gb.several(Slide(), [noisy, slid(0.0, 2.0)]), starts=1, progress=False)
    assert not found.notes
    for name, value in {"tau": 0.4, "K": 3.0}.items():
        assert abs(found.estimate[name] - value) < 4 * found.standard_error[name]
    both = gb.fit(gb.several(Slide(), [slid(0.5, 2.0), slid(0.0, 2.0)]), starts=1, progress=False)
    assert [text for text in both.notes if "the inputs never change (u)" in text]


class TwoInputs(Slide):
    """A slide that declares another input."""

    inputs = ("u", "w")
    d = gb.Parameter(0.1, bounds=(-5, 5))

    def derivative(self, x, u, p):
        speed, change = super().derivative(x, u, p)
        return speed, change + p.d * u.w


@pytest.mark.parametrize(
    ("w", "words"),
    [
        (np.ones(300), "the inputs never change (w): their effects look like those of constants"),
        (np.sin(np.arange(300)), ""),
    ],
)
def test_inputs_that_rest_beside_others_are_noted(w, words):
    u = np.sign(np.sin(np.arange(300) / 20))
    x = gb.simulate(Slide(), {"tau": 0.4, "K": 3.0}, gb.Record(0.01 * np.arange(300), {"u": u}))
    noise = 0.002 * np.random.default_rng(2).normal(size=300)
    record = gb.Record(0.01 * np.arange(300), {"u": u, "w": w, "x": x["x"] + noise})
    notes = " ".join(fit(TwoInputs(), record).notes)
    assert words in notes
    assert bool(words) == ("input" in notes)


def test_a_record_in_which_nothing_happens_is_refused():
    still = slid(0.0, 0.0)
    with pytest.raises(
        ValueError, match=r"never change \(u\) and x is indistinguishable from noise: nothing can"
    ):
        fit(Slide(), still)


def test_a_fit_that_explains_almost_nothing_is_told():
    class Wrong(Late):
        """With a gain of the other sign."""

        K = gb.Parameter(-1.0, bounds=(-50, -0.001))

    record = driven(300)
    known = {"T": TRUTH["T"], "d": 0.02}
    (text,) = said(fit(Wrong(), record, fixed=known), "almost none of")
    percent = float(re.search(r"of y in 'driven' \(fit (\S+) %\)", text)[1])
    assert percent < 10
    allowed = float(re.search(r"allow about (\d+) %", text)[1])
    right = fit(Late(), record)
    # Fast movements count as noise.
    assert_allclose(allowed, right.records[0].fit_percent("y"), atol=15)
    assert not said(right, "almost none of")
    assert "at rest" not in text
    raised = record.with_signals(y=record["y"] + 5 * np.ptp(record["y"]))
    (text,) = said(fit(Wrong(), raised, fixed=known), "almost none of")
    assert "OutputError(biases=('y',))" in text


def test_a_gain_that_is_far_too_small_explains_almost_nothing_of_either_record():
    """Held at a twentieth of its value, so that 95 % of the output are left; no name is that of the model."""
    one, other = driven(300), driven(300, seed=1)
    other = gb.Record(other.time, {"u": other["u"], "y": other["y"]})
    problem = gb.several(Late(), [one, other], criterion=HELD, fixed={"K": 0.1, "d": 0.02})
    texts = said(gb.fit(problem, starts=1, progress=False), "almost none of")
    found = [re.search(r"of y in '(.*)' \(fit (\S+) %\)", text) for text in texts]
    assert [words[1] for words in found] == ["driven", "Late"]
    assert_allclose([float(words[2]) for words in found], 5, atol=4)


def test_a_right_model_of_a_record_that_is_mostly_noise_is_not_blamed():
    """The fit is low, since it cannot be higher, and the estimate is right within its errors."""
    u = np.sin(np.arange(6000) / 100)
    y = 0.02 * lfilter([TRUTH["K"] * 0.1], [1, -0.9], u) + 0.1 * np.random.default_rng(3).normal(
        size=6000
    )
    record = gb.Record(STEP * np.arange(6000), {"u": u, "y": y}, name="quiet")
    found = fit(Late(), record, starts=2, fixed={"T": STEP / -np.log(0.9), "d": 0.0})
    assert found.records[0].fit_percent("y") < 10
    assert abs(found.estimate["K"] - 0.04) < 4 * found.standard_error["K"] < 0.01
    assert not said(found, "almost none of")


def test_an_output_that_is_noise_is_said_to_be_so():
    random = np.random.default_rng(4)
    record = gb.Record(STEP * np.arange(400), {"u": driven(400)["u"], "y": random.normal(size=400)})
    (text,) = said(fit(Late(), record, starts=2), "almost none of")
    assert "looks like noise" in text


class Limited(gb.StateSpace):
    """A lag whose sensor ends at a limit, and a leak above a level."""

    states = outputs = ("y",)
    inputs = ("u",)
    T = gb.Parameter(0.3, bounds=(0.01, 10), unit="s")
    top = gb.Parameter(5.0, bounds=(0.1, 10))
    leak = gb.Parameter(1.0, bounds=(0, 10))

    def derivative(self, x, u, p):
        return ((u.u - x.y) / p.T - p.leak * gb.where(x.y > 3.0, x.y - 3.0, 0.0),)

    def output(self, x, u, p):
        return (gb.minimum(x.y, p.top),)


def test_a_parameter_of_an_inactive_branch_is_dead_at_this_estimate_only():
    """The limit of 0.8 is found from starts at which it is active; each dead parameter is named by itself."""
    n = 300
    u = np.sign(np.sin(np.arange(n) / 40)) + 0.3
    y = lfilter(
        [1 - np.exp(-0.02 / 0.2)], [1, -np.exp(-0.02 / 0.2)], np.concatenate([[0.0], u[:-1]])
    )
    y = np.minimum(y, 0.8) + 0.01 * np.random.default_rng(0).normal(size=n)
    record = gb.Record(0.02 * np.arange(n), {"u": u, "y": y})
    beyond = fit(Limited(), record, starts=[{}])
    texts = said(beyond, "not determined")
    assert sorted(text.split(" is ")[0] for text in texts) == ["leak", "top"]
    assert all(
        "at this estimate" in text and "try starts at which it does" in text for text in texts
    )
    within = fit(Limited(), record, starts=[{"top": 0.7}])
    assert within.cost < beyond.cost - 100
    assert abs(within.estimate["top"] - 0.8) < 4 * within.standard_error["top"]
    assert [text.split(" is ")[0] for text in said(within, "not determined")] == ["leak"]
    at_bound = fit(Limited(), record, starts=[{"top": 10.0}])
    assert said(at_bound, "top is not determined: it does not change the response")
    assert not said(at_bound, "top ended at its upper bound")


# --- residuals that are correlated in time


class Drift(gb.StateSpace):
    """A lag."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(2.0, bounds=(0.1, 20), unit="1/s")
    b = gb.Parameter(2.0, bounds=(0.1, 20), unit="1/s")

    def derivative(self, x, u, p):
        return (p.b * u.u - p.a * x.x,)

    def output(self, x, u, p):
        return (x.x,)


def drifting(loop, n=6000, step=0.01, gust=0.07, sensor=0.002, seed=0):
    """A disturbance of the state; with a `loop` the input answers to the measured state."""
    random = np.random.default_rng(seed)
    x, states, inputs = 0.0, [], []
    for k in range(n):
        states.append(x + sensor * random.normal())
        inputs.append(np.sign(np.sin(0.5 * step * k)) - loop * states[-1])
        x += step * (3.0 * inputs[-1] - 3.0 * x) + gust * random.normal()
    return gb.Record(step * np.arange(n), {"u": inputs, "x": states})


def colors(record, criterion):
    fit = gb.fit(gb.Problem(Drift(), record, criterion), starts=1, progress=False, profiles=False)
    return fit, [
        text
        for text in fit.warnings
        if "prediction errors are not white" in text or "feedback responds" in text
    ]


def test_a_disturbance_in_a_closed_loop_is_told_and_the_criterion_for_it_does_better():
    record = drifting(loop=2.0)
    biased, (said,) = colors(record, gb.OutputError(inputs="held"))
    assert said.startswith("feedback responds to errors that are correlated in time (u to x)")
    assert "compare with criterion=PredictionError()," in said
    better, _ = colors(record, gb.PredictionError(inputs="held"))
    assert abs(better.estimate["b"] - 3.0) < abs(biased.estimate["b"] - 3.0) / 3


def test_a_small_disturbance_under_sensor_noise_in_a_closed_loop_is_told():
    """Of which the correlation of successive residuals shows little."""
    told = []
    for seed in range(2):
        record = drifting(loop=2.0, n=2000, gust=0.01, sensor=0.05, seed=seed)
        fit, said = colors(record, gb.OutputError(inputs="held"))
        residual = fit.records[0].residual("x")
        assert abs(residual[1:] @ residual[:-1] / (residual @ residual)) < 0.5
        told.append(len(said))
    assert any(told)


@pytest.mark.parametrize(("loop", "gust"), [(2.0, 0.0), (0.0, 0.05)])
def test_nothing_is_told_where_output_error_is_not_biased(loop, gust):
    """Feedback of white sensor noise alone, and process noise without feedback; at most 1 % of fits may be told of."""
    told = []
    for seed in range(2):
        record = drifting(loop=loop, n=600, step=0.03, gust=gust, sensor=0.05, seed=seed)
        told.append(len(colors(record, gb.OutputError(inputs="held"))[1]))
    assert not all(told)


def test_prediction_errors_of_signals_that_were_smoothed_are_told_not_to_be_white():
    record = drifting(loop=0.0)
    smooth = np.convolve(record["x"], np.ones(9) / 9, "same")
    _, (said,) = colors(record.with_signals(x=smooth), gb.PredictionError(inputs="held"))
    assert "the prediction errors are not white" in said
    assert "low-pass filtered" in said


def test_gusts_that_process_noise_does_not_fit_are_told_in_short_records():
    told = []
    for seed in range(2):
        random, n, step = np.random.default_rng(seed), 300, 0.04
        u = np.sign(np.sin(0.8 * step * np.arange(n)))
        shocks = random.normal(size=n + 100)
        gust = 0.3 * lfilter([np.sqrt(1 - 0.92**2)], [1, -0.92], shocks)[100:]
        x = lfilter([0, step], [1, 3 * step - 1], 3 * u + gust) + 0.02 * random.normal(size=n)
        record = gb.Record(step * np.arange(n), {"u": u, "x": x})
        criterion = gb.PredictionError(process_noise=("x",), inputs="held")
        told.append(any("as in gusts" in text for text in colors(record, criterion)[1]))
    assert any(told)


def test_a_predictor_at_the_limit_of_its_stability_is_told():
    """Of a record without noise of the state, from which the gain can learn nothing."""
    random, n = np.random.default_rng(3), 300
    record = gb.Record(0.05 * np.arange(n), {"u": np.repeat(random.normal(size=n // 10), 10)})
    x = gb.simulate(Drift(), {"a": 0.3, "b": 3.0}, record, inputs="held")[
        "x"
    ] + 0.05 * random.normal(size=n)
    rules = (gb.PredictionError(inputs="held"), gb.OutputError(inputs="held"))
    fits = [
        gb.fit(gb.Problem(Drift(), record.with_signals(x=x), rule), starts=1, progress=False)
        for rule in rules
    ]
    told = [any("reached the stability limit" in text for text in fit.warnings) for fit in fits]
    assert told == [True, False]


def test_slow_errors_beside_a_slow_input_are_named_and_in_which_of_several():
    """An input of many frequencies sees errors elsewhere, too."""

    def slow(seed, held=50):
        random = np.random.default_rng(seed)
        u = np.repeat(random.normal(size=200 // held), held)
        flight = gb.Record(0.05 * np.arange(200), {"u": u}, name=f"run {seed}")
        x = gb.simulate(Drift(), {"a": 2.5, "b": 3.0}, flight, inputs="held")["x"]
        errors = lfilter([0.05], [1, -0.95], random.normal(size=400))[200:]
        return gb.Problem(Drift(), flight.with_signals(x=x + errors), gb.OutputError(inputs="held"))

    first = slow(0)
    for problem, place in ((first, ""), (first + slow(1), " in 'run ")):
        text, *_ = said(
            gb.fit(problem, starts=1, profiles=False, progress=False), "stay correlated"
        )
        assert text.startswith(f"the residuals of x{place}")
        assert float(re.findall(r"about ([\d.]+) ", text)[0]) < 8
    many = gb.fit(slow(0, held=1), starts=1, profiles=False, progress=False)
    assert not said(many, "stay correlated")


def test_only_residuals_that_are_not_white_are_said_to_stay_correlated():
    """Spectra of 80 samples of white noise may show a slow part, too."""
    white = lag_record(25, 80)
    errors = lfilter([0.05], [1, -0.98], np.random.default_rng(0).normal(size=180))[100:]
    for record, is_colored in ((white, False), (white.with_signals(y=white["y"] + errors), True)):
        assert bool(said(fit(SampledLag(), record, [{}]), "stay correlated")) == is_colored


def test_slow_errors_that_parameters_take_are_told():
    """A drift during one step looks like another gain and time constant, and leaves little."""
    exact = stepped(noise=0.0, n=60)
    told = []
    for seed in range(2):
        white = np.random.default_rng(seed).normal(size=160)
        slow = lfilter([0.01], [1, -1.8, 0.81], white)
        records = (exact.with_signals(y=exact["y"] + e[100:]) for e in (0.05 * white, slow))
        fits = [fit(Late(), r, [{}]) for r in records]
        # Or they look like a missing term, where the test for these is the first to reject.
        words = "stay correlated", "does not explain the data"
        told.append([any(said(found, word) for word in words) for found in fits])
    assert told == [[False, True]] * 2


def test_white_residuals_are_not_blamed():
    random, n = np.random.default_rng(1), 500
    u = np.repeat(random.normal(size=n // 10), 10)
    record = gb.Record(0.05 * np.arange(n), {"u": u})
    x = gb.simulate(Drift(), {"a": 2.5, "b": 3.0}, record, inputs="held")[
        "x"
    ] + 0.05 * random.normal(size=n)
    for criterion in (gb.OutputError(inputs="held"), gb.PredictionError(inputs="held")):
        assert not colors(record.with_signals(x=x), criterion)[1]


@cache
def driven_fit():
    """Return the fit from which the deviation of the errors is taken."""
    return fit(Late(), driven(300), starts=[TRUTH])


@pytest.mark.parametrize("ratio", [0.6, 0.65, 1.55, 1.62])
def test_a_given_standard_deviation_is_doubted_beyond_a_factor_of_1_6(ratio):
    record = driven(300)
    own = float(np.sqrt(np.nanmean(driven_fit().records[0].residual("y") ** 2)))
    given = gb.OutputError(inputs="held", noise={"y": own / ratio})
    texts = said(fit(Late(), record, [TRUTH], given), "given standard deviation")
    assert len(texts) == (not 0.63 <= ratio <= 1.58)
    assert all(f"is {ratio:.2g} times the given standard deviation" in text for text in texts)


def texts(check, *pairs, explained=True):
    """What a check says of parts and their fitted records."""
    fit = SimpleNamespace(misfit=None, is_explained=explained)
    evidence = SimpleNamespace(records=pairs, fit=fit, is_noisy=True, is_explained=explained)
    return [finding.text for finding in check(evidence)]


class Signals(dict):
    """Of a record in two pieces."""

    def __init__(self, signals, *, has_time, name, samples):
        super().__init__(signals)
        self.has_time, self.name = has_time, name
        self.independent_pieces = np.split(np.arange(samples), [samples // 2])


def fitted_with(residuals, *, white=True, inputs=None, time=True, name="one"):
    """A part and its fitted record with these residuals by output."""
    signals = inputs or {}
    part = SimpleNamespace(
        model=SimpleNamespace(criterion=SimpleNamespace(corrects_states=white)),
        problem=SimpleNamespace(model=SimpleNamespace(state_names=())),
        data=SimpleNamespace(stretches=[SimpleNamespace(step=STEP)]),
        is_static=False,
        system=SimpleNamespace(inputs=tuple(signals)),
    )
    data = Signals(
        signals | residuals, has_time=time, name=name, samples=len(next(iter(residuals.values())))
    )
    return part, SimpleNamespace(
        outputs=tuple(residuals),
        residual=residuals.__getitem__,
        data=data,
        name=name,
        innovation_parameters=lambda output: 1,
    )


def test_prediction_errors_are_tested_beyond_the_lag_that_a_gain_removes(the_cure):
    random = np.random.default_rng(0)
    white = random.normal(size=(60, 1000))
    alarms = [len(texts(colored_predictions, fitted_with({"y": e}))) for e in white]
    assert sum(alarms) <= 3

    # A moving average of correlation 0.3 after two samples, and none after one.
    e = lfilter([1.0, 0.0, 1 / 3], [1.0], random.normal(size=2000))
    (text,) = texts(colored_predictions, fitted_with({"y": e}))
    assert f"(correlation 0.31 after {2 * STEP:.2g} s for y)" in text
    assert "as in gusts, which last longer than a sample: use the cure" in text
    (text,) = texts(colored_predictions, fitted_with({"y": e}), explained=False)
    assert "or the model is incomplete, or as in gusts: compare with the cure" in text
    (text,) = texts(colored_predictions, fitted_with({"y": e}), fitted_with({"y": e}, name="two"))
    assert "for y in 'one'" in text
    assert "for y in 'two'" in text
    assert not texts(colored_predictions, fitted_with({"y": e}, white=False))


def fed_back(n=3000, *, gain=0.5, color=0.9, seed=0, **more):
    """Errors of some color, and an input that responds to the last one, in each of two pieces."""
    random = np.random.default_rng(seed)
    e = lfilter([1.0], [1, -color], random.normal(size=n))
    u = random.normal(size=n)
    u[1:] += gain * e[:-1]
    return fitted_with({"y": e}, white=False, inputs={"u": u, "w": random.normal(size=n)}, **more)


@pytest.fixture
def the_cure(monkeypatch):
    """A criterion for gusts without a model in which they act."""
    for checked in (module, feedback_module):
        monkeypatch.setattr(checked, "gust_criterion", lambda *_: "the cure")


def test_feedback_is_told_where_errors_are_colored_and_an_input_responds_to_them(the_cure):
    (text,) = texts(feedback, fed_back())
    assert "(u to y)" in text
    assert "at most 1 % of fits" in text
    assert text.endswith("with the cure.")
    # White: no error depends on an earlier one.
    assert not texts(feedback, fed_back(color=0.0))
    assert not texts(feedback, fed_back(gain=0.0))
    assert not texts(feedback, fed_back(time=False))
    part, fitted = fed_back()
    part.model.criterion.corrects_states = True
    assert not texts(feedback, (part, fitted))
    part, fitted = fed_back()
    part.is_static = True
    (text,) = texts(feedback, (part, fitted))
    assert text.endswith("use data without feedback.")
    (text,) = texts(feedback, fed_back(), fed_back(seed=1, name="two"))
    assert "u to y in 'one'" in text
    assert "u to y in 'two'" in text


def test_feedback_is_tested_at_a_level_that_all_inputs_and_outputs_share(the_cure):
    """Of one output and two inputs each response at half a per cent, of two outputs at a quarter."""
    seen = set()
    for gain in np.linspace(0.113, 0.134, 10):
        one = fed_back(600, gain=gain, seed=3)
        p = _response(one)
        told = texts(feedback, one)
        assert len(told) == (p < 0.01 / 2)
        both = texts(feedback, one, fed_back(600, gain=0.0, seed=4, name="two"))
        assert len(both) == (p < 0.01 / 4)
        seen.add(int(np.searchsorted([0.01 / 8, 0.01 / 4, 0.01 / 2, 0.01], p)))
    assert seen >= {1, 2, 3}


def _response(pair):
    _, fitted = pair
    halves = np.split(fitted.residual("y"), 2)
    return cross_correlation(np.split(fitted.data["u"], 2), halves).p_value


def test_color_is_tested_at_a_level_that_all_outputs_share(the_cure):
    seen = set()
    for color in np.linspace(0.09, 0.21, 13):
        one = fed_back(600, gain=0.9, color=color, seed=5)
        p = whiteness(np.split(one[1].residual("y"), 2)).p_value
        assert len(texts(feedback, one)) == (p < 0.01)
        both = texts(feedback, one, fed_back(600, color=0.0, seed=6, name="two"))
        assert len(both) == (p < 0.01 / 2)
        seen.add(int(np.searchsorted([0.01 / 4, 0.01 / 2, 0.01, 0.02], p)))
    assert seen >= {1, 2, 3}


def test_an_output_is_not_explained_below_a_tenth_and_half_of_what_its_noise_allows():
    random = np.random.default_rng(0)
    slow = np.sin(np.arange(4000) / 200)

    def told(y, percent, has_time=True, **more):
        stretches = [SimpleNamespace(outputs=[0 * y, y])]
        criterion = SimpleNamespace(corrects_states=more.pop("corrects", False))
        data = SimpleNamespace(stretches=stretches, constant_inputs=more.pop("constant", False))
        system = SimpleNamespace(inputs=("u",))
        part = SimpleNamespace(
            model=SimpleNamespace(criterion=criterion),
            is_static=more.pop("static", False),
            problem=SimpleNamespace(model=SimpleNamespace(state_names=())),
            data=data,
            system=system,
        )
        kept = SimpleNamespace(name="run", has_time=has_time)
        percents = {"z": 50.0, "y": percent}
        fitted = SimpleNamespace(
            outputs=("z", "y"), fit_percent=percents.__getitem__, data=kept, name="part"
        )
        return texts(unexplained_outputs, (part, fitted))

    y = 0.77 * slow + random.normal(size=4000)
    allowed = noise_ratio([y]).attainable_fit_percent
    assert 9 < allowed < 16
    assert told(y, allowed / 2 + 0.1) == []
    (text,) = told(y, allowed / 2 - 0.1)
    assert f"variation of y in 'part' (fit {allowed / 2 - 0.1:.1f} %)" in text
    assert f"would allow about {allowed:.0f} %" in text
    assert told(slow, 9.9)
    assert told(slow, 10.0) == []
    (text,) = told(random.normal(size=4000), 9.9)
    assert "looks like noise" in text
    (text,) = told(y, 3.0, has_time=False)
    assert text.endswith("or another model structure, unless that variation is noise.")
    assert told(slow, 3.0, corrects=True) == []
    assert told(slow, 3.0, static=True, constant=True) == []
    assert told(slow, 3.0, static=True)


def test_samples_that_are_fitted_twice_are_named():
    flight = slid(0.0, 2.0)
    once, later = flight.between(0.0, 1.2), flight.between(0.8, 2.0)
    for first, second in ((flight, flight), (once, later)):
        problem = gb.several(Slide(), [first, second], fixed={"K": 3.0})
        (text,) = said(gb.fit(problem, 1, progress=False), "count twice")
        assert "have the same samples of x, which count twice: the standard errors" in text
    apart = gb.several(Slide(), [once, flight.between(1.21, 2.0)], fixed={"K": 3.0})
    assert not said(gb.fit(apart, 1, progress=False), "count twice")


def test_a_response_that_is_fitted_twice_is_named():
    omega = np.geomspace(0.1, 10, 8)
    first, later = (gb.FrequencyResponse(omega, k / (1 + 1j * omega)) for k in (1.0, 1.1))
    first, again, later = (
        gb.Problem(Lag(), data, name=name)
        for data, name in ((first, "a"), (first, "b"), (later, "c"))
    )
    (text,) = said(gb.fit(first + later + again, 1, progress=False), "count twice")
    assert text.startswith("'a' and 'b' have the same points")
    assert not said(gb.fit(first + later, 1, progress=False), "count twice")
