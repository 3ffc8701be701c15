"""Coverage of the 95 % intervals from the Fourier integrals of short manoeuvres, with known truth.

Simulated by exact integration on a fine grid: one 8 s manoeuvre that ends while its input and its
states are moving; two manoeuvres of 8 and 6 s; two inputs and two outputs of different noise, which
may be correlated; and the first and the third with white noise in the differential equation
instead, for equation error. Trim values, which the fit does not know, are drawn anew each time. The
band is 0.5 to 10 rad/s.

    python benchmarks/transient_coverage.py [--runs 400]
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.linalg import expm

import greybox as gb

STEP = 0.02
FINE = 20  # steps of the simulation in a sample
BAND = (0.5, 10.0)


class ShortPeriod(gb.TransferFunction):
    """Pitch rate from the elevator: K (T_z s + 1) exp(-s T) / (s² + 2 ζ ω s + ω²)."""

    input, output = "u", "q"
    K = gb.Parameter(5.0, bounds=(0.0, 200.0), unit="1/s²", about="gain")
    T_z = gb.Parameter(1.0, bounds=(0.01, 20.0), unit="s", about="lead")
    w = gb.Parameter(2.0, bounds=(0.3, 20.0), unit="rad/s", about="frequency")
    z = gb.Parameter(0.5, bounds=(0.01, 3.0), about="damping")
    T = gb.Parameter(0.02, bounds=(0.0, 0.5), unit="s", about="delay")

    def response(self, s, p):
        """Return the response at s."""
        return p.K * (p.T_z * s + 1) / (s**2 + 2 * p.z * p.w * s + p.w**2) * gb.exp(-s * p.T)


class Lateral(gb.StateSpace):
    """Roll and yaw rate from aileron and rudder, coupled."""

    states = ("p", "r")
    inputs = ("da", "dr")
    outputs = ("roll", "yaw")
    Lp = gb.Parameter(-2.0, bounds=(-20, 5), unit="1/s", about="roll damping")
    Lr = gb.Parameter(0.5, bounds=(-10, 10), unit="1/s", about="roll due to yaw rate")
    Np = gb.Parameter(0.0, bounds=(-10, 10), unit="1/s", about="yaw due to roll rate")
    Nr = gb.Parameter(-1.0, bounds=(-20, 5), unit="1/s", about="yaw damping")
    La = gb.Parameter(5.0, bounds=(-100, 100), unit="1/s²", about="aileron")
    Nd = gb.Parameter(-2.0, bounds=(-100, 100), unit="1/s²", about="rudder")

    def derivative(self, x, u, p):
        """Return the accelerations."""
        return (p.Lp * x.p + p.Lr * x.r + p.La * u.da, p.Np * x.p + p.Nr * x.r + p.Nd * u.dr)

    def output(self, x, u, p):
        """Return the rates."""
        return (x.p, x.r)


SHORT_PERIOD = {"K": 8.0, "T_z": 0.7, "w": 3.0, "z": 0.45, "T": 0.06}
LATERAL = {"Lp": -3.0, "Lr": 0.8, "Np": -0.4, "Nr": -0.9, "La": 9.0, "Nd": -3.0}


def pulses(*edges: float, size: float = 0.1) -> Callable:
    """Return an input that changes its sign at the edges, s, and has a step shortly before 8 s."""

    def at(t):
        sign = (-1.0) ** np.searchsorted(edges, t + 1e-9, side="right")
        active = (t + 1e-9 >= edges[0]) & (t + 1e-9 < edges[-1])
        return -size * sign * active + 0.3 * size * (t > 7.6)

    return at


def simulated(a, b, c, inputs, delay, duration, start):
    """Return times (n,), held inputs (m, n) and outputs (k, n) of the linear system."""
    t = np.arange(round(duration / STEP) + 1) * STEP
    fine = np.arange((len(t) - 1) * FINE + 1) * STEP / FINE
    order, number = len(a), len(inputs)
    blocks = np.block([[a, b], [np.zeros((number, order + number))]])
    one = expm(blocks * STEP / FINE)
    held = np.array([u(np.floor((fine - delay) / STEP + 1e-6) * STEP) for u in inputs])
    x, outputs = np.array(start, dtype=float), []
    for k in range(len(fine)):
        if k % FINE == 0:
            outputs.append(c @ x)
        x = one[:order, :order] @ x + one[:order, order:] @ held[:, k]
    return t, np.array([u(t) for u in inputs]), np.array(outputs).T


def short_period_record(duration, edges, start):
    """Return a manoeuvre of the short period without noise and trim."""
    p = SHORT_PERIOD
    a = np.array([[0.0, 1.0], [-(p["w"] ** 2), -2 * p["z"] * p["w"]]])
    b, c = np.array([[0.0], [1.0]]), np.array([[p["K"], p["K"] * p["T_z"]]])
    t, u, y = simulated(a, b, c, [pulses(*edges)], p["T"], duration, start)
    return gb.Record(t, {"u": u[0], "q": y[0]}, hold={"u": np.inf})


def lateral_record():
    """Return a manoeuvre with a doublet of the ailerons and then one of the rudder."""
    p = LATERAL
    a, b = np.array([[p["Lp"], p["Lr"]], [p["Np"], p["Nr"]]]), np.diag([p["La"], p["Nd"]])
    inputs = [pulses(0.5, 1.1, 1.7), pulses(3.0, 4.0, 5.0)]
    t, u, y = simulated(a, b, np.eye(2), inputs, 0.0, 8.0, [0.02, -0.05])
    return gb.Record(
        t, {"da": u[0], "dr": u[1], "roll": y[0], "yaw": y[1]}, hold={"da": np.inf, "dr": np.inf}
    )


def measured(record, noise, random):
    """Return the record with noise on its outputs and a trim value on every signal."""
    changed = {name: x + random.normal() for name, x in record.signals.items()}
    for name, size in noise.items():
        changed[name] = changed[name] + size * random.standard_normal(len(record))
    return record.with_signals(**changed)


def disturbed(record, a, noise, random):
    """Return the record with white noise in x' = A x + e added to outputs that are states."""
    one = expm(a * STEP / FINE)
    size = np.array([*noise.values()]) * np.sqrt(FINE)
    x, rows = np.zeros(len(a)), []
    for k, e in enumerate(random.standard_normal((len(record) * FINE, len(a))) * size):
        if k % FINE == 0:
            rows.append(x)
        x = one @ (x + e * STEP / FINE)
    shifted = {name: x + random.normal() for name, x in record.signals.items()}
    outputs = {
        n: shifted[n] + y for n, y in zip(noise, np.array(rows).T, strict=True) if n in shifted
    }
    return record.with_signals(**shifted | outputs)


