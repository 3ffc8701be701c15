"""Experiments of few samples, as in kinetics: a decay, and a substance that is measured once."""

import numpy as np
import pytest
from scipy.optimize import curve_fit, minimize_scalar

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

K, LATE = 0.5, 0.2  # 1/s


class Decay(gb.StateSpace):
    """A substance that decays by itself."""

    states = outputs = ("x",)
    inputs = ()
    k = gb.Parameter(0.5, bounds=(0.01, 10), unit="1/s")

    def derivative(self, x, u, p):
        return (-p.k * x.x,)

    def output(self, x, u, p):
        return (x.x,)


class Chain(gb.StateSpace):
    """A becomes B, which decays."""

    states = outputs = ("A", "B")
    inputs = ()
    k1, k2 = (gb.Parameter(value, bounds=(0.01, 10), unit="1/s") for value in (K, LATE))

    def derivative(self, x, u, p):
        return (-p.k1 * x.A, p.k1 * x.A - p.k2 * x.B)

    def output(self, x, u, p):
        return (x.A, x.B)


def both(time, k1=K, k2=LATE):
    """Return A and B at times (n,), from one and zero."""
    A = np.exp(-k1 * time)
    return np.array([A, k1 * (A - np.exp(-k2 * time)) / (k2 - k1)])


@pytest.mark.parametrize("samples", [3, 4])
def test_a_decay_of_few_samples(samples):
    """Without alias of the integration, and without outliers."""
    time = np.linspace(0, 5, samples)
    x = 2 * np.exp(-0.8 * time) + 0.02 * np.random.default_rng(0).normal(size=samples)
    fit = gb.fit(gb.Problem(Decay(), gb.Record(time, {"x": x})), progress=False)
    low, high = fit.interval()["k"]
    assert low < 0.8 < high
    assert not [text for text in fit.warnings if "same response" in text or "outlier" in text]


def test_replicates_at_one_time_are_a_record_each():
    """Three tubes at each of six times: as SciPy from all samples together."""
    time = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
    tubes = np.exp(-0.4 * time) + 0.03 * np.random.default_rng(3).normal(size=(3, 6))
    with pytest.raises(ValueError, match="replicates as one record each"):
        gb.Record(np.repeat(time, 3), {"x": tubes.T.ravel()})

    records = [gb.Record(time, {"x": x}) for x in tubes]
    criterion = gb.OutputError(initial={"x": 1.0})
    fit = gb.fit(gb.several(Decay(), records, criterion=criterion), 3, progress=False)
    (k,), covariance = curve_fit(
        lambda t, k: np.exp(-k * t), np.tile(time, 3), tubes.ravel(), p0=[0.5]
    )
    assert fit.estimate["k"] == pytest.approx(k, rel=1e-4)
    # SciPy takes the errors as white, the fit as correlated as its residuals are.
    assert fit.standard_error["k"] == pytest.approx(np.sqrt(covariance[0, 0]), rel=0.3)


@pytest.mark.parametrize("samples", [1, 2, 9])
def test_given_noise_counts_where_an_output_has_few_samples(samples):
    """The standard errors are those of linear regression with this noise."""
    time, noise = np.linspace(0, 8, 9), {"A": 0.02, "B": 0.02}
    present = np.linspace(8, 0, samples).astype(int)
    steps = ((1e-6, 0.0), (0.0, 1e-6))
    slopes = np.array([(both(time, K + a, LATE + b) - both(time)) / 1e-6 for a, b in steps])
    J = np.hstack([slopes[:, 0], slopes[:, 1, present]]) / 0.02
    exact = np.sqrt(np.diag(np.linalg.inv(J @ J.T)))
    errors, doubts = [], 0
    for seed in range(2):
        A, B = both(time) + 0.02 * np.random.default_rng(seed).normal(size=(2, 9))
        B[~np.isin(range(9), present)] = np.nan
        criterion = gb.OutputError(noise=noise, initial={"A": 1.0, "B": 0.0})
        record = gb.Record(time, {"A": A, "B": B})
        fit = gb.fit(gb.Problem(Chain(), record, criterion), starts=1, progress=False)
        doubts += any("given standard deviation" in text for text in fit.warnings)
        errors.append([fit.standard_error[name] for name in ("k1", "k2")])
    assert doubts <= 1
    assert np.median(errors, axis=0) == pytest.approx(exact, rel=0.35)


def batches(count, samples, noise=0.02):
    """Return records of decays from the first values one to two."""
    time, records = np.linspace(0, 5, samples), []
    for seed in range(count):
        random = np.random.default_rng(seed)
        x = random.uniform(1, 2) * np.exp(-0.8 * time) + noise * random.normal(size=samples)
        records.append(gb.Record(time, {"x": x}))
    return records


def fitted(records, method=None, **options):
    """Return the fit of all batches."""
    problem = gb.several(Decay(), records, criterion=gb.OutputError(**options))
    return gb.fit(problem, starts=1, progress=False, method=method or gb.MultipleShooting())


@pytest.mark.parametrize("method", [gb.MultipleShooting(), gb.SingleShooting()])
def test_batches_of_few_samples_share_the_variance_of_an_output(method):
    """One variance for all is least squares, and a long record has its own."""
    records = batches(6, 4)
    time, x = records[0].time, np.array([record["x"] for record in records])

    def rest(k):
        decay = np.exp(-k * time)
        return np.sum((x - np.outer(x @ decay / (decay @ decay), decay)) ** 2)

    fit = fitted(records, method)
    assert fit.estimate["k"] == pytest.approx(minimize_scalar(rest, (0.5, 1)).x, abs=1e-4)
    low, high = fit.interval()["k"]
    assert low < 0.8 < high
    exact, noisy = batches(2, 40, noise=0.001), batches(6, 4, noise=0.2)
    joint = fitted([*noisy, *exact], method).estimate["k"]
    assert joint == pytest.approx(fitted(exact).estimate["k"], abs=3e-4)


@pytest.mark.parametrize(("names", "is_said"), [("x", False), ("xyz", True)])
def test_noise_of_few_samples_is_to_be_given_unless_it_is_shared(names, is_said):
    """Three outputs of three models have variances of their own, of four samples each."""

    def said(**noise):
        parts = []
        for name, record in zip(names * (3 // len(names)), batches(3, 4), strict=True):
            model = type(name, (Decay,), {"outputs": (name,)})()
            data = gb.Record(record.time, {name: record["x"]})
            parts.append(gb.Problem(model, data, gb.OutputError(**noise.get(name, {}))))
        texts = gb.fit(sum(parts[1:], parts[0]), starts=1, progress=False).warnings
        return any("is estimated from 4 samples" in text for text in texts)

    assert said() == is_said
    assert not said(**{name: {"noise": {name: 0.02}} for name in names})


def test_few_samples_of_a_right_model_do_not_look_like_gusts():
    """Four samples of two outputs leave four degrees of freedom, whose spectrum nothing shows."""
    time = np.linspace(0, 3, 4)
    for seed in range(500, 515):
        noise = 0.02 * np.random.default_rng(seed).normal(size=(2, 4))
        data = dict(zip("AB", both(time, 1.0, 0.4) + noise, strict=True))
        problem = gb.Problem(Chain(), gb.Record(time, data))
        fit = gb.fit(problem, [{"k1": 1.0, "k2": 0.4}], progress=False)
        assert not [text for text in fit.warnings if "gusts" in text]
