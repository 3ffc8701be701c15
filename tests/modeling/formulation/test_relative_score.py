"""What noise makes of a sum of relative errors, against many data sets that were drawn."""

import numpy as np
import pytest
from declared_models import measured
from scipy.optimize import minimize_scalar

import greybox as gb
from greybox.modeling.formulation.relative_score import relative_score


def gains(data, normalized, power):
    """The complex gains (r,) that minimize Σ |e|^power for data (r, n), by reweighted least squares."""
    factor = 1 / data if normalized == "measured" else data
    gain = np.ones(len(data), dtype=complex)
    for _ in range(30):
        # The minimum of a sum of absolute values may lie on a point, where the weight is infinite.
        weight = np.maximum(np.abs(gain[:, None] * factor - 1), 1e-12) ** (power - 2)
        gain = (weight * factor.conj()).sum(axis=1) / (weight * np.abs(factor) ** 2).sum(axis=1)
    return gain if normalized == "measured" else 1 / gain


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("normalized", ["measured", "model"])
def test_bias_and_errors_of_a_gain_are_those_of_many_data_sets(normalized, power):
    sigma, n = 0.2, 30
    rng = np.random.default_rng(2)
    draws = 1 + sigma * (rng.normal(size=(8000, n)) + 1j * rng.normal(size=(8000, n)))
    found = gains(draws, normalized, power)
    score = relative_score(sigma, n, power, normalized)
    assert 1 - np.exp(-np.log(np.abs(found)).mean()) == pytest.approx(
        score.gain_bias, abs=0.2 * sigma / np.sqrt(n)
    )
    errors = np.sqrt(score.variance / n) / score.curvature
    # The few data sets with a point next to zero take part in a standard deviation, not in an
    # interval.
    middle = [
        np.diff(np.quantile(part, [0.025, 0.975]))[0] / 3.92
        for part in (np.log(np.abs(found)), np.angle(found))
    ]
    assert errors == pytest.approx(middle, rel=0.15)


def test_small_noise_has_the_moments_of_the_linear_theory():
    for sigma in (1e-9, 1e-3):
        absolute, squared = (relative_score(sigma, 50, power, "measured") for power in (1, 2))
        assert absolute.curvature * sigma == pytest.approx(np.sqrt(np.pi / 2) / 2, rel=1e-3)
        assert absolute.variance == pytest.approx([0.5, 0.5], rel=1e-3)
        assert squared.curvature == pytest.approx(2, rel=1e-5)
        assert squared.variance / sigma**2 == pytest.approx([4, 4], rel=1e-4)
        assert squared.gain_bias / sigma**2 == pytest.approx(-2, rel=1e-4)


def test_the_size_of_the_noise_is_that_of_the_data_whatever_divides_the_errors():
    class Gain(gb.TransferFunction):
        K = gb.Parameter(1.0, bounds=(0.1, 10))

        def response(self, s, p):
            return p.K + 0 * s

    sigma = 0.2
    data = measured(Gain(), np.geomspace(0.1, 10, 4000), {"K": 2.0}, noise=sigma, seed=5)
    for criterion in (gb.RelativeError, gb.SquaredRelativeError):
        for normalized in ("measured", "model"):
            chosen = criterion(normalized=normalized)
            estimate = 2.0 / (1 - chosen.gain_bias(sigma, 100))
            assert chosen.noise(np.full(4000, estimate + 0j), data) == pytest.approx(
                sigma, rel=0.02
            )


@pytest.mark.parametrize(("points", "same"), [(2, 8), (1000, 100)])
def test_errors_are_those_that_one_of_so_many_points_may_have(points, same):
    """Between 8 and 100 of them: 2.4 and 3.3 standard deviations."""
    found, wanted, other = (relative_score(0.25, n, 1, "measured") for n in (points, same, 30))
    assert found.gain_bias == wanted.gain_bias
    assert found.gain_bias != pytest.approx(other.gain_bias, rel=1e-3)


def test_beyond_the_largest_noise_all_grows_as_small_noise_does_but_the_bias():
    at, above = (relative_score(sigma, 50, 2, "measured") for sigma in (0.3, 0.6))
    assert above.gain_bias == at.gain_bias
    assert above.curvature == at.curvature
    assert above.variance == pytest.approx(4 * at.variance)
    at, above = (relative_score(sigma, 50, 1, "measured") for sigma in (0.3, 0.6))
    assert above.curvature == pytest.approx(at.curvature / 2)
    assert above.variance == pytest.approx(at.variance)


@pytest.mark.parametrize(
    ("power", "rel"), [(1, 0.012), (2, 1e-3)]
)  # the first turns sharply about a measurement
@pytest.mark.parametrize("normalized", ["measured", "model"])
@pytest.mark.parametrize(("sigma", "n"), [(0.2, 30), (0.1, 12)])
def test_gain_curvature_and_variances_are_means_over_a_fine_grid_of_errors(
    sigma, n, normalized, power, rel
):
    """Gradients by differences, the gain by a search, over errors up to what one point in 2n exceeds."""
    edge = np.linspace(0, np.sqrt(2 * np.log(2 * n)), 401)
    radius, angle = (edge[1:] + edge[:-1]) / 2, 2 * np.pi * (np.arange(90) + 0.5) / 90
    share = np.exp(-(edge[:-1] ** 2) / 2) - np.exp(-(edge[1:] ** 2) / 2)
    share /= share.sum()
    # As large as all errors are in the mean: E|ε| = σ √(π/2), E|ε|² = 2 σ².
    radius *= (
        np.sqrt(np.pi / 2) / (share @ radius) if power == 1 else np.sqrt(2 / (share @ radius**2))
    )
    error = sigma * radius[:, None] * np.exp(1j * angle)

    def mean(values):
        return share @ values.mean(axis=1)

    def cost(gain, moved=0.0):
        """Of a model that is the truth times `gain`, by the logarithm `moved` away."""
        model = gain * np.exp(moved)
        return (
            np.abs((1 + error - model) / (1 + error if normalized == "measured" else model))
            ** power
        )

    def unlikely(moved):
        return np.abs((1 + error) / np.exp(moved) - 1) ** 2 / (2 * sigma**2) + 2 * np.real(moved)

    gain = minimize_scalar(
        lambda g: mean(cost(g)), bounds=(0.5, 1.5), method="bounded", options={"xatol": 1e-9}
    ).x
    slopes = [(cost(gain, d) - cost(gain, -d)) / 2e-5 for d in (1e-5, 1e-5j)]
    likely = [(unlikely(d) - unlikely(-d)) / 2e-5 for d in (1e-5, 1e-5j)]
    found = relative_score(sigma, n, power, normalized)
    assert found.gain_bias == pytest.approx(1 - 1 / gain, rel=rel)
    assert found.variance == pytest.approx([mean(slope**2) for slope in slopes], rel=rel)
    curvature = sum(mean(slope * other) for slope, other in zip(slopes, likely, strict=True)) / 2
    assert found.curvature == pytest.approx(curvature, rel=rel)