def short_period_in_turbulence(record, random):
    """Return the record with white noise in the equation of second order, and a trim value."""
    p = SHORT_PERIOD
    a = np.array([[0.0, 1.0], [-(p["w"] ** 2), -2 * p["z"] * p["w"]]])
    return disturbed(record, a, {"q": 0.0, "rate of q": 0.3}, random)


def short_period_in_gusts(record, random, time, share):
    """Return the record with first-order gusts in the equation, a share of the rms of the output.

    Their time constant is `time` s: Dryden's spectrum along the flight path.
    """
    p = SHORT_PERIOD
    a = np.array([[0.0, 1.0, 0.0], [-(p["w"] ** 2), -2 * p["z"] * p["w"], 1.0], [0, 0, -1 / time]])
    nothing, noise = np.zeros(len(record)), {"q": 0.0, "rate of q": 0.0, "gust": 1.0}
    # They blew before the record.
    calm = gb.Record(np.arange(5 * len(record)) * STEP, {"q": np.tile(nothing, 5)})
    pushed = disturbed(calm, a, noise, random)["q"][-len(record) :]
    size = share * np.std(record["q"]) / np.std(pushed)
    shifted = {name: x + random.normal() for name, x in record.signals.items()}
    noisy = shifted["q"] + size * pushed + 0.002 * random.standard_normal(len(record))
    return record.with_signals(**shifted | {"q": noisy})


def lateral_in_turbulence(record, random):
    """Return the record with white noise in both equations, and trim values."""
    p = LATERAL
    a = np.array([[p["Lp"], p["Lr"]], [p["Np"], p["Nr"]]])
    return disturbed(record, a, {"roll": 0.1, "yaw": 0.05}, random)


def louder(record, random):
    """Return the record with ten times the noise until 2.5 s, and trim values."""
    size = np.where(record.time < 2.5, 1.0, 0.1)
    return measured(record, {"roll": 0.05 * size, "yaw": 0.0125 * size}, random)


def correlated(record, random):
    """Return the record with correlated noise on its outputs, and trim values."""
    shared = random.standard_normal(len(record))
    return measured(
        record.with_signals(
            roll=record["roll"] + 0.02 * shared, yaw=record["yaw"] + 0.005 * shared
        ),
        {"roll": 0.01, "yaw": 0.0025},
        random,
    )


