"""Responses of coupled inputs and outputs against the plant that was simulated."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.spectral import response_matrix

PERIOD, RATE, PERIODS = 20.0, 25.0, 6
POLES = {
    ("p", "da"): (4.0, 2.0),
    ("p", "dr"): (1.5, 1.0),
    ("r", "da"): (-0.5, 3.0),
    ("r", "dr"): (-2.0, 1.5),
}


def plant(pair, omega):
    gain, pole = POLES[pair]
    return gain / (1j * omega + pole)


def record(noise, coupling=0.4, seed=0):
    """Two multisines at once, each reaching the other input as well; in the steady state, by Fourier series."""
    test = gb.experiment.multisine(1.0, 15.0, PERIOD, RATE, signals=("da", "dr"), periods=1)
    count = round(PERIOD * RATE)
    pure = np.array([test["da"][:count], test["dr"][:count]])
    mixed = {"da": pure[0] + coupling * pure[1], "dr": pure[1] - coupling * pure[0]}
    omega = 2 * np.pi / PERIOD * np.arange(count // 2 + 1)
    signals = {name: np.tile(x, PERIODS) for name, x in mixed.items()}
    random = np.random.default_rng(seed)
    for output in ("p", "r"):
        clean = sum(plant((output, name), omega) * np.fft.rfft(x) for name, x in mixed.items())
        clean = np.tile(np.fft.irfft(clean, count), PERIODS)
        signals[output] = clean + noise * random.standard_normal(clean.size)
    signals |= {"e_a": np.tile(pure[0], PERIODS), "e_r": np.tile(pure[1], PERIODS)}
    return gb.Record(np.arange(count * PERIODS) / RATE, signals)


def estimated(data):
    return response_matrix(data, PERIOD, ["da", "dr"], ["p", "r"], excitations=["e_a", "e_r"])


def test_coupling_is_removed():
    """Without noise the plant, where a ratio of transforms is far off."""
    data = record(0.0)
    found = estimated(data)
    assert [(r.output, r.input) for r in found] == list(POLES)
    for response in found:
        truth = plant((response.output, response.input), response.omega)
        # Likelihoods weigh by variances, and periods without noise are exact to rounding.
        assert np.all(np.isfinite(response.variance**-2))
        inner = slice(2, -2)  # what is beyond the last line of the other input is extrapolated
        np.testing.assert_allclose(response.response[inner], truth[inner], rtol=0.01)
    ratio = gb.spectral.periodic_response(data, PERIOD, "da", "p")
    assert np.median(np.abs(ratio.response / plant(("p", "da"), ratio.omega) - 1)) > 0.1


def test_errors_have_the_right_size():
    """Squared errors over their variances have the mean one."""
    ratios = []
    for seed in range(7):
        for response in estimated(record(0.05, seed=seed)):
            truth = plant((response.output, response.input), response.omega)
            ratios.append(
                np.mean((np.abs(response.response - truth) ** 2 / response.variance)[2:-2])
            )
    # An estimated variance of ν degrees of freedom makes this ν / (ν - 2).
    assert 0.9 < np.mean(ratios) / (10 / 8) < 1.2


def test_inputs_that_are_alike_are_refused():
    """And too few periods."""
    data = record(0.0)
    same = data.with_signals(dr=data["da"])
    with pytest.raises(ValueError, match="cannot be separated"):
        estimated(same)
    with pytest.raises(ValueError, match="2 whole periods of 20 s"):
        estimated(data.between(0, 2 * PERIOD))


def test_one_file_holds_all(tmp_path):
    """Each is read back by its names."""
    found = estimated(record(0.05))
    gb.data.write_responses(found, tmp_path / "matrix.csv")
    for response in found:
        prefix = f"{response.output}_{response.input}_"
        read = gb.read_response(tmp_path / "matrix.csv", prefix, response.input, response.output)
        np.testing.assert_array_equal(read.response, response.response)
        np.testing.assert_array_equal(read.variance, response.variance)


def test_excitations_may_be_of_any_unit():
    data = record(0.01)
    scaled = data.with_signals(e_a=1e3 * data["e_a"], e_r=1e-3 * data["e_r"])
    for one, other in zip(estimated(data), estimated(scaled), strict=True):
        np.testing.assert_array_equal(one.omega, other.omega)
        np.testing.assert_allclose(one.response, other.response, rtol=1e-9)


def test_the_variance_is_that_of_the_jackknife():
    """Of one input that owns its lines alone: of a ratio of sums, with every period left out in turn."""
    random = np.random.default_rng(1)
    count, rate, periods = 40, 20.0, 5
    t = np.arange(count * periods) / rate
    lines = np.array([2, 3, 5, 8])
    u = sum(np.sin(2 * np.pi * k / 2.0 * t + k) for k in lines) + 0.01 * random.standard_normal(
        t.size
    )
    y = 2 * u + 0.3 * random.standard_normal(t.size)
    data = gb.Record(t, {"u": u, "y": y}, {"u": "N", "y": "m"}, name="r", source="r.csv")
    (found,) = response_matrix(data, 2.0, ["u"], ["y"], name="test")
    np.testing.assert_allclose(found.omega, np.pi * lines)
    U, Y = (np.fft.rfft(x.reshape(periods, count), axis=1)[:, lines] for x in (u, y))
    np.testing.assert_allclose(found.response, Y.sum(axis=0) / U.sum(axis=0))
    without = np.array(
        [np.delete(Y, k, 0).sum(axis=0) / np.delete(U, k, 0).sum(axis=0) for k in range(periods)]
    )
    scatter = np.sum(np.abs(without - without.mean(axis=0)) ** 2, axis=0)
    np.testing.assert_allclose(found.variance, (periods - 1) / periods * scatter)
    np.testing.assert_allclose(found.dof, 2 * (periods - 1))
    assert (found.name, found.source, found.units) == ("test u to y", "r.csv", {"u": "N", "y": "m"})
    (stretch,) = found.stretches
    assert (stretch.start, stretch.end) == (t[0], t[-1])


def test_three_periods_two_lines_for_each_input_and_one_excitation_for_each():
    t = np.arange(120) / 20.0
    lines = {"a": (2, 5), "b": (3, 7)}
    signals = {name: sum(np.sin(np.pi * k * t + k) for k in own) for name, own in lines.items()}
    data = gb.Record(t, {**signals, "y": signals["a"] + 2 * signals["b"]})
    first, second = response_matrix(data, 2.0, ["a", "b"], ["y"])
    np.testing.assert_allclose(first.response, 1)
    np.testing.assert_allclose(second.response, 2)
    np.testing.assert_allclose(second.omega, [3 * np.pi, 7 * np.pi])
    with pytest.raises(ValueError, match="there are 1 excitations for 2 inputs: give one for each"):
        response_matrix(data, 2.0, ["a", "b"], ["y"], excitations=["a"])
    lone = data.with_signals(b=np.sin(3 * np.pi * t))
    with pytest.raises(ValueError, match="b has 1 line of its own"):
        response_matrix(lone, 2.0, ["a", "b"], ["y"])


@pytest.mark.parametrize(("share", "alike"), [(0.9, False), (0.999, True)])
def test_inputs_that_hold_the_same_lines_are_refused(share, alike):
    """Each excitation has lines of its own, but a mixer gives nearly the same sum to both inputs."""
    t = np.arange(120) / 20.0
    e_a = np.sin(2 * np.pi * t) + np.sin(5 * np.pi * t)
    e_b = np.sin(3 * np.pi * t + 1) + np.sin(7 * np.pi * t + 2)
    a, b = e_a + share * e_b, share * e_a + e_b
    data = gb.Record(t, {"a": a, "b": b, "e_a": e_a, "e_b": e_b, "y": a + 2 * b})
    if alike:
        with pytest.raises(ValueError, match="condition number"):
            response_matrix(data, 2.0, ["a", "b"], ["y"], excitations=["e_a", "e_b"])
    else:
        first, second = response_matrix(data, 2.0, ["a", "b"], ["y"], excitations=["e_a", "e_b"])
        np.testing.assert_allclose(first.response, 1)
        np.testing.assert_allclose(second.response, 2)
