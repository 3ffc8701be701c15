"""A structure that is fitted in stages: a lag first, then an oscillator behind it."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Recording
from greybox.workflows.identification.stages import Stage, fit_in_stages

TRUTH = {"T": 0.2, "omega": 3.0, "zeta": 0.3}


class Lag(gb.StateSpace):
    states, inputs, outputs = ("w",), ("u",), ("force",)
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")

    def derivative(self, x, u, p):
        return ((u.u - x.w) / p.T,)

    def output(self, x, u, p):
        return (x.w,)


class DrivenMass(Lag):
    states, outputs = ("w", "x", "v"), ("x",)
    omega = gb.Parameter(2.0, bounds=(0.1, 50), unit="rad/s")
    zeta = gb.Parameter(0.5, bounds=(0, 2), unit="1")

    def derivative(self, x, u, p):
        return (
            *super().derivative(x, u, p),
            x.v,
            x.w - 2 * p.zeta * p.omega * x.v - p.omega**2 * x.x,
        )

    def output(self, x, u, p):
        return (x.x,)

    def stages(self, recordings):
        (recording,) = recordings
        record = recording["test"]
        force = gb.Record(record.time, {name: record[name] for name in ("u", "force")})
        motion = gb.Record(record.time, {name: record[name] for name in ("u", "x")})
        return (
            Stage("lag", "from the force.", lambda fits: gb.Problem(Lag(), force), 2),
            Stage(
                "mass",
                "with the lag of the force.",
                lambda fits: gb.Problem(self, motion, fixed={"T": fits["lag"]}),
                2,
            ),
            Stage(
                "all",
                "from both.",
                lambda fits: gb.Problem(Lag(), force) + gb.Problem(self, motion),
                lambda fits: [{n: f.estimate[n] for f in fits.values() for n in f.free}],
            ),
        )


@pytest.fixture(scope="module")
def recording():
    random = np.random.default_rng(0)
    time = np.arange(0, 20, 0.02)
    record = gb.Record(time, {"u": np.sign(np.sin(0.7 * time) + 0.4 * np.sin(4.1 * time))})
    lag = gb.simulate(Lag(), {"T": TRUTH["T"]}, record)["force"]
    x = gb.simulate(DrivenMass(), TRUTH, record)["x"]
    noisy = {
        "force": lag + 0.3 * random.normal(size=1000),
        "x": x + 0.01 * random.normal(size=1000),
    }
    return Recording({"test": record.with_signals(**noisy)})


def test_later_stages_carry_the_errors_of_the_earlier_ones(recording):
    found = fit_in_stages(DrivenMass(), [recording], {})
    assert list(found.fits) == ["lag", "mass", "all"]
    assert not found.failure
    lag, mass, everything = found.fits.values()
    for fit in found.fits.values():
        for name in fit.free:
            if name in TRUTH:
                assert abs(fit.estimate[name] - TRUTH[name]) < 4 * fit.standard_error[name]
    known = gb.fit(
        gb.Problem(DrivenMass(), mass.parts[0].data, fixed={"T": lag.estimate["T"]}),
        2,
        progress=False,
    )
    assert mass.standard_error["omega"] > 1.05 * known.standard_error["omega"]
    # The motion knows the lag better than the force does, and only the last stage uses that.
    assert everything.standard_error["T"] < 0.5 * lag.standard_error["T"]
    assert "Stage 2, mass: with the lag of the force." in str(found)


def test_stated_values_hold_in_every_stage_that_has_the_parameter(recording):
    stated = {"fixed": {"zeta": 0.3}, "bounds": {"T": (0.1, 0.4)}}
    found = fit_in_stages(DrivenMass(), [recording], stated)
    lag, *others = found.fits.values()
    for fit in others:
        assert fit.estimate["zeta"] == 0.3
        assert "zeta" not in fit.free
    for fit in (lag, found.fit):
        (bounds,) = [q.bounds for q in fit.quantities if q.name == "T"]
        assert bounds == (0.1, 0.4)


def test_refuses_a_parameter_that_no_stage_has(recording):
    with pytest.raises(ValueError, match="has no parameter 'tau'"):
        fit_in_stages(DrivenMass(), [recording], {"fixed": {"tau": 1.0}})
