"""Whether gains that `greybox.safe_gains` allows meet the requirements in truth.

python benchmarks/safe_gains.py [--flights 20] [--gains K_P K_I] [--output FILE]

Plants of known truth are flown as in margin_coverage.py, with usual and with strong gusts and
noise. From each flight: response, fit, safe gains. Of the allowed sets of gains, ten at random and
ten at the edge (a neighbor is not allowed) are held against the true loop, and of the other sets
thirty, to count those that the true loop does not tolerate. The loop of the true plant with the
allowed gains of the smallest response to a step moment has the true margins, which the
intervals predicted for these gains should hold.
Printed: how many allowed sets violate a requirement in truth, how many unsafe sets are allowed, and
how many predicted margins hold the true ones.
"""

import argparse
from pathlib import Path

import numpy as np
from margin_coverage import PLANTS, Rate, RateLoop
from scipy.ndimage import binary_erosion

import greybox as gb

PHASE_MARGIN, GAIN_MARGIN = 45.0, 6.0
SPREAD = 8.0  # gains are tried from a small to a large multiple of those that flew
NOISES = {"usual": (0.01, 0.02), "strong": (0.3, 2.0)}  # of the gyro, of the gusts
EACH = 10
PREDICTED = (
    "phase margin",
    "gain margin",
    "delay margin",
    "modulus margin",
    "crossover",
    "disturbance rejection bandwidth",
)


def flown(values, gains, rate, band, noise, seed):
    """Return the record of a sweep of 60 s, added to the setpoint."""
    test = gb.experiment.sweep(*band, 60.0, rate, amplitude=0.3, signal="reference")
    gyro, gust = NOISES[noise]
    return gb.virtual_flight(
        Rate(),
        values,
        test,
        controller=RateLoop(gains, rate=rate),
        noise={"q": gyro},
        process_noise={"q": gust},
        seed=seed,
    )


def tolerated(values, gains, rate):
    """Return whether the true loop meets the requirements."""
    truth = gb.margins(Rate(), RateLoop(gains, rate=rate), values)
    return truth.is_stable and (
        truth["phase margin"].value >= PHASE_MARGIN
        and truth["gain margin"].value >= GAIN_MARGIN
        and truth["gain reduction margin"].value >= GAIN_MARGIN
    )


def edge(allowed):
    """Return which allowed sets have a neighbor that is not."""
    return allowed & ~binary_erosion(allowed, border_value=1)


def calmest(safe):
    """Return the allowed gains with the smallest response to a step moment."""
    places = np.unravel_index(
        np.where(safe.allowed, safe.objective, np.inf).argmin(), safe.allowed.shape
    )
    return {n: float(v[i]) for (n, v), i in zip(safe.values.items(), places, strict=True)}


def predicted(fit, gains, values, rate):
    """Return how many margins at these gains are in their intervals, and how many there are."""
    law = RateLoop(gains, rate=rate)
    answer, truth = gb.margins(fit, law), gb.margins(Rate(), law, values)
    rows = [(answer[name], truth[name].value) for name in PREDICTED]
    return sum(row.low <= value <= row.high for row, value in rows), len(rows)


def judged(plant, noise, seed, names):
    """Return the counts (wrong, tried) of sets inside, at the edge, and of unsafe ones allowed.

    The last count is that of margins at the calmest gains outside their predicted intervals.
    """
    values, gains, rate, band = PLANTS[plant]
    record = flown(values, gains, rate, band, noise, seed)
    ranges = {name: (gains[name] / SPREAD, gains[name] * SPREAD) for name in names}
    try:
        response = gb.spectral.spectral_response(
            record, "u", "q", instrument="reference", band=band
        )
        fit = gb.fit(gb.Problem(Rate(), response, gb.MaximumLikelihood()), starts=3, progress=False)
        safe = gb.safe_gains(
            fit,
            RateLoop(gains, rate=rate),
            ranges,
            phase_margin=PHASE_MARGIN,
            gain_margin=GAIN_MARGIN,
        )
    except ValueError as error:  # no response or no covariance: nothing is allowed
        return np.zeros((4, 2), dtype=int), str(error)

    rng = np.random.default_rng(seed)
    allowed = safe.allowed
    counts = np.zeros((4, 2), dtype=int)
    if allowed.any():
        inside, tried = predicted(fit, {**gains, **calmest(safe)}, values, rate)
        counts[3] = tried - inside, tried
    for k, choice in enumerate((allowed, edge(allowed), ~allowed)):
        places = np.argwhere(choice)
        for place in rng.permutation(places)[: EACH if k < 2 else 3 * EACH]:
            row = {n: v[i] for (n, v), i in zip(safe.values.items(), place, strict=True)}
            row = {**gains, **row}
            is_safe = tolerated(values, row, rate)
            if k < 2:
                counts[k] += (not is_safe, 1)
            elif not is_safe:
                counts[2] += (0, 1)
    # Unsafe sets that were allowed are the wrong ones above.
    counts[2, 0] = counts[0, 0] + counts[1, 0]
    counts[2, 1] += counts[2, 0]
    return counts, safe.verdict


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--gains", nargs="+", default=["K_P", "K_I"])
    parser.add_argument("--noise", nargs="+", default=[*NOISES])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    lines = [
        f"{options.flights} flights a cell; violations in truth of allowed sets (at random, at the "
        "edge), unsafe sets that are allowed, margins outside the intervals predicted for the "
        "gains of the smallest response to a moment"
    ]
    print(lines[0], flush=True)
    for noise in options.noise:
        total = np.zeros((4, 2), dtype=int)
        for plant in PLANTS:
            counts = np.zeros((4, 2), dtype=int)
            for seed in range(options.flights):
                more, verdict = judged(plant, noise, seed, options.gains)
                counts += more
            total += counts
            cells = [f"{wrong} of {tried}" for wrong, tried in counts]
            lines.append(f"{noise} noise, {plant}: {', '.join(cells)}; last: {verdict[:60]}")
            print(lines[-1], flush=True)
        lines.append(f"{noise} noise, all: {', '.join(f'{w} of {t}' for w, t in total)}")
        print(lines[-1], flush=True)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
