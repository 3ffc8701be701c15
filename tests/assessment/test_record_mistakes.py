"""What a user may get wrong about records: one sentence each, with the value and the cure."""

import numpy as np
import pytest
from spring_lag_tilt import HELD, SPRING, Lag, Spring, fit, spring

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

DATA = spring(100)


def record(**changes):
    return DATA.with_signals(**changes)


def test_a_unit_that_the_model_declares_needs_no_warning(tmp_path):
    class Weighed(Spring):
        units = {"v": "m/s²"}

    path = tmp_path / "spring.csv"
    rows = zip(DATA.time, DATA["F"], DATA["x"], DATA["v"] / 9.80665, strict=True)
    lines = [",".join(map(repr, map(float, row))) for row in rows]
    path.write_text("\n".join(["time [s],F,x,v [g]", *lines]))
    flown = gb.read(path, columns={"v": "v"})["spring"]
    assert "gram" in str(fit(gb.Problem(Spring(), flown)).warnings)
    assert "gram" not in str(fit(gb.Problem(Weighed(), flown)).warnings)


def test_a_misspelled_unit_is_named_where_the_model_declares_none():
    def warnings(unit):
        data = gb.Record(DATA.time, DATA.signals, units={"v": unit, "F": "LSB"}, hold=DATA.hold)
        return str(fit(gb.Problem(Spring(), data)).warnings)

    assert "v: the unit 'm/s^s' is not known: write 'm/s^2'" in warnings("m/s^s")
    assert "is not known" not in warnings("m/s^2")


def noise(n=100):
    return dict(zip(("x", "v"), np.random.default_rng(1).normal(size=(2, n)), strict=True))


def irregular():
    time = (
        DATA.time[0] + np.cumsum(np.random.default_rng(0).uniform(0.6, 1.4, len(DATA))) * DATA.step
    )
    return gb.Record(time, DATA.signals)


class Wide(Spring):
    """Without bounds."""

    b = gb.Parameter(1.0)


class Wild(gb.StateSpace):
    """Explodes within a sample, wherever it starts."""

    states = outputs = ("x",)
    inputs = ("F",)
    a = gb.Parameter(1e6, bounds=(1e5, 1e7))

    def derivative(self, x, u, p):
        return (gb.exp(p.a * (1 + x.x**2)) + u.F,)

    def output(self, x, u, p):
        return (x.x,)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: fit(gb.Problem(Spring(), record(F=np.ones(100), **noise()))),
            r"inputs .* never change \(F\) and x and v are indistinguishable",
        ),
        (
            lambda: fit(gb.Problem(Spring(), record(x=np.zeros(100), v=np.ones(100)))),
            r"outputs .* never change \(x, v\)",
        ),
        (
            lambda: fit(
                gb.Problem(Spring(), record(x=np.nan * np.ones(100), v=np.nan * np.ones(100)))
            ),
            "of x, v",
        ),
        (
            lambda: fit(gb.Problem(Spring(), record(F=np.nan * np.ones(100)))),
            "no measured value of F",
        ),
        (
            lambda: fit(gb.Problem(Lag(), short(), free=("d",))),
            "longest delay in the bounds, 0.5 s",
        ),
        (
            lambda: fit(gb.Problem(Spring(), irregular(), gb.PredictionError())),
            "not uniformly sampled: prepare the record",
        ),
        (
            lambda: fit(
                gb.Problem(Spring(), gb.Record([0.0], {"F": [0], "x": [0]}, hold={"F": np.inf}))
            ),
            "no usable stretch, 3 samples in a row with all inputs: give a longer record",
        ),
        (
            lambda: fit(gb.Problem(Spring(), gb.Record([0.0, 0.1], {"F": [0, 1], "x": [0, 1]}))),
            "no usable stretch",
        ),
        (lambda: fit(gb.Problem(Wide(), DATA), 5), "random starts for 'b' need finite bounds"),
        (
            lambda: gb.Problem(Spring(), gb.Record(DATA.time, {"F": DATA["F"]})),
            "none of the outputs of Spring",
        ),
        (
            lambda: gb.Problem(Spring(), gb.Record(DATA.time, {"x": DATA["x"]})),
            "needs the input 'F'",
        ),
        (
            lambda: gb.Record(np.zeros(3), {}),
            r"time does not increase after 0.000000 s .*replicates as one record each, gb.several",
        ),
        (
            lambda: gb.Record([0.0, 1.0, 0.5], {}),
            r"time does not increase after 1.000000 s \(index 1\): sort the samples.$",
        ),
        (
            lambda: gb.Problem(Spring(), DATA, gb.OutputError(initial={"y": 0.0})),
            "no state 'y'; it has x, v",
        ),
        (
            lambda: gb.OutputError(initial={"x": np.nan}),
            "initial gives 'x' the value nan: give a finite number or",
        ),
        (lambda: gb.OutputError(initial={"x": "0"}), "initial gives 'x' the value '0'"),
        (
            lambda: fit(
                gb.Problem(Spring(), DATA, gb.OutputError(initial={"x": lambda p: p.mass}))
            ),
            r"initial\['x'\]: .*no 'mass'; it has k, c, b, d",
        ),
        (
            lambda: gb.OutputError(noise="white"),
            "noise 'white' is not known: use 'diagonal', 'full', {",
        ),
        (
            lambda: gb.OutputError(noise=np.ones(3)),
            r"noise array.*is not known: use 'diagonal', 'full', \{output: standard deviation\}",
        ),
        (lambda: gb.OutputError(noise={"x": 0.0}), "give a standard deviation above 0"),
        (
            lambda: gb.Problem(Spring(), DATA, gb.OutputError(noise={"x": 0.1})),
            "no standard deviation for 'v'",
        ),
        (
            lambda: gb.Problem(Spring(), DATA, gb.OutputError(noise={"x": 0.1, "v": 1, "w": 1})),
            "no output 'w'; it has x, v",
        ),
        (
            lambda: gb.OutputError(inputs="cubic"),
            "inputs 'cubic' is not known: use 'linear' or 'held'",
        ),
        (lambda: gb.Problem(Spring(), DATA, gb.OutputError(biases=("q",))), "'q'"),
        (
            lambda: gb.Problem(Lag(), lag_data(), gb.OutputError(initial={"y": 0.0})),
            "Lag has no state 'y'",
        ),
        (lambda: gb.Problem(Spring(), DATA, gb.PredictionError(corrected=("z",))), "'z'"),
        (
            lambda: gb.Problem(Spring(), DATA, HELD, at={"x": 0.0}),
            "operating point of a frequency response",
        ),
        (lambda: gb.Problem(Spring(), DATA, gb.RelativeError()), "criterion"),
        (lambda: gb.Problem(Spring(), DATA, HELD, rename={"x_bias": "b2"}), "'x_bias'"),
        (
            lambda: gb.Problem(Spring(), [DATA, DATA]),
            r"data is a list with 2 in it: use gb.several\(model, \[...\]\)",
        ),
        (
            lambda: gb.Problem(Spring(), (DATA,)),
            "data is a list with 1 in it",
        ),
        (
            lambda: gb.Problem(Spring(), gb.data.Recording({"A": DATA, "B": DATA})),
            r"messages A, B: give .* log\['A'\]",
        ),
        (
            lambda: gb.Problem(Spring(), np.zeros(3)),
            "give a FrequencyResponse, a Record or a TransientSpectrum",
        ),
        (lambda: gb.several(Spring(), DATA), "takes a list of at least two records"),
        (lambda: gb.several(Spring(), None), "takes a list of at least two records"),
        (
            lambda: gb.several(Spring(), gb.data.Recording({"A": DATA, "B": DATA})),
            "takes a list of at least two records",
        ),
    ],
)
def test_a_mistake_is_one_sentence(make, words):
    with pytest.raises((ValueError, TypeError), match=words) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert "casadi" not in str(caught.value).lower()


