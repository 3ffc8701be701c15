"""Cascaded tanks: two tanks in a row, a pump below, and water that overflows.

python benchmarks/boards/cascaded_tanks.py FOLDER [--output FILE]

FOLDER has `dataBenchmark.csv` of the benchmark of https://www.nonlinearbenchmark.org (Schoukens and
Noël 2016): 1024 samples at 4 s for estimation and as many for the test, pump voltage and level of
the lower tank.

The error is that of the benchmark: the rms error of the simulated level over all test samples. The
initial levels are unknown but the same in both parts, so those of the estimation are taken.

The structures are nested, and each adds what a look at the physics suggests. They are compared on
the data for estimation only; the one with the least AIC is run on the test data, once. Its upper
tank empties in proportion to its level, not to the root of it: k_1 ends at zero. So it predicts,
but its parameters are no longer those of Torricelli's law.

The published rows are those that Hammerstein Box-Jenkins System Identification of the Cascaded
Tanks Benchmark System (2021) collects in its table 2. Later ones may be better.
"""

import time
from pathlib import Path

import numpy as np
from command import estimates, heading, judged, parser, show

import greybox as gb

STEP = 4.0  # s
FULL = 10.0  # V, where the lower tank overflows and the sensor ends
STARTS = 10
PUBLISHED = {
    "published: best linear approximation": 0.757,
    "published: Volterra model": 0.540,
    "published: polynomial state space": 0.450,
    "published: nonlinear state space": 0.343,
}


def root(level):
    """Return the square root of a level, smooth below zero."""
    return gb.sqrt(gb.maximum(level, 0) + 1e-3)


def above(value, width):
    """Return a smooth maximum of a value and zero."""
    return (value + gb.sqrt(value**2 + width**2)) / 2


class Tanks(gb.StateSpace):
    r"""Level of the lower of two tanks from the voltage of the pump.

    $$\dot x_1 = k_u u - k_1 \sqrt{x_1} - l_1 x_1 - q, \quad \dot x_2 = k_1 \sqrt{x_1} + l_1 x_1 +
    s q - k_2 \sqrt{x_2} - l_2 x_2, \quad q = \max(x_1 - H, 0)$$

    The unit of $x_1$ is such that what leaves the upper tank enters the lower one. $l_1$ and $l_2$
    are losses beyond Torricelli's law.

    Source: Schoukens and Noël (2016), Cascaded tanks benchmark, with losses and overflow.
    """

    states = ("x1", "x2")
    inputs = ("u",)
    outputs = ("y",)
    units = {"u": "V", "y": "V"}
    k_1 = gb.Parameter(0.05, bounds=(0, 0.3), unit="√V/s", about="outflow of the upper tank")
    k_2 = gb.Parameter(0.05, bounds=(0, 0.3), unit="√V/s", about="outflow of the lower tank")
    k_u = gb.Parameter(0.05, bounds=(0, 0.3), unit="1/s", about="pump")
    l_1 = gb.Parameter(0.0, bounds=(-0.1, 0.1), unit="1/s", about="upper losses", fixed=True)
    l_2 = gb.Parameter(0.0, bounds=(-0.1, 0.1), unit="1/s", about="lower losses", fixed=True)
    H = gb.Parameter(1e3, bounds=(4, 1e4), unit="V", about="level of overflow", fixed=True)
    share = gb.Parameter(
        0.0, bounds=(0, 2), unit="1", about="overflow that reaches the lower tank", fixed=True
    )

    def derivative(self, x, u, p):
        """Return the rates of both levels."""
        overflow = above(x.x1 - p.H, 0.05)
        outflow = p.k_1 * root(x.x1) + p.l_1 * x.x1
        lower = p.k_2 * root(x.x2) + p.l_2 * x.x2
        return (p.k_u * u.u - outflow - overflow, outflow + p.share * overflow - lower)

    def output(self, x, u, p):
        """Return the measured level."""
        return (FULL - above(FULL - x.x2, 0.05),)


STRUCTURES = {
    "Torricelli": (),
    "and lower losses": ("l_2",),
    "and lower losses, overflow": ("l_2", "H", "share"),
    "and both losses, overflow": ("l_1", "l_2", "H", "share"),
}
BEGIN = {"H": 10.0, "share": 0.5}


def parts(folder: Path) -> tuple[gb.Record, gb.Record]:
    """Return the records for estimation and for the test."""
    table = np.genfromtxt(folder / "dataBenchmark.csv", delimiter=",", names=True)
    time_axis = STEP * np.arange(len(table))
    return tuple(
        gb.Record(
            time_axis,
            {"u": table[f"u{name}"], "y": table[f"y{name}"]},
            units={"u": "V", "y": "V"},
            hold={"u": np.inf, "y": 0.0},
            name=name,
        )
        for name in ("Est", "Val")
    )


def error(fit: gb.Fit, record: gb.Record) -> float:
    """Return the rms error of a free simulation from the estimated initial levels."""
    initial = {name: float(values[0]) for name, values in fit.records[0].initial.items()}
    flown = gb.simulate(Tanks(), fit.estimate, record, initial=initial)
    return float(np.sqrt(np.mean((flown["y"] - record["y"]) ** 2)))


def board(folder: Path) -> list[str]:
    """Return the lines of the table."""
    estimation, test = parts(folder)
    lines = [
        heading(),
        "",
        f"{'for estimation':32}    AIC  error, V  starts  seconds",
    ]
    fits = {}
    for label, free in STRUCTURES.items():
        begin = time.process_time()
        start = {name: BEGIN[name] for name in free if name in BEGIN}
        problem = gb.Problem(Tanks(), estimation, free=free, start=start)
        fit = fits[label] = gb.fit(problem, starts=STARTS, progress=False, profiles=False)
        seconds = time.process_time() - begin
        aic = 2 * fit.cost + 2 * (len(fit.free) + 3)  # two initial levels and a variance
        lines.append(
            f"{label:32}{aic:7.0f}{error(fit, estimation):10.3f}"
            f"{fit.agreeing:5} of {STARTS}{seconds:7.0f}"
        )

    best = min(fits, key=lambda label: fits[label].cost + len(fits[label].free))
    fit = fits[best]
    naive = float(np.sqrt(np.mean((test["y"] - estimation["y"].mean()) ** 2)))
    lines += ["", f"{'for test':40}error, V", f"{'naive: mean level':42}{naive:6.3f}"]
    lines += [f"{label:42}{value:6.3f}" for label, value in PUBLISHED.items()]
    lines += [f"{'chosen: ' + best:42}{error(fit, test):6.3f}", ""]
    lines += estimates(fit, Tanks().parameters)
    return [*lines, "", *(line for item in fits.items() for line in judged(*item))]


if __name__ == "__main__":
    show(board, parser(__doc__).parse_args())