def cases():
    """Return name -> (model, truth, clean records, measurement, inputs, outputs, criterion)."""
    first = short_period_record(8.0, (1.0, 2.0, 2.5, 3.0), [0.005, 0.01])
    second = short_period_record(6.0, (0.5, 1.2, 1.9), [0.0, 0.0])
    lateral = lateral_record()
    by_output, by_equation = gb.OutputError(), gb.EquationError()

    def noisy(**noise):
        return lambda record, random: measured(record, noise, random)

    one, two = (
        (ShortPeriod(), SHORT_PERIOD, [first]),
        (ShortPeriod(), SHORT_PERIOD, [first, second]),
    )
    edges = [(0.2, 0.9, 1.3), (0.5, 1.2, 1.9), (0.3, 1.6), (0.4, 0.8, 1.2, 2.4)]
    short = [short_period_record(4.0, each, [0.0, 0.01]) for each in edges]
    four = (ShortPeriod(), SHORT_PERIOD, short)
    both = (Lateral(), LATERAL, [lateral])
    pair = (["da", "dr"], ["roll", "yaw"])
    gusts = {
        f"gusts of {time:g} s, {share:.0%}, {name}": (
            *one,
            lambda record, random, t=time, s=share: short_period_in_gusts(record, random, t, s),
            ["u"],
            ["q"],
            rule,
        )
        for time in (0.3, 3.0)
        for share in (0.1, 0.3)
        for name, rule in (
            ("output error", by_output),
            ("equation error", by_equation),
            ("equation error with gusts", gb.EquationError(gusts=True)),
        )
    }
    return {
        **gusts,
        "one 2-1-1 of 8 s": (*one, noisy(q=0.02), ["u"], ["q"], by_output),
        "2-1-1 and doublet": (*two, noisy(q=0.02), ["u"], ["q"], by_output),
        "four of 4 s, six lines each": (*four, noisy(q=0.02), ["u"], ["q"], by_output),
        "two inputs, two outputs": (*both, noisy(roll=0.02, yaw=0.005), *pair, by_output),
        "noise louder at the beginning": (*both, louder, *pair, by_output),
        "correlated noise": (*both, correlated, *pair, by_output),
        "correlated noise, full covariance": (
            *both,
            correlated,
            *pair,
            gb.OutputError(noise="full"),
        ),
        "turbulence, equation error": (*one, short_period_in_turbulence, ["u"], ["q"], by_equation),
        "turbulence, equation error of two outputs": (
            *both,
            lateral_in_turbulence,
            *pair,
            by_equation,
        ),
    }


def coverage(case, runs, seed):
    """Return the coverage by parameter, the rms of the standardized errors, and counts of fits."""
    model, truth, records, measure, inputs, outputs, criterion = case
    random = np.random.default_rng(seed)
    names = list(truth)
    inside, standardized, named, honest = [], [], 0, 0
    for _ in range(runs):
        spectra = [
            gb.spectral.transient_spectrum(measure(r, random), inputs, outputs, BAND)
            for r in records
        ]
        fit = gb.fit(
            sum(gb.Problem(model, spectrum, criterion) for spectrum in spectra),
            starts=1,
            progress=False,
        )
        words = ("correlated", "turbulence", "poorly", "mislead")
        speaks = any(word in text for word in words for text in (*fit.warnings, *fit.notes))
        named += speaks
        wide = fit.interval(1 - 0.05 / len(names))
        honest += speaks or all(wide[n][0] <= truth[n] <= wide[n][1] for n in names)
        interval = fit.interval()
        # Where the standard error misleads.
        interval |= {p.name: p.interval for p in (fit.profiles.profiles if fit.profiles else ())}
        inside.append([interval[n][0] <= truth[n] <= interval[n][1] for n in names])
        standardized.append([(fit.estimate[n] - truth[n]) / fit.standard_error[n] for n in names])
    rms = np.sqrt(np.nanmean(np.square(standardized), axis=0))
    counts = len(inside), named, honest
    return dict(zip(names, np.mean(inside, axis=0), strict=True)), rms, counts


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--only", default="", help="cases with this in their name")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    runs = options.runs
    for name, case in cases().items():
        if options.only not in name:
            continue
        began = time.perf_counter()
        shares, rms, (given, named, honest) = coverage(case, runs, seed=options.seed)
        print(f"{name}: {runs} runs, {1e3 * (time.perf_counter() - began) / runs:.0f} ms each")
        for (parameter, share), size in zip(shares.items(), rms, strict=True):
            print(
                f"  {parameter:4s} coverage {100 * share:5.1f} %   rms of standardized errors "
                f"{size:.2f}"
            )
        mean = f"coverage {100 * np.mean(list(shares.values())):5.1f} %" if shares else "none"
        print(
            f"  all  {mean}, intervals in {given}, warned in {named}, all parameters hold "
            f"(Bonferroni) or warned in {honest}",
            flush=True,
        )


if __name__ == "__main__":
    main()
