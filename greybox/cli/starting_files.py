"""The commented file that `greybox new` writes; with its made-up numbers, it runs as it is."""

TRANSFER_FUNCTION = '''\
class {name}(gb.TransferFunction):
    r"""Angle from the control: rotor lag, inertia, damping, delay. `greybox list` shows this line.

    $$P(s) = \\frac{{K}}{{s (s + a) (T s + 1)}} e^{{-s T_{{delay}}}}$$

    Source: where the equation comes from.
    """

    input, output = "u", "theta"  # the names by which model and data meet
    units = {{"theta": "rad"}}  # data in other units are refused

    # Start, bounds, unit, meaning. Starts are drawn between the bounds: make these as narrow as you
    # are sure of.
    K = gb.Parameter(50.0, bounds=(1, 500), unit="1/s²", about="angular acceleration per control")
    a = gb.Parameter(1.0, bounds=(0, 5), unit="1/s", about="damping of the rate")
    T = gb.Parameter(0.05, bounds=(0.005, 0.2), unit="s", about="time constant of the rotors")
    # free=["T_delay"] estimates a parameter that is fixed here.
    T_delay = gb.Parameter(0.0, bounds=(0, 0.05), unit="s", about="delay", fixed=True)

    # What follows from the parameters, each with a standard error of its own.
    derived = {{"bandwidth": lambda p: 1 / p.T}}

    def response(self, s, p):
        # As on paper: + - * / ** and gb.exp, gb.sqrt ... One formula works for numbers, CasADi and
        # rational functions.
        return p.K * gb.exp(-s * p.T_delay) / (s * (s + p.a) * (p.T * s + 1))
'''

STATE_SPACE = '''\
class {name}(gb.StateSpace):
    r"""Velocity from the tilt angle, with drag. This line is what `greybox list` shows.

    $$\\dot v = g \\tan\\theta - c |v| v$$

    Source: where the equation comes from.
    """

    states, inputs, outputs = ("v",), ("theta",), ("v",)  # the names by which model and data meet
    units = {{"theta": "rad", "v": "m/s"}}  # data in other units are refused

    # Start, bounds, unit, meaning. Starts are drawn between the bounds: make these as narrow as you
    # are sure of.
    c = gb.Parameter(0.1, bounds=(0.001, 2), unit="1/m", about="drag", scale="log")

    def derivative(self, x, u, p):
        # One entry for each state. abs, gb.tan, gb.where ... serve numbers and expressions alike;
        # if and max do not.
        return (gb.g * gb.tan(u.theta) - p.c * abs(x.v) * x.v,)

    def output(self, x, u, p):
        return (x.v,)
'''

BEGIN = '''\
"""Which model is fitted to which data; `greybox fit` prints this line.

    greybox fit {file}
    greybox fit {file} --out {stem}.h5 --plot {stem}.png
    greybox fit --model {file} --data DATA.csv
"""

import numpy as np

import greybox as gb


'''

RESPONSE = '''

def data():
    """Return the measured frequency response: here a made-up one, with 2 % noise."""
    # Yours, from a file with the columns omega_rad_s, alpha, beta:
    #     return gb.read_response("response.csv")
    # from magnitude and phase:
    #     columns = {{"frequency": "f:Hz", "magnitude": "mag:dB", "phase": "ph:deg"}}
    #     return gb.read_response("response.csv", columns=columns)
    # or from a flight log, on the command line:
    #     greybox response flight.BIN --input u=... --output theta=... --out response.csv
    truth = {{"K": 60.0, "a": 2.0, "T": 0.06}}
    exact = gb.frequency_response({name}(), truth, np.geomspace(1, 40, 20))  # rad/s
    parts = np.random.default_rng(0).normal(size=(2, 20))
    noisy = exact.response * (1 + 0.02 * (parts[0] + 1j * parts[1]))
    return gb.FrequencyResponse(exact.omega, noisy, input="u", output="theta", name="made up")


def problem():
    """Return what `greybox fit` fits; it may change what the model declares."""
    return gb.Problem(
        {name}(),
        data(),
        # criterion=gb.RelativeLikelihood(),  # how the mismatch is measured; docs: "Choosing"
        # fixed={{"a": 2.0}},
        # bounds={{"a": (0, 5)}},
    )


settings = {{"starts": 50, "seed": 0}}  # of the search; --starts and --seed override them
'''

RECORD = '''

def data():
    """Return the measured record: here a made-up one, with noise of 0.05 m/s."""
    # Yours, from a table with the columns time [s], theta [rad], v [m/s]:
    #     return gb.read("flight.csv")["flight"]
    # or from a flight log:
    #     signals = {{"theta": "ATT.Pitch", "v": "XKF1.VN"}}
    #     return gb.prepare(gb.read("flight.BIN"), signals, rate=50)
    time = np.arange(0, 60, 0.02)  # s
    theta = 0.2 * np.sin(0.8 * time) + 0.1 * np.sin(2.5 * time)
    between = {{"theta": 0.0}}  # continuous between samples; math.inf if a controller holds it
    flown = gb.Record(time, {{"theta": theta}}, {{"theta": "rad"}}, hold=between, name="made up")
    v = gb.simulate({name}(), {{"c": 0.25}}, flown)["v"]
    noise = 0.05 * np.random.default_rng(0).normal(size=time.size)
    return flown.with_signals(v=v + noise, units={{"v": "m/s"}})


def problem():
    """Return what `greybox fit` fits; it may change what the model declares."""
    return gb.Problem(
        {name}(),
        data(),
        # criterion=gb.OutputError(),  # how the mismatch is measured; docs: "Choosing"
        # fixed={{"c": 0.1}},
        # bounds={{"c": (0.01, 1)}},
    )


settings = {{"starts": 5, "seed": 0}}  # of the search; --starts and --seed override them
'''


def problem_file(file: str, name: str, *, in_time: bool) -> str:
    """Return a file with a model, data and a problem, for a response or a record (`in_time`)."""
    text = STATE_SPACE + RECORD if in_time else TRANSFER_FUNCTION + RESPONSE
    return (BEGIN + text).format(file=file, stem=file.removesuffix(".py"), name=name)
