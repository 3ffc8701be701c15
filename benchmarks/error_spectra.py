"""Standard errors of records by an average of spectra, and by three shorter ways.

python benchmarks/error_spectra.py [--repeats 100] [--samples 300] [--output FILE]

The linear experiments of `correlated_errors.py`, with one and with two outputs. Every fit has four
95 % intervals of each parameter: by the average of spectra that greybox prints; as if the errors
were white; by an autoregression for each output, chosen by AIC, in a sandwich; and by the weighted
autocovariances of the scores (Newey and West, Econometrica 55, 1987; Bartlett's window of 1.3 √n
lags). The last three have n k - p degrees of freedom. The share of intervals that contain the truth
is printed, of all parameters together.
"""

import argparse
import math
from datetime import date
from pathlib import Path

import numpy as np
from correlated_errors import ERRORS, PLANTS, cell, fits, without
from scipy.linalg import solve_toeplitz, toeplitz
from scipy.stats import t as student

import greybox as gb

ORDERS = 21  # of autoregressions, from zero


def autoregressive(residuals):
    """Return the autocovariances of the autoregression with the lowest AIC."""
    n = residuals.size
    measured = np.array([residuals[: n - lag] @ residuals[lag:] for lag in range(ORDERS)]) / n
    best, chosen = math.inf, np.zeros(0)
    for order in range(ORDERS):
        factors = solve_toeplitz(measured[:order], measured[1 : order + 1]) if order else chosen
        variance = measured[0] - factors @ measured[1 : order + 1]
        criterion = n * math.log(variance) + 2 * order
        if criterion < best:
            best, chosen = criterion, factors
    order = len(chosen)
    covariances = [*measured[: order + 1]]
    while len(covariances) < n:
        past = covariances[: -order - 1 : -1]
        covariances.append(chosen @ past if order else 0.0)
    return np.array(covariances)


def meats(sensitivity, residuals):
    """Return the covariance of the scores by each of the shorter ways."""
    outputs = range(len(residuals))
    by_lag = sum(
        sensitivity[k] @ toeplitz(autoregressive(residuals[k])) @ sensitivity[k].T for k in outputs
    )
    scores = np.einsum("kpn,kn->pn", sensitivity, residuals)
    lags = int(1.3 * math.sqrt(scores.shape[1]))
    weighted = scores @ scores.T
    for lag in range(1, lags + 1):
        product = scores[:, lag:] @ scores[:, :-lag].T
        weighted += (1 - lag / (lags + 1)) * (product + product.T)
    white = np.einsum("kpn,kqn->pq", sensitivity, sensitivity)
    return {"white": white, "autoregression": by_lag, "Newey and West": weighted}


def coverage(plant, errors, samples, repeats, seed):
    """Return the share of intervals that contain the truth, by way."""
    holds = {}
    for error, residuals, by_parameter, by_state in fits(plant, errors, samples, repeats, seed):
        size = np.sqrt(np.mean(residuals**2, axis=1))[:, None, None]
        sensitivity = without(by_parameter / size, by_state / size)
        inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", sensitivity, sensitivity))
        degrees = residuals.size - by_parameter.shape[1] - by_state.shape[1]
        factor = student.ppf(0.975, degrees) * math.sqrt(residuals.size / degrees)
        for way, meat in meats(sensitivity, residuals / size[..., 0]).items():
            variance = np.maximum(np.diag(inverse @ meat @ inverse), 0.0)
            holds.setdefault(way, []).append(np.abs(error) < factor * np.sqrt(variance))
    printed = {"greybox": cell(plant, errors, samples, repeats, seed).holds, **holds}
    return {way: np.mean(values) for way, values in printed.items()}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--samples", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"error_spectra.py, {date.today()}, greybox {gb.__version__}, numpy {np.__version__}; "
        f"{options.repeats} records of {options.samples} samples, seed {options.seed}",
        "",
        "Share of 95 % intervals that contain the truth, %",
    ]
    print("\n".join(lines), flush=True)
    for plant in (plant for plant in PLANTS if plant.name in ("lag, 1 output", "spring, 2")):
        for errors in ERRORS:
            shares = coverage(plant, errors, options.samples, options.repeats, options.seed)
            words = "  ".join(f"{way} {100 * share:5.1f}" for way, share in shares.items())
            lines.append(f"{plant.name:14} {errors.name:10}  {words}")
            print(lines[-1], flush=True)
    if options.output is not None:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
