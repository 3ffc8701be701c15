"""The paper's open question, in simulation: where the linear structure stops, and what restores it.

python benchmarks/operating_points.py [--output FILE]

The truth is `TiltMoment`, (4.23) with three more terms of the moment, fitted to the paper's tables
in hover and about 5°. It agrees with the tables there; what it says at 10° and more is an
extrapolation, and so is every number here about such angles. The vehicle flies at constant height
without wind, so that an angle has one speed and one thrust.

1. Each angle: the linear model (4.25) that the truth has there, and the error of the model of
   hover.
2. Responses at six angles with errors of 3 %, one joint fit of (4.25) with a1 to a4 as polynomials
   of speed, angle or thrust: BIC, and the order at which a test finds no further term.
3. The same for the two angles of the paper.
4. Which flights determine all six terms of the moment, among sines about these angles and flights
   that speed up and brake: all sets of up to three of them, flown equally often.
"""

import argparse
import datetime as dt
import itertools
import math
import platform
from pathlib import Path

import numpy as np

import greybox as gb
from greybox.models.controller import AttitudeController
from greybox.models.moment import MOMENT_TERMS, TiltMoment, TiltMomentAt
from greybox.models.tilt import PAPER_G, TiltParameters
from greybox.problems import pitch_5deg, pitch_moment
from greybox.problems.pitch_operating_points import DRAG

ANGLES = (0.0, 2.5, 5.0, 10.0, 15.0, 20.0)  # degrees
SMALL = (0.1, 0.5, 1.0)  # degrees, for the first table
ERROR = 0.03  # of a point, relative: that of the paper's tables is 0.04 to 0.06
OMEGA = pitch_5deg.data().omega
ORDER = 2  # the highest polynomial that is tried
COEFFICIENTS = ("a1", "a2", "a3", "a4")
LIMIT = 0.01  # of a p-value, below which a higher order is taken
SINE_TIME = 10.0  # s a frequency, with its settling
SCHEDULED = ("speed", "angle", "thrust")


def speed(angle: float) -> float:
    """Return the speed of level flight at this angle, m/s."""
    return math.sqrt(PAPER_G * math.tan(angle) / DRAG)


def scheduled(variable: str, angle: float) -> float:
    """Return the variable, 0 in hover and 1 at the largest angle."""
    largest = math.radians(max(ANGLES))
    value = {
        "speed": speed,
        "angle": float,
        "thrust": lambda angle: 1 / math.cos(angle) - 1,
    }[variable]
    return value(angle) / value(largest)


class Envelope(gb.TransferFunction):
    r"""The tilt angle, (4.25), with $a_1$ to $a_4$ as polynomials of a scheduled variable.

    $$a_k = a_{k,0} + a_{k,1} x + a_{k,2} x^2$$
    """

    input, output = "u", "theta"
    T_rotor, T_delay = TiltParameters.T_rotor, TiltParameters.T_delay
    a1 = gb.Parameter(-10.0, bounds=(-200, 200), unit="1/s²", about="stiffness")
    a2 = gb.Parameter(3.0, bounds=(-50, 50), unit="1/s", about="damping")
    a3 = gb.Parameter(8.0, bounds=(-50, 50), unit="1/(m·s)", about="acceleration per velocity")
    a4 = gb.Parameter(290.0, bounds=(1, 2000), unit="1/s²", about="acceleration per control")
    a1_1 = gb.Parameter(0.0, bounds=(-5000, 5000), unit="1/s²", about="a1, x", fixed=True)
    a2_1 = gb.Parameter(0.0, bounds=(-1000, 1000), unit="1/s", about="a2, x", fixed=True)
    a3_1 = gb.Parameter(0.0, bounds=(-5000, 5000), unit="1/(m·s)", about="a3, x", fixed=True)
    a4_1 = gb.Parameter(0.0, bounds=(-5000, 5000), unit="1/s²", about="a4, x", fixed=True)
    a1_2 = gb.Parameter(0.0, bounds=(-5000, 5000), unit="1/s²", about="a1, x²", fixed=True)
    a2_2 = gb.Parameter(0.0, bounds=(-1000, 1000), unit="1/s", about="a2, x²", fixed=True)
    a3_2 = gb.Parameter(0.0, bounds=(-5000, 5000), unit="1/(m·s)", about="a3, x²", fixed=True)
    a4_2 = gb.Parameter(0.0, bounds=(-5000, 5000), unit="1/s²", about="a4, x²", fixed=True)

    def __init__(self, variable: str = "speed", angle: float = 0.0):
        self.variable, self.angle = variable, angle

    def response(self, s, p):
        """Return (4.25) with the coefficients of this angle."""
        x = scheduled(self.variable, self.angle)
        a1, a2, a3, a4 = (
            getattr(p, name) + (getattr(p, f"{name}_1") + getattr(p, f"{name}_2") * x) * x
            for name in COEFFICIENTS
        )
        a5 = 2 * DRAG * speed(self.angle)
        coupling = PAPER_G / math.cos(self.angle) ** 2 * a3
        tilt = (s + a5) / ((s + a5) * (s**2 + a2 * s + a1) + coupling)
        return a4 * tilt / (p.T_rotor * s + 1) * gb.exp(-s * p.T_delay)


