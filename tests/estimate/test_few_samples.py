"""Experiments of few samples, as in kinetics: a decay, and a substance that is measured once."""

import numpy as np
import pytest

import greybox as gb

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


@pytest.mark.parametrize("samples", [3, 4, 5, 10])
def test_a_decay_of_few_samples(samples):
    """Without alias of the integration, and without outliers."""
    for seed in range(3):
        time = np.linspace(0, 5, samples)
        x = 2 * np.exp(-0.8 * time) + 0.02 * np.random.default_rng(seed).normal(size=samples)
        fit = gb.fit(gb.Problem(Decay(), gb.Record(time, {"x": x})), progress=False)
        low, high = fit.interval()["k"]
        assert low < 0.8 < high
        assert not [text for text in fit.warnings if "same response" in text or "outlier" in text]


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
    for seed in range(6):
        A, B = both(time) + 0.02 * np.random.default_rng(seed).normal(size=(2, 9))
        B[~np.isin(range(9), present)] = np.nan
        criterion = gb.OutputError(noise=noise, initial={"A": 1.0, "B": 0.0})
        record = gb.Record(time, {"A": A, "B": B})
        fit = gb.fit(gb.Problem(Chain(), record, criterion), starts=2, progress=False)
        doubts += any("given standard deviation" in text for text in fit.warnings)
        errors.append([fit.standard_error[name] for name in ("k1", "k2")])
    assert doubts <= 1
    assert np.median(errors, axis=0) == pytest.approx(exact, rel=0.35)


@pytest.mark.parametrize("batches", [1, 8])
def test_noise_of_few_samples_in_each_of_several_series_is_to_be_given(batches):
    """Of 20 batches of four samples, intervals of 95 % held in 54 %, and with given noise in all."""
    time, records = np.linspace(0, 5, 4), []
    for seed in range(batches):
        x = 2 * np.exp(-0.8 * time) + 0.02 * np.random.default_rng(seed).normal(size=4)
        records.append(gb.Record(time, {"x": x}))

    def said(**options):
        criterion = gb.OutputError(**options)
        parts = [gb.Problem(Decay(), record, criterion) for record in records]
        texts = gb.fit(sum(parts[1:], parts[0]), starts=2, progress=False).warnings
        return any("is estimated from 4 samples" in text for text in texts)

    assert said() == (batches > 1)
    assert not said(noise={"x": 0.02})
