"""A saved fit of a rate and the file of its controller: a loop whose margins are computed quickly."""

import numpy as np

import greybox as gb
from greybox.models.rate import BasicRate

CONTROLLER = """
import greybox as gb

class RateLoop(gb.Controller):
    inputs, outputs = ("p",), ("u",)
    K_P = gb.Parameter(0.05, bounds=(0, 10))

    def update(self, x, u, p):
        return (), (p.K_P * (u.reference - u.p),)
"""


def saved_rate_loop(folder):
    """Write both, and return the fit and the option that names the controller."""
    (folder / "rate_loop.py").write_text(CONTROLLER, encoding="utf-8")
    omega = np.geomspace(2, 60, 30)
    exact = gb.frequency_response(BasicRate(), {}, omega)
    errors = 1 + 0.03 * np.random.default_rng(0).normal(size=(2, 30)).T @ [1, 1j]
    data = gb.FrequencyResponse(omega, exact.response * errors, "u", "p", name="battery 1")
    path = folder / "roll.h5"
    gb.save(gb.fit(gb.Problem(BasicRate(), data), starts=2, progress=False), path)
    return path, "--controller", f"{folder / 'rate_loop.py'}:RateLoop"