def terms(order: int) -> tuple[str, ...]:
    """Return the names of the coefficients of this power of the scheduled variable."""
    return tuple(f"{name}_{order}" for name in COEFFICIENTS)


def joint(
    variable: str, responses: dict[float, gb.FrequencyResponse], order: int, starts: int = 5
) -> gb.Fit:
    """Fit the envelope to all responses."""
    free = [name for k in range(1, order + 1) for name in terms(k)]
    parts = [
        gb.Problem(Envelope(variable, math.radians(angle)), data, gb.MaximumLikelihood(), free=free)
        for angle, data in responses.items()
    ]
    return gb.fit(sum(parts[1:], parts[0]), starts=starts, progress=False)


def measured(truth: dict[str, float], angle: float, random: np.random.Generator | None = None):
    """Return the response at an angle in degrees, with errors if there is a generator."""
    exact = gb.frequency_response(TiltMomentAt(math.radians(angle), DRAG), truth, OMEGA).response
    sigma = ERROR * np.abs(exact)
    if random is not None:
        errors = random.normal(size=(2, OMEGA.size)) * sigma / np.sqrt(2)
        exact = exact + errors[0] + 1j * errors[1]
    response = gb.FrequencyResponse(
        OMEGA, exact, input="u", output="theta", variance=sigma**2, name=f"{angle:g}°"
    )
    return response.with_independent_errors()  # of sines one after another


def relative(response: np.ndarray, exact: np.ndarray) -> float:
    """Return the rms of the relative error in percent."""
    return 100 * float(np.sqrt(np.mean(np.abs(response / exact - 1) ** 2)))


def angles(truth: dict[str, float]) -> list[str]:
    """Return the first table."""
    hover = measured(truth, 0.0).response
    lines = ["angle  speed    a1     a2     a3     a4   hover model"]
    for angle in sorted((*SMALL, *ANGLES)):
        exact = measured(truth, angle).response
        own = joint("speed", {angle: measured(truth, angle)}, 0).estimate
        lines.append(
            f"{angle:4g}° {speed(math.radians(angle)):6.1f} "
            + " ".join(f"{own[name]:6.1f}" for name in COEFFICIENTS)
            + f"{relative(hover, exact):10.0f} %"
        )
    return lines


def orders(truth: dict[str, float], flown: tuple[float, ...], seed: int = 0) -> list[str]:
    """Return the second table, for these angles in degrees."""
    random = np.random.default_rng(seed)
    responses = {angle: measured(truth, angle, random) for angle in flown}
    highest = min(ORDER, len(flown) - 1)
    columns = "".join(f"BIC, order {k}   " for k in range(highest + 1))
    lines = [f"variable   {columns}by test   explains all"]
    for variable in SCHEDULED:
        fits = [joint(variable, responses, order) for order in range(highest + 1)]
        count = 2 * OMEGA.size * len(flown)
        bic = [2 * fit.cost + len(fit.free) * math.log(count) for fit in fits]
        tests = [gb.validation.nested_test(*pair).p_value for pair in itertools.pairwise(fits)]
        needed = next((k for k, p_value in enumerate(tests) if p_value > LIMIT), highest)
        misfit = fits[-1].misfit
        explains = "yes" if misfit is None or misfit.explains else "no"
        lines.append(
            f"{variable:9}"
            + "".join(f"{value:14.0f}" for value in bic)
            + f"{needed:12}{explains:>15}"
        )
    return lines


