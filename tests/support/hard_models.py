"""Problems of records that were hard to solve at some time, with the truth where there is one.

Every function returns a problem; what the solver does to it is held by tests and measured by
`benchmarks/ablation.py`.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from spring_lag_tilt import HELD, SPRING, TILT, FullTilt, Lag, Spring, lag, steps, tilt_flight
from stiff_lag import StiffLag

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.tilt import NonlinearTilt

ROTOR = {name: TILT[name] for name in ("T_rotor", "T_delay")}
WIND = gb.PredictionError(inputs="held")


def simulated(derivative, first, time, held, **options):
    """Integrate derivative(x, *inputs) with inputs (m, n) held from sample to sample, to ten
    digits."""
    states = [np.array(first, dtype=float)]
    for k in range(time.size - 1):
        inputs = [values[k] for values in held]
        step = solve_ivp(
            lambda _, x, inputs=inputs: derivative(x, *inputs),
            (time[k], time[k + 1]),
            states[-1],
            method="LSODA",
            rtol=1e-9,
            atol=1e-10,
            **options,
        )
        states.append(step.y[:, -1])
    return np.array(states).T


def levels(random, n, hold, low, high):
    """Return random levels (n,), each held for so many samples."""
    return np.repeat(random.uniform(low, high, size=-(-n // hold)), hold)[:n]


# --- roots of levels that a start drains


class Tanks(gb.StateSpace):
    """Two tanks, the lower one measured; a start with wide drains empties them."""

    states, inputs, outputs = ("h1", "h2"), ("V",), ("h2",)
    k = gb.Parameter(0.005, bounds=(1e-4, 0.1), scale="log")
    a1 = gb.Parameter(0.02, bounds=(1e-3, 0.2), scale="log")
    a2 = gb.Parameter(0.02, bounds=(1e-3, 0.2), scale="log")

    def root(self, level):
        return gb.sqrt(19.62 * level)

    def derivative(self, x, u, p):
        through = p.a1 * self.root(x.h1)
        return ((p.k * u.V - through) / 0.5, (through - p.a2 * self.root(x.h2)) / 0.25)

    def output(self, x, u, p):
        return (x.h2,)


class GuardedTanks(Tanks):
    """The slope of a guarded root is 0 · inf where the tank is empty."""

    def root(self, level):
        return gb.sqrt(19.62 * gb.maximum(level, 0))


TANKS = {"k": 0.0035, "a1": 0.019, "a2": 0.0136}


def tanks(model=Tanks, n=400):
    random = np.random.default_rng(0)
    time, V = 2.0 * np.arange(n), levels(random, n, 50, 3, 10)

    def derivative(x, V):
        through = 0.019 * np.sqrt(19.62 * max(x[0], 0))
        return [
            (0.0035 * V - through) / 0.5,
            (through - 0.0136 * np.sqrt(19.62 * max(x[1], 0))) / 0.25,
        ]

    x = simulated(derivative, [0.2, 0.3], time, [V])
    record = gb.Record(time, {"V": V, "h2": x[1] + 0.003 * random.normal(size=n)})
    return gb.Problem(model(), record, HELD)


# --- a reactor that ignites


class Reactor(gb.StateSpace):
    """A stirred tank with Arrhenius kinetics: its rate changes a thousandfold along the record."""

    states, inputs, outputs = ("C", "T"), ("Tc",), ("C", "T")
    k350 = gb.Parameter(0.5, bounds=(0.01, 20), unit="1/min", scale="log")
    E = gb.Parameter(9000.0, bounds=(2000, 20000), unit="K")
    H = gb.Parameter(100.0, bounds=(-500, 1000), unit="K·L/mol")
    UA = gb.Parameter(1.0, bounds=(0.1, 20), scale="log")

    def derivative(self, x, u, p):
        rate = p.k350 * gb.exp(-p.E * (1 / x.T - 1 / 350)) * x.C
        return (1 - x.C - rate, 350 - x.T + p.H * rate + p.UA * (u.Tc - x.T))

    def output(self, x, u, p):
        return (x.C, x.T)


REACTOR = {"k350": 1.0, "E": 8750.0, "H": 209.0, "UA": 2.09}


def reactor():
    random, n = np.random.default_rng(0), 150
    time, Tc = 0.1 * np.arange(n), levels(random, n, 25, 290, 310)

    def derivative(x, Tc):
        rate = np.exp(-8750 * (1 / x[1] - 1 / 350)) * x[0]
        return [1 - x[0] - rate, 350 - x[1] + 209 * rate + 2.09 * (Tc - x[1])]

    C, T = simulated(derivative, [0.8, 330.0], time, [Tc])
    assert np.ptp(T) > 100
    signals = {
        "Tc": Tc,
        "C": C + 0.005 * random.normal(size=n),
        "T": T + 0.3 * random.normal(size=n),
    }
    return gb.Problem(Reactor(), gb.Record(time, signals), HELD)


# --- states that no output shows


class Chain(gb.StateSpace):
    """Six lags with a cubic loss; the third and the last are measured."""

    states, inputs, outputs = tuple(f"x{k}" for k in range(6)), ("u",), ("middle", "end")
    k = gb.Parameter(5.0, bounds=(0.5, 50), unit="1/s", scale="log")
    b = gb.Parameter(1.0, bounds=(-10, 10))
    d = gb.Parameter(1.0, bounds=(0, 10))

    def derivative(self, x, u, p):
        v = [getattr(x, name) for name in self.states]
        return (
            p.b * u.u - p.k * v[0] - p.d * v[0] ** 3,
            *(p.k * (v[i - 1] - v[i]) for i in range(1, 6)),
        )

    def output(self, x, u, p):
        return (x.x2, x.x5)


CHAIN = {"k": 8.0, "b": 2.0, "d": 1.5}


def chain(n=1000):
    random = np.random.default_rng(3)
    u = 3 * np.repeat(random.normal(size=n // 10), 10)
    record = gb.Record(0.02 * np.arange(n), {"u": u})
    clean = gb.simulate(Chain(), CHAIN, record, inputs="held")
    noisy = {name: clean[name] + 0.005 * random.normal(size=n) for name in ("middle", "end")}
    return gb.Problem(Chain(), record.with_signals(**noisy), HELD)


class Unseen(gb.StateSpace):
    """Nothing measured depends on the second state."""

    states, inputs, outputs = ("x", "h"), ("u",), ("x", "h")
    a = gb.Parameter(2.0, bounds=(0.1, 20))
    b = gb.Parameter(1.0, bounds=(-10, 10))
    c = gb.Parameter(1.0, bounds=(0.1, 20))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.a * x.x, x.x - p.c * x.h)

    def output(self, x, u, p):
        return (x.x, x.h)


def unseen():
    random, n = np.random.default_rng(0), 400
    record = gb.Record(0.05 * np.arange(n), {"u": np.repeat(random.normal(size=n // 10), 10)})
    x = gb.simulate(Unseen(), {"a": 3.0, "b": 2.0, "c": 1.0}, record, inputs="held")["x"]
    record = record.with_signals(x=x + 0.05 * random.normal(size=n))
    return gb.Problem(Unseen(), record, HELD)


# --- a limit that the level reaches at times


class Overflow(gb.StateSpace):
    """The level stops at one.

    Only this limit determines the inflow, since the gain of the sensor is unknown.
    """

    states, inputs, outputs = ("h",), ("u",), ("y",)
    k = gb.Parameter(0.1, bounds=(0.01, 5), scale="log")
    c = gb.Parameter(0.5, bounds=(0.05, 5), scale="log")
    g = gb.Parameter(1.0, bounds=(0.05, 20), scale="log")

    def derivative(self, x, u, p):
        rate = p.k * u.u - p.c * x.h
        return (gb.where(x.h >= 1, gb.minimum(rate, 0), rate),)

    def output(self, x, u, p):
        return (p.g * x.h,)


def overflow():
    random, n = np.random.default_rng(0), 600
    u = levels(random, n, 20, 0, 1.3)
    x, y = 0.3, []
    for k in range(n):
        y.append(3.0 * x + 0.01 * random.normal())
        for _ in range(50):
            rate = 0.8 * u[k] - 0.6 * x
            x += 0.1 / 50 * (min(rate, 0) if x >= 1 else rate)
    assert 0.03 < np.mean(np.array(y) > 2.97) < 0.5
    return gb.Problem(Overflow(), gb.Record(0.1 * np.arange(n), {"u": u, "y": y}), HELD)


# --- residuals that are far from noise


class TooSimple(gb.StateSpace):
    """One lag for two outputs that follow different ones."""

    states, inputs, outputs = ("x", "y"), ("u",), ("x", "y")
    a = gb.Parameter(1.0, bounds=(0.05, 20), scale="log")
    b = gb.Parameter(1.0, bounds=(-10, 10))
    c = gb.Parameter(0.5, bounds=(-10, 10))

    def derivative(self, x, u, p):
        return (p.b * u.u - p.a * x.x, p.c * x.x - p.a * x.y)

    def output(self, x, u, p):
        return (x.x, x.y)


def too_simple(noise="diagonal"):
    random, n = np.random.default_rng(0), 300
    time, u = 0.1 * np.arange(n), levels(random, n, 15, -1, 1)
    x = simulated(
        lambda x, u: [u - 0.4 * x[0], 2.0 * x[0] - 3.0 * x[1] + x[1] ** 2], [0, 0], time, [u]
    )
    record = gb.Record(time, {"u": u, "x": x[0] + 0.01 * random.normal(size=n), "y": x[1]})
    return gb.Problem(TooSimple(), record, gb.OutputError(inputs="held", noise=noise))


# --- free motions, sampled sparsely


def free_motion(derivative, first, time):
    """Return states (n, samples) by SciPy, which shares nothing with the code under test."""
    return solve_ivp(
        derivative, (time[0], time[-1]), first, t_eval=time, rtol=1e-10, atol=1e-12, max_step=0.1
    ).y


class LotkaVolterra(gb.StateSpace):
    """Hares and lynxes, sampled once a year; no input."""

    states = outputs = ("H", "L")
    inputs = ()
    a = gb.Parameter(0.5, bounds=(0.05, 5), scale="log")
    b = gb.Parameter(0.02, bounds=(0.001, 0.2), scale="log")
    c = gb.Parameter(0.5, bounds=(0.05, 5), scale="log")
    d = gb.Parameter(0.02, bounds=(0.001, 0.2), scale="log")

    def derivative(self, x, u, p):
        return (p.a * x.H - p.b * x.H * x.L, p.d * x.H * x.L - p.c * x.L)

    def output(self, x, u, p):
        return (x.H, x.L)


LOTKA_VOLTERRA = {"a": 0.55, "b": 0.028, "c": 0.84, "d": 0.026}


def lotka_volterra():
    time = np.arange(21.0)
    x = free_motion(
        lambda t, x: [0.55 * x[0] - 0.028 * x[0] * x[1], 0.026 * x[0] * x[1] - 0.84 * x[1]],
        [33, 6],
        time,
    )
    x = x + 2 * np.random.default_rng(0).standard_normal(x.shape)
    return gb.Problem(LotkaVolterra(), gb.Record(time, {"H": x[0], "L": x[1]}))


class Pendulum(gb.StateSpace):
    """A pendulum swinging freely with large amplitude."""

    states = ("theta", "q")
    inputs = ()
    outputs = ("theta",)
    k = gb.Parameter(39.0, bounds=(35, 45), unit="1/s²")
    c = gb.Parameter(0.1, bounds=(0, 2), unit="1/s")

    def derivative(self, x, u, p):
        return (x.q, -p.k * gb.sin(x.theta) - p.c * x.q)

    def output(self, x, u, p):
        return (x.theta,)


def slow_pendulum():
    """Two samples and a half a period.

    Four standard steps of Runge-Kutta damp more than the pendulum itself.
    """
    time = 0.4 * np.arange(60)
    x = free_motion(lambda t, x: [x[1], -39 * np.sin(x[0]) - 0.08 * x[1]], [1.2, 0], time)
    theta = x[0] + 0.01 * np.random.default_rng(0).standard_normal(60)
    return gb.Problem(Pendulum(), gb.Record(time, {"theta": theta}))


class Lorenz(gb.StateSpace):
    """The chaotic system of Lorenz (1963), Journal of the Atmospheric Sciences 20(2).

    One state measured.
    """

    states, inputs, outputs = ("x", "y", "z"), (), ("x", "z")
    s = gb.Parameter(5.0, bounds=(1, 30), scale="log")
    r = gb.Parameter(15.0, bounds=(5, 60), scale="log")
    b = gb.Parameter(1.5, bounds=(0.3, 10), scale="log")

    def derivative(self, x, u, p):
        return (p.s * (x.y - x.x), x.x * (p.r - x.z) - x.y, x.x * x.y - p.b * x.z)

    def output(self, x, u, p):
        return (x.x, x.z)


LORENZ = {"s": 10.0, "r": 28.0, "b": 8 / 3}


def lorenz():
    time = 0.05 * np.arange(200)
    x = free_motion(
        lambda t, x: [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]],
        [-8, 7, 27],
        time,
    )
    noise = 0.5 * np.random.default_rng(0).standard_normal((2, 200))
    return gb.Problem(Lorenz(), gb.Record(time, {"x": x[0] + noise[0], "z": x[2] + noise[1]}))


# --- integration


class Swing(gb.StateSpace):
    """An oscillation whose two stiffnesses may swap: one minimum, two parameter vectors."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    k1 = gb.Parameter(90.0, bounds=(10, 200), unit="1/s²")
    k2 = gb.Parameter(20.0, bounds=(10, 200), unit="1/s²")
    c = gb.Parameter(0.5, bounds=(0, 20), unit="1/s")

    def derivative(self, x, u, p):
        return (x.v, -(p.k1 + p.k2) * x.x - p.c * x.v + p.k1 * p.k2 / 20 * u.u)

    def output(self, x, u, p):
        return (x.x,)


