"""Joint fits of records with unlike errors: intervals, and what the weights of the note gain.

python benchmarks/joint_weights.py [draws]

Records of an airplane's short period have errors that are white, or an autoregression of first
order. The likelihood weights both as if they were white. Fits with a note are repeated with its
weights. The columns are the coverage of intervals of 95 %, of all fits and of the repeated ones
(those without a note remain), the number of fits with a note, and for these the ratio of standard
errors and of actual errors, and the number of notes after the repetition.
"""

import re
import sys

import numpy as np
from scipy.signal import lfilter

import greybox as gb

STEP = 0.05  # s
TRUTH = {"Z": -1.7, "M_alpha": -9.0, "M_q": -2.1, "M_de": -14.0}


class ShortPeriod(gb.StateSpace):
    """Angle of attack and pitch rate of an airplane."""

    states = outputs = ("alpha", "q")
    inputs = ("de",)
    Z = gb.Parameter(-1.0, bounds=(-10, 1))
    M_alpha = gb.Parameter(-5.0, bounds=(-80, 20))
    M_q = gb.Parameter(-1.0, bounds=(-15, 3))
    M_de = gb.Parameter(-8.0, bounds=(-90, 0))

    def derivative(self, x, u, p):
        """Return the derivative."""
        return (p.Z * x.alpha + x.q, p.M_alpha * x.alpha + p.M_q * x.q + p.M_de * u.de)

    def output(self, x, u, p):
        """Return the states."""
        return (x.alpha, x.q)


def problem(random, name, samples, color, size):
    """Return a record with errors of an autoregression with this coefficient."""
    command = 0.1 * np.repeat(random.choice([-1.0, -0.5, 0.0, 0.5, 1.0], samples // 7 + 1), 7)
    flight = gb.Record(STEP * np.arange(samples), {"de": command[:samples]}, hold={"de": np.inf})
    flown = gb.simulate(ShortPeriod(), TRUTH, flight)
    white = random.normal(size=(2, samples + 300))
    errors = (1 - color**2) ** 0.5 * lfilter([1], [1, -color], white)[:, 300:]
    outputs = {
        output: flown[output] + size * 0.05 * flown[output].std() * e
        for output, e in zip(ShortPeriod.outputs, errors, strict=True)
    }
    return gb.Problem(ShortPeriod(), flight.with_signals(**outputs), name=name)


def notes(fit):
    """Return the weights that a fit names, by record."""
    (text,) = [note for note in fit.notes if "weight=" in note] or [""]
    return {name: float(share) for share, name in re.findall(r"([\d.e-]+) for '(\w+)'", text)}


def row(name, draws, records):
    """Print the results of one kind of sum."""
    holds, errors, repeated = [], [], 0
    for seed in range(draws):
        random = np.random.default_rng([seed, len(name), len(records)])
        parts = [problem(random, f"r{k}", *record) for k, record in enumerate(records)]
        first = gb.fit(sum(parts), [{}], progress=False)
        weights = notes(first)
        again = [part.with_(weight=weights.get(part.name, 1.0)) for part in parts]
        better = gb.fit(sum(again), [{}], progress=False) if weights else first
        for fit in (first, better):
            interval = fit.interval()
            holds.append([low <= TRUTH[n] <= high for n, (low, high) in interval.items()])
        if weights:
            repeated += bool(notes(better))
            for n, value in TRUTH.items():
                sizes = [fit.standard_error[n] for fit in (first, better)]
                actual = [fit.estimate[n] - value for fit in (first, better)]
                errors.append([*sizes, *actual])
    hold = np.reshape(holds, (draws, 2, -1)).mean(axis=(0, 2))
    text = "       -       -"
    if errors:
        sizes = np.array(errors) / np.array(errors)[:, :1]
        rms = np.sqrt((sizes**2).mean(axis=0))
        text = f"{1 / rms[1]:8.2f}{rms[2] / rms[3]:8.2f}"
    count = len(errors) // len(TRUTH)
    print(f"{name:<44}{hold[0]:7.3f}{hold[1]:9.3f}{count:7d}{text}{repeated:7d}  of {draws}")


def main():
    """Print the table."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    print(f"{'records: samples (correlation)':<44}   hold repeated  notes  errors  actual again")
    for records in (
        ((80, 0.0, 1), (80, 0.0, 1), (80, 0.0, 1)),
        ((60, 0.0, 1), (100, 0.0, 3), (300, 0.0, 1), (60, 0.0, 0.5)),
        ((80, 0.0, 1), (600, 0.95, 1)),
        ((400, 0.0, 1), (100, 0.9, 1)),
        ((400, 0.0, 2), (400, 0.9, 1)),
        ((80, 0.0, 1), (120, 0.0, 2), (300, 0.9, 1), (300, 0.97, 1)),
        ((300, 0.8, 1), (300, 0.97, 1)),
    ):  # fmt: skip
        row(", ".join(f"{n} ({color:g})" for n, color, _ in records), draws, records)


if __name__ == "__main__":
    main()