def flights(truth: dict[str, float]) -> list[str]:
    """Return the plan."""
    values = {name: truth[name] for name in (*COEFFICIENTS, *MOMENT_TERMS)}
    tests: dict = {
        f"sines about {angle:g}°": (
            gb.Problem(
                TiltMomentAt(math.radians(angle), DRAG),
                measured(truth, angle),
                gb.MaximumLikelihood(),
                free=MOMENT_TERMS,
            ),
            SINE_TIME * OMEGA.size,
        )
        for angle in ANGLES
    }
    for degrees in (5.0, 10.0):
        excitation = gb.experiment.sine_schedule(
            (0.3, 1.0), math.radians(degrees), periods=2, least=10, signal="reference", rate=50
        )
        flown = gb.virtual_flight(
            TiltMoment(),
            values | {"C_x": DRAG},
            excitation,
            controller=AttitudeController(rate=50),
            noise={"theta": 0.002, "v": 0.05},
            seed=0,
        )
        tests[f"speed up and brake, ±{degrees:g}°"] = (
            gb.Problem(TiltMoment(), flown, free=MOMENT_TERMS, fixed={"C_x": DRAG}),
            flown.duration,
        )
    wanted = {name: 0.1 * abs(truth[name]) for name in ("b_vv", "b_vtheta", "b_vtau")} | {
        "b_thetatheta": 30.0,  # 1/s²: as much at 5° as a tenth of b_vtheta
        "b_vq": 0.05,  # 1/m
        "b_thetaq": 5.0,  # 1/s
    }
    errors = np.array([*wanted.values()])
    information = {}
    for name, (problem, _) in tests.items():
        expected = gb.experiment.expected_errors(problem, values)
        information[name] = expected.information
        places = [[*expected.standard_error].index(parameter) for parameter in wanted]

    lines = []
    sines = [name for name in tests if name.startswith("sines")]
    for label, names in (("sines only", sines), ("all", [*tests])):
        plans = []
        for count in (1, 2, 3):
            for chosen in itertools.combinations(names, count):
                together = sum(information[name] for name in chosen)
                if np.linalg.cond(scaled(together)) > 1e10:
                    continue
                variances = np.diag(np.linalg.inv(together))[places]
                repeats = math.ceil(np.max(variances / errors**2))
                seconds = repeats * sum(tests[name][1] for name in chosen)
                plans.append((seconds, f"{repeats} times each: {', '.join(chosen)}"))
        lines.append(f"{label}:")
        lines += [f"{seconds:8.0f} s  {text}" for seconds, text in sorted(plans)[:5]]
        lines.append("")
    return lines


def scaled(information: np.ndarray) -> np.ndarray:
    """Return an information matrix with a unit diagonal, whatever the units of the parameters."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return information / np.outer(size, size)


def study() -> list[str]:
    """Return all tables."""
    fit = gb.fit(pitch_moment.problem(), starts=20, progress=False)
    truth = {name: fit.estimate[name] for name in TiltMomentAt().parameters}
    return [
        f"greybox {gb.__version__}, Python {platform.python_version()}, {dt.date.today()}",
        "",
        "1. each angle",
        *angles(truth),
        "",
        f"2. a joint fit of the responses at {', '.join(f'{a:g}°' for a in ANGLES)}",
        *orders(truth, ANGLES),
        "",
        "3. a joint fit of 0° and 5°",
        *orders(truth, (0.0, 5.0)),
        "",
        "4. flights that determine all six terms",
        *flights(truth),
    ]


def main() -> None:
    """Print the tables, and write them to a file on request."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    text = "\n".join(study())
    print(text)
    if options.output:
        options.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