def swung(k=(80.0, 30.0), c=0.4, n=400, step=0.05, noise=1e-4):
    """The exact solution of an oscillation under a held input, sampled."""
    random = np.random.default_rng(0)
    u = np.repeat(random.normal(size=n // 10), 10)
    matrix = np.array([[0, 1, 0], [-(k[0] + k[1]), -c, k[0] * k[1] / 20], [0, 0, 0]])
    transition = expm(matrix * step)
    x = np.zeros((n, 2))
    for i in range(n - 1):
        x[i + 1] = transition[:2] @ [*x[i], u[i]]
    return gb.Record(np.arange(n) * step, {"u": u, "x": x[:, 0] + noise * random.normal(size=n)})


def swing():
    return gb.Problem(Swing(), swung(), HELD)


def stiff_lag():
    """A fast pole of 1000 1/s behind a slow one, sampled at 20 Hz.

    The data hold nothing of the fast one.
    """
    random, n, step = np.random.default_rng(0), 300, 0.05
    u = np.repeat(random.normal(size=n // 10), 10)
    y, decay = np.zeros(n), np.exp(-2.0 * step)
    for i in range(n - 1):
        y[i + 1] = decay * y[i] + 1.5 * (1 - decay) * u[i]
    record = gb.Record(np.arange(n) * step, {"u": u, "y": y + 0.1 * random.normal(size=n)})
    return gb.Problem(StiffLag(), record, HELD)


class Conversion(gb.StateSpace):
    """A to B with k1, back with k2.

    At the stability limit, Runge-Kutta has a spurious fast solution of equal cost.
    """

    states, inputs, outputs = ("A", "B"), (), ("y",)
    k1 = gb.Parameter(1.0, bounds=(1e-5, 1e5), scale="log")
    k2 = gb.Parameter(1.0, bounds=(1e-5, 1e5), scale="log")

    def derivative(self, x, u, p):
        return (-p.k1 * x.A + p.k2 * x.B, p.k1 * x.A - p.k2 * x.B)

    def output(self, x, u, p):
        return (x.B,)


def conversion():
    t, k1, k2 = np.arange(11.0), 0.8, 0.6
    y = k1 / (k1 + k2) * (1 - np.exp(-(k1 + k2) * t)) + 0.02 * np.random.default_rng(0).normal(
        size=11
    )
    return gb.Problem(
        Conversion(), gb.Record(t, {"y": y}), gb.OutputError(initial={"A": 1.0, "B": 0.0})
    )


# --- poorly identifiable


class Thrust(gb.StateSpace):
    """Four lags of one time constant behind a quadratic sum.

    Combinations of their initial states are hardly seen.
    """

    states = ("r1", "r2", "r3", "r4")
    inputs, outputs = ("u1", "u2", "u3", "u4"), ("F",)
    K0 = gb.Parameter(0.01, bounds=(-1, 1))
    K1 = gb.Parameter(0.01, bounds=(-1, 1))
    K2 = gb.Parameter(0.1, bounds=(0, 1))
    T_m = gb.Parameter(0.05, bounds=(0.001, 0.5), scale="log", unit="s")

    def derivative(self, x, u, p):
        return tuple((u[f"u{i}"] - x[f"r{i}"]) / p.T_m for i in (1, 2, 3, 4))

    def output(self, x, u, p):
        return (sum(p.K0 + p.K1 * x[f"r{i}"] + p.K2 * x[f"r{i}"] ** 2 for i in (1, 2, 3, 4)),)


THRUST = {"K0": 0.021, "K1": -0.0104, "K2": 0.1196, "T_m": 0.073}


def thrust(n=1500):
    random = np.random.default_rng(3)
    base = np.repeat(0.5 + 0.1 * random.normal(size=n // 100), 100)
    commands = {
        f"u{i}": np.clip(base + np.repeat(0.02 * random.normal(size=n // 20), 20), 0, 1)
        for i in (1, 2, 3, 4)
    }
    record = gb.Record(0.001 * np.arange(n), commands)
    initial = {f"r{i}": float(commands[f"u{i}"][0]) for i in (1, 2, 3, 4)}
    flown = gb.simulate(Thrust(), THRUST, record, inputs="held", initial=initial)
    return gb.Problem(
        Thrust(), record.with_signals(F=flown["F"] + 0.02 * random.normal(size=n)), HELD
    )


def tanh_chain(states=12, n=1000):
    """A chain of tanh couplings, some 2.5 parameters a state; with twelve states poorly posed."""
    random = np.random.default_rng(5)
    couplings, drives, outputs = range(states - 1), range(0, states, 4), range(2, states, 3)
    truth = {f"a{i}": float(random.uniform(1, 5)) for i in range(states)}
    truth |= {f"c{i}": float(random.uniform(0.5, 2)) for i in couplings}
    truth |= {f"b{i // 4}": float(random.uniform(1, 3)) for i in drives}
    truth |= {f"g{k}": float(random.uniform(0.5, 2)) for k in range(len(outputs))}

    def derivative(self, x, u, p):
        rates = []
        for i in range(states):
            rate = -p[f"a{i}"] * x[f"x{i}"]
            if i:
                rate = rate + p[f"c{i - 1}"] * gb.tanh(x[f"x{i - 1}"])
            if i in drives:
                rate = rate + p[f"b{i // 4}"] * u[f"u{i // 4}"]
            rates.append(rate)
        return tuple(rates)

    body = {
        "states": tuple(f"x{i}" for i in range(states)),
        "inputs": tuple(f"u{i // 4}" for i in drives),
        "outputs": tuple(f"y{k}" for k in range(len(outputs))),
        "derivative": derivative,
        "output": lambda self, x, u, p: tuple(
            p[f"g{k}"] * x[f"x{i}"] for k, i in enumerate(outputs)
        ),
        **{name: gb.Parameter(1.5, bounds=(0.1, 10)) for name in truth},
    }
    model = type("TanhChain", (gb.StateSpace,), body)()
    held = {f"u{i // 4}": np.repeat(2 * random.normal(size=n // 25 + 1), 25)[:n] for i in drives}
    record = gb.Record(0.02 * np.arange(n), held)
    clean = gb.simulate(model, truth, record, inputs="held")
    noisy = {f"y{k}": clean[f"y{k}"] + 0.01 * random.normal(size=n) for k in range(len(outputs))}
    return gb.Problem(model, record.with_signals(**noisy), HELD)


# --- delays and long records


class Direct(Lag):
    """Half of the input reaches the output directly."""

    def response(self, s, p):
        return (p.K / (p.T * s + 1) + 1) * gb.exp(-s * p.d)


def direct(samples, seed):
    """The lag of a held input and its input, which a sample sees as it was just before if the delay
    is a fraction."""
    data = lag(samples * 0.05, True, noise=0.01, seed=seed)
    late = np.clip(np.arange(len(data)) - int(np.ceil(samples - 1e-9)), 0, None)
    return data.with_signals(y=data["y"] + data["u"][late])


def direct_delay():
    """The cost jumps where the delay passes a whole sample."""
    return gb.Problem(Direct(), direct(1.5, 0), HELD, free=("d",))


def long_spring():
    """25 000 samples, with a delay."""
    values = SPRING | {"d": 0.033}
    n = 25_000
    sigma = {"x": 0.05, "v": 0.15}
    options = {"rate": 20.0, "noise": sigma, "seed": 0}
    record = gb.virtual_flight(Spring(), values, excitation={"F": steps(n, 0)}, **options)
    return gb.Problem(Spring(), record, HELD, free=("d",))


# --- flights of the unstable tilt plant


class BlindTilt(NonlinearTilt):
    """Without the velocity."""

    outputs = ("q", "theta")

    def output(self, x, u, p):
        return (x.q, x.theta)


def windy_flight(seed, wind, seconds):
    """The unstable plant in its closed loop, disturbed at some states."""
    clock, waves = np.arange(100 * seconds) / 100, np.geomspace(0.5, 16, 9)
    phases = np.random.default_rng(5).uniform(0, 2 * np.pi, 9)
    reference = 0.08 * sum(np.sin(w * clock + f) for w, f in zip(waves, phases, strict=True))
    return gb.virtual_flight(
        FullTilt(),
        TILT,
        excitation={"reference": reference},
        controller=AttitudeController(rate=100.0),
        noise={"v": 0.05, "q": 0.02, "theta": 0.005},
        process_noise=wind,
        seed=seed,
    )


def tilt():
    """Output error, in the declared boxes, rotor and delay estimated too."""
    return gb.Problem(FullTilt(), tilt_flight(20), HELD)


def tilt_in_wind():
    """A predictor with twelve gains."""
    return gb.Problem(FullTilt(), windy_flight(2, {"q": 2.0}, 20), WIND, fixed=ROTOR)


def tilt_in_wind_as_output_error():
    """The unstable plant disturbed by gusts that the model does not know of."""
    return gb.Problem(FullTilt(), windy_flight(0, {"v": 0.5, "q": 0.5}, 20), HELD, fixed=ROTOR)


def blind_tilt():
    """A predictor at its stability limit: the velocity is not measured and hardly disturbed."""
    return gb.Problem(BlindTilt(), windy_flight(3, {"q": 0.3}, 40), WIND, fixed=ROTOR)


class Pushed(gb.StateSpace):
    """The spring under a constant force that nobody knows and nothing changes."""

    states, outputs, inputs = ("x", "v", "w"), ("x", "v"), ("F",)
    k = gb.Parameter(6.0, bounds=(0.1, 100))
    c = gb.Parameter(0.8, bounds=(-5, 20))
    b = gb.Parameter(1.5, bounds=(-50, 50))

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - p.c * x.v + p.b * u.F + x.w, 0)

    def output(self, x, u, p):
        return (x.x, x.v)


def pushed(n=3000):
    """A predictor with an unknown constant force."""
    truth = {name: SPRING[name] for name in ("k", "c", "b")}
    options = {
        "rate": 20.0,
        "noise": {"x": 0.02, "v": 0.06},
        "process_noise": {"v": 1.0},
        "initial": {"w": 2.0},
    }
    data = gb.virtual_flight(Pushed(), truth, excitation={"F": steps(n, 4)}, **options)
    return gb.Problem(Pushed(), data, gb.PredictionError(corrected=("x", "v"), inputs="held"))


# --- NIST's nonlinear regressions


class Bennett5(gb.StateSpace):
    """Magnetization: y = b1 (b2 + x)^(-1/b3), a curved narrow valley."""

    states, inputs, outputs = (), ("x",), ("y",)
    b1 = gb.Parameter(-2000.0, bounds=(-20000, -1))
    b2 = gb.Parameter(50.0, bounds=(1, 500), scale="log")
    b3 = gb.Parameter(0.8, bounds=(0.1, 10), scale="log")

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return (p.b1 * gb.exp(-gb.log(p.b2 + u.x) / p.b3),)


class MGH10(gb.StateSpace):
    """A thermistor: y = b1 exp(b2 / (x + b3)), badly scaled."""

    states, inputs, outputs = (), ("x",), ("y",)
    b1 = gb.Parameter(2.0, bounds=(1e-4, 10), scale="log")
    b2 = gb.Parameter(400000.0, bounds=(1e2, 1e6), scale="log")
    b3 = gb.Parameter(25000.0, bounds=(10, 1e5), scale="log")

    def derivative(self, x, u, p):
        return ()

    def output(self, x, u, p):
        return (p.b1 * gb.exp(p.b2 / (u.x + p.b3)),)


class MGH17(gb.StateSpace):
    """Two decays that nearly cancel.

    y = b1 + b2 exp(-b4 x) + b3 exp(-b5 x), as states e, f with known first values.
    """

    states, inputs, outputs = ("e", "f"), (), ("y",)
    b1 = gb.Parameter(50.0, bounds=(-100, 100))
    b2 = gb.Parameter(150.0, bounds=(-200, 200))
    b3 = gb.Parameter(-100.0, bounds=(-200, 200))
    b4 = gb.Parameter(1.0, bounds=(1e-4, 5), scale="log")
    b5 = gb.Parameter(2.0, bounds=(1e-4, 5), scale="log")

    def derivative(self, x, u, p):
        return (-p.b4 * x.e, -p.b5 * x.f)

    def output(self, x, u, p):
        return (p.b1 + x.e + x.f,)


class Lanczos(gb.StateSpace):
    """Three decays, of amplitudes b1, b3, b5 and rates b2, b4, b6."""

    states, inputs, outputs = ("e", "f", "g"), (), ("y",)
    b1 = gb.Parameter(1.2, bounds=(0.01, 20), scale="log")
    b2 = gb.Parameter(0.3, bounds=(0.01, 20), scale="log")
    b3 = gb.Parameter(5.6, bounds=(0.01, 20), scale="log")
    b4 = gb.Parameter(5.5, bounds=(0.01, 20), scale="log")
    b5 = gb.Parameter(6.5, bounds=(0.01, 20), scale="log")
    b6 = gb.Parameter(7.6, bounds=(0.01, 20), scale="log")

    def derivative(self, x, u, p):
        return (-p.b2 * x.e, -p.b4 * x.f, -p.b6 * x.g)

    def output(self, x, u, p):
        return (x.e + x.f + x.g,)


def nist(model, table, **initial):
    """A problem from a table (n, 2) of y and x.

    x is the input, or the time if the model has no input.
    """
    y, x = table.T
    if model.inputs:
        return gb.Problem(
            model(), gb.Record(np.arange(len(x), dtype=float), {"x": x, "y": y}), HELD
        )
    known = {state: (lambda p, name=name: p[name]) for state, name in initial.items()}
    return gb.Problem(model(), gb.Record(x, {"y": y}), gb.OutputError(initial=known))
