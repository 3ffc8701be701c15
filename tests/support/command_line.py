"""Running the command line inside a test, and files that a user would write."""

from greybox.cli.main import main

QUICK = ["--starts", "8"]

OWN = '''import greybox as gb
import numpy as np

class Lag(gb.TransferFunction):
    r"""A lag with delay."""
    input, output = "u", "y"
    K = gb.Parameter(1.0, bounds=(0, 10), unit="1", about="gain")
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")

    def response(self, s, p):
        return p.K / (p.T * s + 1)

def data():
    omega = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
    return gb.FrequencyResponse(omega, 3 / (0.2j * omega + 1))

def problem():
    return gb.Problem(Lag(), data())

def other():
    return gb.Problem(Lag(), data(), fixed={"T": 0.2})

settings = {"starts": 5, "seed": 3}
'''


RECORD = '''import greybox as gb
import numpy as np

class Lag(gb.StateSpace):
    r"""A lag."""
    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(1.0, bounds=(0, 10), unit="1", about="gain")
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s", about="time constant")

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)

def problem():
    time = np.arange(200) / 50
    u = np.sin(3 * time) + np.sin(7 * time)
    y = gb.simulate(Lag(), {"K": 2.0, "T": 0.3}, gb.Record(time, {"u": u}))["y"]
    noise = 0.02 * np.random.default_rng(0).normal(size=200)
    return gb.Problem(Lag(), gb.Record(time, {"u": u, "y": y + noise}, {"y": "m"}))

settings = {"starts": 3}
'''


def run(capsys, *arguments):
    status = main([str(a) for a in arguments])
    return status, *capsys.readouterr()


def refused(capsys, *arguments):
    """Run a command that must be refused: one sentence on stderr, nothing on stdout, status 2."""
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert err.startswith("greybox: ")
    assert len(err.strip().splitlines()) == 1
    assert "Traceback" not in err
    return err
