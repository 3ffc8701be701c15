"""Aircraft of Jategaonkar's book: estimates and errors beside the published ones.

python benchmarks/boards/flight_vehicles.py FOLDER [--output FILE]

FOLDER is `flt_data` of the programs that accompany R. V. Jategaonkar, Flight Vehicle System
Identification: A Time Domain Methodology, 2nd ed., AIAA 2015
(https://arc.aiaa.org/doi/suppl/10.2514/4.102790). They are the author's property, so nothing of
them is here but the equations and the estimates.

"Published" is the vector `parOEM` of the programs of chapter 7, against which they plot their
recursive estimates; it comes without standard errors. For the HFB-320 it is no minimum of output
error: speed simulated with it is 1.69 m/s rms off, and 0.45 m/s at the minimum. The programs start
the second manoeuvre of ATTAS from the first sample of the first one, and hold the initial states;
here they are estimated.

DHC-2 is a simulation with process noise and without noise of sensors. Its true parameters are
printed nowhere in these files, but each output is exactly linear in the columns of the simulated
states and the inputs, so that "published" is that regression.

Each case is fitted by output error and by filter error, `PredictionError(process_noise=...)` on
every state, both from four drawn starts; equation error needs none. The held-out part is another
manoeuvre or the end of the record, simulated from its first sample. Its error is divided by the
standard deviation of each output, so that its mean would give 1; what is held at its first sample,
the trim, is the naive predictor.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from command import heading, parser, show
from scipy.io import loadmat

import greybox as gb

STARTS = 4
DEG = np.pi / 180
GRAVITY = 9.80665  # m/s²


def derivative_of(about, start, size=20.0):
    """Return a parameter between these bounds."""
    return gb.Parameter(start, bounds=(-size, size), unit="1", about=about)


class HFB320(gb.StateSpace):
    """Longitudinal motion of a business jet in stability axes, equations (5.86) to (5.89)."""

    states = ("V", "alpha", "theta", "q")
    inputs, outputs = ("elevator", "thrust"), (*states, "q_dot", "a_x", "a_z")
    C_D0 = derivative_of("drag", 0.1, 5)
    C_DV = derivative_of("drag by speed", 0.0, 5)
    C_Da = derivative_of("drag by angle of attack", 0.3, 10)
    C_L0 = derivative_of("lift", 0.0, 5)
    C_LV = derivative_of("lift by speed", 0.0, 5)
    C_La = derivative_of("lift by angle of attack", 4.0)
    C_m0 = derivative_of("pitching moment", 0.1, 5)
    C_mV = derivative_of("pitching moment by speed", 0.0, 5)
    C_ma = derivative_of("pitching moment by angle of attack", -1.0, 10)
    C_mq = derivative_of("damping of pitch", -30.0, 200)
    C_me = derivative_of("pitching moment by elevator", -1.5)

    def forces(self, x, u, p):
        """Return drag and lift per mass, m/s², and the pitch acceleration."""
        speed, pressure = x.V / 104.67, 0.792 / 2 * x.V**2
        moment = p.C_m0 + p.C_mV * speed + p.C_ma * x.alpha + p.C_me * u.elevator
        return (
            4.028e-3 * pressure * (p.C_D0 + p.C_DV * speed + p.C_Da * x.alpha),
            4.028e-3 * pressure * (p.C_L0 + p.C_LV * speed + p.C_La * x.alpha),
            8.0027e-4 * pressure * (moment + p.C_mq * 1.215 * x.q / 104.67) - 7.0153e-6 * u.thrust,
        )

    def derivative(self, x, u, p):
        """Return the rates of the states."""
        drag, lift, pitch = self.forces(x, u, p)
        thrust, tilt, climb = u.thrust / 7472, x.alpha + 0.0524, x.alpha - x.theta
        along = -drag + thrust * gb.cos(tilt) + GRAVITY * gb.sin(climb)
        across = -lift - thrust * gb.sin(tilt) + GRAVITY * gb.cos(climb)
        return (along, across / x.V + x.q, x.q, pitch)

    def output(self, x, u, p):
        """Return states, pitch acceleration and specific forces."""
        drag, lift, pitch = self.forces(x, u, p)
        thrust, s, c = u.thrust / 7472, gb.sin(x.alpha), gb.cos(x.alpha)
        a_x = lift * s - drag * c + thrust * np.cos(0.0524)
        a_z = -lift * c - drag * s - thrust * np.sin(0.0524)
        return (x.V, x.alpha, x.theta, x.q, pitch, a_x, a_z)


class ShortPeriod(gb.StateSpace):
    """Angle of attack and pitch rate, case 11 of the programs."""

    states = outputs = ("alpha", "q")
    inputs = ("elevator",)
    Z_0, M_0 = derivative_of("offset", 0.0), derivative_of("offset", 0.0)
    Z_a, M_a = (derivative_of("by angle of attack", value, 50) for value in (-0.5, -3.0))
    Z_q, M_q = (derivative_of("by pitch rate", value, 50) for value in (0.0, -1.0))
    Z_e, M_e = (derivative_of("by elevator", value, 50) for value in (0.0, -5.0))

    def derivative(self, x, u, p):
        """Return the rates of both."""
        return (
            p.Z_0 + p.Z_a * x.alpha + (p.Z_q + 1) * x.q + p.Z_e * u.elevator,
            p.M_0 + p.M_a * x.alpha + p.M_q * x.q + p.M_e * u.elevator,
        )

    def output(self, x, u, p):
        """Return both."""
        return (x.alpha, x.q)


class Lateral(gb.StateSpace):
    """Roll and yaw with the measured sideslip as an input, equations (4.90) and (4.91)."""

    states, inputs = ("p", "r"), ("aileron", "rudder", "slip")
    outputs = ("p_dot", "r_dot", "a_y", "p", "r")
    L_p, N_p, Y_p = (derivative_of("by roll rate", value, 50) for value in (-3.0, -0.2, 0.0))
    L_r, N_r, Y_r = (derivative_of("by yaw rate", value, 50) for value in (1.0, -0.5, 0.0))
    L_a, N_a, Y_a = (derivative_of("by aileron", value, 50) for value in (-5.0, -0.3, 0.0))
    L_d, N_d, Y_d = (derivative_of("by rudder", value, 50) for value in (0.5, -1.0, 0.0))
    L_s, N_s, Y_s = (derivative_of("by sideslip", value, 50) for value in (-2.0, 1.0, -1.0))
    L_0, N_0, Y_0 = (derivative_of("offset", 0.0, 5) for _ in range(3))
    p_dot_0, r_dot_0 = (derivative_of("offset of the sensor", 0.0, 5) for _ in range(2))

    def sums(self, x, u, p):
        """Return roll and yaw acceleration and side force without offsets."""
        signals = {"p": x.p, "r": x.r, "a": u.aileron, "d": u.rudder, "s": u.slip}
        return tuple(
            sum(getattr(p, f"{row}_{name}") * value for name, value in signals.items())
            for row in "LNY"
        )

    def derivative(self, x, u, p):
        """Return the rates of both."""
        roll, yaw, _ = self.sums(x, u, p)
        return (roll + p.L_0, yaw + p.N_0)

    def output(self, x, u, p):
        """Return accelerations and rates."""
        roll, yaw, side = self.sums(x, u, p)
        return (roll + p.p_dot_0, yaw + p.r_dot_0, side + p.Y_0, x.p, x.r)


class Unstable(gb.StateSpace):
    """Heave and pitch of an unstable aircraft at 44.57 m/s under feedback, case 8."""

    states, inputs, outputs = ("w", "q"), ("elevator",), ("a_z", "w", "q")
    Z_w, Z_e = derivative_of("heave by w", -1.2), derivative_of("heave by elevator", -4.0, 100)
    M_w, M_q = derivative_of("pitch by w", 0.1, 5), derivative_of("damping of pitch", -3.0)
    M_e = derivative_of("pitch by elevator", -19.0, 100)

    def derivative(self, x, u, p):
        """Return the rates of both."""
        a_z, _, _ = self.output(x, u, p)
        return (a_z + 44.5695 * x.q, p.M_w * x.w + p.M_q * x.q + p.M_e * u.elevator)

    def output(self, x, u, p):
        """Return the vertical acceleration and both."""
        return (p.Z_w * x.w - 1.4768 * x.q + p.Z_e * u.elevator, x.w, x.q)


@dataclass(frozen=True)
class Case:
    """An aircraft: its records, which of them are fitted, and what was published."""

    name: str
    model: gb.StateSpace
    fitted: Sequence[gb.Record]
    published: Mapping[str, float]
    test: gb.Record | None = None
    training: Sequence[gb.Record] = ()
    """The records of the fit that is tested."""
    fixed: Mapping[str, float] = field(default_factory=dict)

    def problem(self, records: Sequence[gb.Record], criterion: gb.TimeCriterion) -> gb.Problem:
        """Return what is fitted."""
        stated = [gb.Problem(self.model, r, criterion, fixed=self.fixed) for r in records]
        return sum(stated[1:], start=stated[0])


def record(name: str, step: float, signals: Mapping[str, np.ndarray]) -> gb.Record:
    """Return a record with inputs that are linear between samples."""
    length = len(next(iter(signals.values())))
    hold = dict.fromkeys(signals, 0.0)
    return gb.Record(step * np.arange(length), signals, hold=hold, name=name)


def hfb320(folder: Path) -> Case:
    """Return the elevator 3-2-1-1 and pulse; the test is what follows 40 s."""
    table = np.loadtxt(folder / "hfb320_1_10.asc").T
    names = {"elevator": 1, "thrust": 3, "V": 4, "alpha": 5, "theta": 6, "q": 7}
    names |= {"q_dot": 8, "a_x": 9, "a_z": 10}
    whole, first, rest = (
        record("HFB-320", 0.1, {name: table[k, part] for name, k in names.items()})
        for part in (slice(None), slice(400), slice(400, None))
    )
    values = (0.122688, -0.0644969, 0.320055, -0.0929113, 0.148726, 4.32785)
    values += (0.111905, 0.00395154, -0.967854, -34.7098, -1.52913)
    published = dict(zip(HFB320.parameters, values, strict=True))
    return Case("HFB-320", HFB320(), (whole,), published, rest, (first,))


def attas(folder: Path, names: Sequence[str], signals: Callable) -> list[gb.Record]:
    """Return manoeuvres of ATTAS."""
    tables = (loadmat(folder / f"{name}.mat")[name].T for name in names)
    return [record(n, 0.04, signals(table)) for n, table in zip(names, tables, strict=True)]


def short_period(folder: Path) -> Case:
    """Return two elevator inputs; the second is the test of the first."""
    both = attas(
        folder,
        ("fAttasElv1", "fAttasElv2"),
        lambda t: {"alpha": t[12] * DEG, "q": t[7] * DEG, "elevator": t[21] * DEG},
    )
    published = {"Z_0": -0.00898779, "Z_a": -0.483362, "Z_q": 0.104198, "Z_e": 0.676322}
    published |= {"M_0": 0.475234, "M_a": -4.92651, "M_q": -2.00573, "M_e": -7.20806}
    return Case("ATTAS, short period", ShortPeriod(), both, published, both[1], both[:1])


def lateral(folder: Path) -> Case:
    """Return two aileron and rudder inputs; the second is the test of the first."""
    both = attas(
        folder,
        ("fAttasAilRud1", "fAttasAilRud2"),
        lambda t: {
            "p": t[6] * DEG,
            "r": t[8] * DEG,
            "aileron": (t[28] - t[27]) / 2 * DEG,
            "rudder": t[29] * DEG,
            "slip": t[13] * DEG,
        },
    )
    published = {"L_p": -2.06748, "L_r": 1.02929, "L_a": -6.30585, "L_d": 1.1452, "L_s": -3.84437}
    published |= {"L_0": 0.013848, "N_p": -0.18385, "N_r": -0.4856, "N_a": -0.39121}
    published |= {"N_d": -1.7609, "N_s": 3.03138, "N_0": 0.034585}
    unseen = {name: 0.0 for name in Lateral.parameters if name[0] == "Y" or "dot" in name}
    return Case("ATTAS, lateral", Lateral(), both, published, both[1], both[:1], unseen)


def beaver(folder: Path) -> Case:
    """Return the simulated DHC-2; its true values follow from the simulated states."""
    t = np.loadtxt(folder / "y13aus_da1.asc").T
    names = {"p_dot": 11, "r_dot": 12, "a_y": 13, "p": 14, "r": 15}
    names |= {"aileron": 16, "rudder": 17, "slip": 18}
    terms = np.stack([*t[[19, 20, 16, 17, 18]], np.ones(t.shape[1])], axis=-1)
    true = {}
    for row, output in zip("LNY", (11, 12, 13), strict=True):
        values = np.linalg.lstsq(terms, t[output], rcond=None)[0]
        true |= {f"{row}_{name}": float(v) for name, v in zip("prads", values, strict=False)}
    whole = record("DHC-2", 0.05, {name: t[k] for name, k in names.items()})
    return Case("DHC-2 in turbulence, simulated", Lateral(), (whole,), true)


def unstable(folder: Path) -> Case:
    """Return the simulated unstable aircraft."""
    t = np.loadtxt(folder / "unStabAC_sim.asc").T
    whole = record("unstable", 0.05, {"a_z": t[5], "w": t[2], "q": t[3], "elevator": t[4]})
    published = {"Z_w": -1.4249, "Z_e": -6.2632, "M_w": 0.21635, "M_q": -3.7125, "M_e": -12.769}
    return Case("unstable aircraft, simulated", Unstable(), (whole,), published)


def misfit(case: Case, values: Mapping[str, float], flown: gb.Record) -> float:
    """Return the rms error of a simulation from the first sample, in standard deviations."""
    known = case.fixed | {name: values[name] for name in case.model.parameters if name in values}
    initial = {name: float(flown[name][0]) for name in case.model.states}
    simulated = gb.simulate(case.model, known, flown, initial=initial)
    return normalized({name: simulated[name] - flown[name] for name in outputs(case, flown)}, flown)


def outputs(case: Case, flown: gb.Record) -> list[str]:
    """Return the measured outputs."""
    return [name for name in case.model.outputs if name in flown.signals]


def normalized(errors: Mapping[str, np.ndarray], flown: gb.Record) -> float:
    """Return the rms over outputs, each by its standard deviation."""
    shares = [np.mean(error**2) / np.var(flown[name]) for name, error in errors.items()]
    return float(np.sqrt(np.mean(shares)))


def rows(case: Case) -> list[str]:
    """Return the table of a case."""
    rules = {
        "output error": gb.OutputError(),
        "filter error": gb.PredictionError(process_noise=case.model.states),
    }
    first = gb.regression.equation_error(case.model, case.fitted[0], fixed=case.fixed)
    fits, foot = {}, []
    for label, rule in rules.items():
        begin = time.process_time()
        stated = case.problem(case.fitted, rule)
        fit = fits[label] = gb.fit(stated, STARTS, progress=False, profiles=False)
        spent = time.process_time() - begin
        foot += [
            f"{label}: {fit.agreeing} of {STARTS} starts at the best minimum, {spent:.0f} s",
            *(f"  {sentence}" for sentence in fit.to_dict()["verdict"]["sentences"]),
        ]

    head = f"{'':8}{'published':>10}{'equation error':>16}"
    lines = [case.name, head + "".join(f"{label:>22}" for label in fits)]
    for name, value in case.published.items():
        cells = (f"{f.estimate[name]:.4g} ± {f.standard_error[name]:.2g}" for f in fits.values())
        guess = first.estimate.get(name, np.nan)
        lines.append(f"{name:8}{value:10.4g}{guess:16.4g}" + "".join(f"{c:>22}" for c in cells))
    lines += foot
    if case.test is not None:
        trim = {name: case.test[name] - case.test[name][0] for name in outputs(case, case.test)}
        errors = {"naive: trim": normalized(trim, case.test)}
        errors["published, fitted to all"] = misfit(case, case.published, case.test)
        for label, rule in rules.items():
            stated = case.problem(case.training, rule)
            start = {name: fits[label].estimate[name] for name in fits[label].free}
            fit = gb.fit(stated, [start], progress=False, profiles=False)
            errors[label] = misfit(case, fit.estimate, case.test)
        lines.append("held out, simulated: " + ", ".join(f"{k} {v:.3f}" for k, v in errors.items()))
    return [*lines, ""]


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    cases = (hfb320, short_period, lateral, beaver, unstable)
    return [heading(), "", *(line for case in cases for line in rows(case(folder)))]


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