def lag_data(n=50):
    return gb.Record(
        np.arange(n) / 20, {"u": np.random.default_rng(0).normal(size=n), "y": np.zeros(n)}
    )


def short():
    return lag_data(8)


@pytest.mark.filterwarnings("error")
def test_a_model_that_diverges_from_every_start_is_a_result():
    found = fit(gb.Problem(Wild(), DATA), 4)
    assert not found.converged
    assert np.isnan(found.estimate["a"])
    assert "no start converged" in found.status
    assert "FAILED" in str(found)


def test_a_bias_of_a_signal_without_values_is_a_sentence():
    empty = record(x=np.full(100, np.nan))
    with pytest.raises(ValueError, match="biases names 'x', but the record has no measured value"):
        fit(gb.Problem(Spring(), empty, gb.OutputError(biases=("x",))))


def test_one_output_without_any_value_is_left_out():
    some = fit(gb.Problem(Spring(), record(v=np.full(100, np.nan)), HELD))
    without = fit(
        gb.Problem(Spring(), gb.Record(DATA.time, {n: DATA[n] for n in ("F", "x")}), HELD)
    )
    assert some.converged
    np.testing.assert_allclose(some.estimate["k"], without.estimate["k"], rtol=1e-6)
    np.testing.assert_allclose(some.standard_error["k"], without.standard_error["k"], rtol=0.05)


def test_nothing_is_changed_by_a_fit():
    signals = {n: DATA[n].copy() for n in DATA.signals}
    problem = gb.Problem(Spring(), DATA, HELD)
    before = repr(problem)
    fit(problem)
    assert repr(problem) == before
    assert all(np.array_equal(DATA[n], v) for n, v in signals.items())
    assert SPRING["k"] == 9.0


def test_given_noise_that_is_far_off_is_named():
    """The errors follow the residuals, whatever was given; the sentence says which output and by how much."""
    right, wrong = (
        fit(
            gb.Problem(
                Spring(), spring(300), gb.OutputError(noise={"x": 0.05 * share, "v": 0.15 * share})
            )
        )
        for share in (1.0, 0.01)
    )
    assert not any("given standard deviation" in w for w in right.warnings)
    texts = [w for w in wrong.warnings if "given standard deviation" in w]
    residual = np.sqrt(np.nanmean(wrong.records[0].residual("x") ** 2))
    assert [w.split(" in ")[0] for w in texts] == ["the residual of x", "the residual of v"]
    assert f"{residual / 0.0005:.2g} times" in texts[0]
    for name in SPRING:
        assert wrong.standard_error[name] == pytest.approx(right.standard_error[name], rel=0.25)
