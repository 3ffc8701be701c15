"""Experiments of few samples, as in kinetics: intervals that hold, and models called wrong.

python benchmarks/few_samples.py [draws]

A becomes B, which decays. One experiment begins from known values, and B is measured at all times,
at some or once; or there are batches of a few samples each, at other temperatures and from unknown
values. Errors are 0.02 of the first value, known to the fit or not. A fit whose intervals of 95 %
hold in fewer cases must speak: the last columns count those that say that the noise is to be given,
and those that call this right model wrong.
"""

import sys

import numpy as np

import greybox as gb

TRUTH = {"k1": 0.5, "k2": 0.2, "by_T": 0.3}  # 1/s, 1/s, 1/K
NOISE = 0.02
BOUNDS = (0.01, 10.0)


class Chain(gb.StateSpace):
    """A becomes B, which decays."""

    states = outputs = ("A", "B")
    inputs = ("T",)
    k1, k2 = (gb.Parameter(TRUTH[name], bounds=BOUNDS) for name in ("k1", "k2"))
    by_T = gb.Parameter(TRUTH["by_T"], bounds=(-2, 2))

    def derivative(self, x, u, p):
        """Return the rates."""
        flow = p.k1 * gb.exp(p.by_T * u.T) * x.A
        return (-flow, flow - p.k2 * x.B)

    def output(self, x, u, p):
        """Return both substances."""
        return (x.A, x.B)


def batch(random, samples, of_B, T=0.0, first=1.0):
    """Return a record of A, and of B at the last `of_B` of evenly chosen times."""
    time, k1, k2 = np.linspace(0, 8, samples), 0.5 * np.exp(0.3 * T), TRUTH["k2"]
    A = first * np.exp(-k1 * time)
    B = k1 / (k2 - k1) * (A - first * np.exp(-k2 * time))
    A, B = np.array([A, B]) + NOISE * random.normal(size=(2, samples))
    chosen = np.linspace(samples - 1, 0 if of_B == samples else samples // 2, of_B).astype(int)
    B[~np.isin(range(samples), chosen)] = np.nan
    return gb.Record(time, {"T": np.full(samples, T), "A": A, "B": B})


def row(name, draws, records, samples, of_B, known):
    """Print the coverage of one kind of experiment."""
    noise = {"noise": {"A": NOISE, "B": NOISE}} if known else {}
    hold, asked, wrong = [], 0, 0
    for seed in range(draws):
        random = np.random.default_rng([seed, records, samples, of_B])
        if records == 1:
            criterion = gb.OutputError(initial={"A": 1.0, "B": 0.0}, **noise)
            data = batch(random, samples, of_B)
            problem = gb.Problem(Chain(), data, criterion, fixed={"by_T": 0.3})
        else:
            data = [
                batch(random, samples, of_B, random.uniform(-1, 1), random.uniform(0.5, 2))
                for _ in range(records)
            ]
            problem = gb.several(Chain(), data, criterion=gb.OutputError(**noise))
        fit = gb.fit(problem, starts=2, progress=False)
        hold += [low <= TRUTH[name] <= high for name, (low, high) in fit.interval().items()]
        asked += any("so that intervals may be too narrow" in text for text in fit.warnings)
        wrong += fit.misfit is not None and not fit.misfit.explains
    given = "given" if known else "unknown"
    print(f"{name:<28}{given:<10}{np.mean(hold):6.2f}{asked:8d}{wrong:8d}  of {draws}", flush=True)


def main():
    """Print the table."""
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    print("experiment                  noise      hold   asked   wrong")
    for records, samples, of_B in (
        (1, 9, 9), (1, 9, 2), (1, 9, 1), (1, 30, 3), (3, 6, 6), (6, 5, 5), (20, 4, 4), (6, 8, 8),
    ):  # fmt: skip
        name = f"{records} x {samples} of A, {of_B} of B"
        for known in (True, False):
            row(name, draws, records, samples, of_B, known)


if __name__ == "__main__":
    main()
