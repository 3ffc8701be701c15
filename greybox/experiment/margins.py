"""Stability margins of a fitted plant in the loop of its controllers, with their errors.

Begin with `margins`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.response_band import require_level
from greybox.estimate.result import Fit
from greybox.experiment.controller import Controller
from greybox.experiment.sampled_loop import SampledLoop, sampled_loop
from greybox.files.arrays import Array, BoolArray
from greybox.files.json_numbers import finite
from greybox.files.text_table import number, one_line, text_table
from greybox.modeling.model import Model

DRAWS = 512  # a quantile of 2.5 % is then known to 4 % of a standard error
POINTS = 400
DECADES = 4.0  # below the Nyquist frequency, within which crossings are looked for
UNITS = {
    "phase margin": "deg",
    "gain margin": "dB",
    "gain reduction margin": "dB",
    "delay margin": "s",
    "modulus margin": "",
    "crossover": "rad/s",
    "disturbance rejection bandwidth": "rad/s",
}


@dataclass(frozen=True)
class Margin:
    """One number of a loop.

    Attributes
    ----------
    name, unit : str
    value : float
        Infinite for a margin that no change of this kind uses up.
    low, high : float
        Ends of the confidence interval; NaN where there is none.
    omega : float, rad/s
        Where it is found.
    is_extrapolated : bool
        Whether that is outside the frequencies of the fitted data.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    omega: float
    is_extrapolated: bool = False


@dataclass(frozen=True, eq=False)
class Margins:
    """The margins of a loop broken at one signal. It prints itself, the verdict first.

    Attributes
    ----------
    plant, signal : str
        The model, and where its loop is broken.
    margins : tuple of Margin
        Empty for a loop that is not stable.
    is_stable : bool
        At the estimate.
    instability : float
        Probability that the loop is unstable, from the errors of the parameters.
        NaN without errors.
    level : float
        NaN without errors.
    notes : tuple of str
        Why an interval is missing, and what the fit warns of.
    """

    plant: str
    signal: str
    margins: tuple[Margin, ...]
    is_stable: bool
    instability: float
    level: float
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Margin:
        """Return a margin by its name, such as "phase margin"."""
        for margin in self.margins:
            if margin.name == name:
                return margin
        raise KeyError(
            f"there is no {name!r}; there are {', '.join(m.name for m in self.margins)}."
        )

    @property
    def is_safe(self) -> bool:
        """Whether the loop is stable, at the estimate and at this level."""
        return self.is_stable and not self.instability > (1 - self.level) / 2

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        loop = f"the loop of {self.plant}, broken at {self.signal},"
        if not self.is_stable:
            return f"{loop} is unstable: no margin exists."
        if not self.is_safe:
            return (
                f"{loop} is unstable with a probability of {100 * self.instability:.1f} %: "
                "the data do not show that it is safe."
            )
        phase, gain = self["phase margin"], self["gain margin"]
        beyond = "; the crossover is extrapolated" if self["crossover"].is_extrapolated else ""
        return (
            f"{loop} has a phase margin of {_with_interval(phase)} deg "
            f"and a gain margin of {_with_interval(gain)} dB{beyond}."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; None where unknown or infinite."""
        rows = {
            m.name: {key: finite(getattr(m, key)) for key in ("value", "low", "high", "omega")}
            | {"unit": m.unit, "extrapolated": m.is_extrapolated}
            for m in self.margins
        }
        return {
            "verdict": self.verdict,
            "plant": self.plant,
            "broken_at": self.signal,
            "stable": self.is_stable,
            "probability_unstable": finite(self.instability),
            "level": finite(self.level),
            "margins": rows,
            "notes": list(self.notes),
        }

    def __repr__(self) -> str:
        return one_line(self, self.verdict)

    def __str__(self) -> str:
        rows = [
            (
                m.name,
                number(m.value, 4),
                "-" if not math.isfinite(m.low) else f"{number(m.low, 4)} to {number(m.high, 4)}",
                m.unit,
                number(m.omega, 4) + (" *" if m.is_extrapolated else ""),
            )
            for m in self.margins
        ]
        interval = "" if math.isnan(self.level) else f"{100 * self.level:g} % interval"
        header = ("", "value", interval, "unit", "at rad/s")
        table = [text_table(header, rows)] if rows else []
        beyond = any(m.is_extrapolated for m in self.margins)
        legend = ["* outside the frequencies of the fitted data: extrapolated."] if beyond else []
        return "\n".join([self.verdict[0].upper() + self.verdict[1:], *table, *legend, *self.notes])


def margins(
    plant: Fit | Model,
    controller: Controller | Sequence[Controller],
    values: Mapping[str, float] | None = None,
    *,
    broken_at: str = "",
    at: Mapping[str, float] | None = None,
    part: int = 0,
    level: float = 0.95,
) -> Margins:
    """Return stability margins of a plant with sampled controllers, and their confidence intervals.

    The loop is that of `virtual_flight`: the controllers run at their rate, the control is held
    until the next sample, and the delay of the plant is exact. All margins are of the loop broken
    at one signal with every other loop closed:

    - *phase margin*: the smallest phase, lag or lead, that makes the loop unstable, in degrees;
    - *gain margin* and *gain reduction margin*: the smallest factors above and below one that do;
    - *delay margin*: the smallest additional delay that does;
    - *modulus margin*: the smallest distance of the loop gain from -1, the inverse of the peak of
      the sensitivity (the disturbance rejection peak);
    - *crossover*: the highest frequency at which the gain is one;
    - *disturbance rejection bandwidth*: where the sensitivity first reaches -3 dB.

    The intervals are quantiles over draws from the distribution of the estimates (Student's t), so
    they need not be symmetric, and hold where the standard errors of the fit do. They contain the
    errors of the parameters; not what the model leaves out, such as structural modes.

    Parameters
    ----------
    plant : Fit or Model
        A model has no errors, and its margins no intervals.
    controller : Controller or several
        With the gains that fly. The outputs of one may be the setpoints of the next.
    values : mapping of parameter name to float, optional
        Of a model; by default the declared starts.
    broken_at : str
        An input of the plant (the actuator; by default the first), a signal that a controller
        measures (the rate, the attitude), or one that a controller commands.
    at : mapping of name to float, optional
        The operating point of an ODE; by default that of the fitted part.
    part : int
        Whose model it is, in a fit of several problems.
    level : float

    Returns
    -------
    Margins

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is neither, and for values beside a fit.

    Notes
    -----
    A controller is linearized about its initial state: limits that are not reached play no part.
    The delay of a model that was fitted to a measured frequency response already contains the
    hold of the logged control, half a sample, which is not counted again.

    Sources: Franklin, Powell, Workman (1998), Digital Control of Dynamic Systems, section 4.3 (the
    sampled plant) and 7.4 (margins); ADS-33E-PRF and Tischler et al. (2017), Practical Methods for
    Aircraft and Rotorcraft Flight Control Design, section 3.3 (disturbance rejection).
    """
    require_level(level)
    if isinstance(plant, Fit):
        if values is not None:
            raise TypeError("values were given beside a Fit, which has its own: leave them out.")
        return _margins_of_fit(plant, controller, broken_at, at, part, level)
    if not isinstance(plant, Model):
        raise TypeError(f"{plant!r:.60} has no margins: give a Fit, or a model with its values.")
    row = np.array([list(plant.values(values).values())], dtype=float)
    loop = sampled_loop(plant, row, controller, at=at)
    signal = broken_at or loop.inputs[0]
    return _margins(plant.label, loop, signal, math.nan)


def _margins_of_fit(
    fit: Fit,
    controller: Controller | Sequence[Controller],
    broken_at: str,
    at: Mapping[str, float] | None,
    part: int,
    level: float,
) -> Margins:
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate: {fit.status}.")
    model, fitted = fit.model_of(part), fit.parts[part]
    is_response = isinstance(fitted, FittedResponse)
    values = _draws(fit, [fitted.rename.get(name, name) for name in model.parameters])
    loop = sampled_loop(
        model,
        values,
        controller,
        at=fitted.at if at is None and is_response else at,
        delay_has="hold" if is_response else "nothing",
    )
    signal = broken_at or loop.inputs[0]
    answer = _margins(model.label, loop, signal, level)
    warned = tuple(f"The fit warns: {warning}" for warning in fit.warnings)
    answer = replace(answer, notes=(*answer.notes, *warned))
    if not isinstance(fitted, FittedResponse):
        return answer
    omega = fitted.data.omega
    return replace(
        answer,
        margins=tuple(
            replace(m, is_extrapolated=bool(m.omega < omega[0] or m.omega > omega[-1]))
            for m in answer.margins
        ),
    )


def _margins(plant: str, loop: SampledLoop, signal: str, level: float) -> Margins:
    """Return the margins of the first plant, with intervals from the other ones."""
    is_stable = loop.is_stable
    drawn = slice(1, 1 + DRAWS)
    instability = 1 - float(np.mean(is_stable[drawn])) if len(is_stable) > 1 else math.nan
    answer = Margins(plant, signal, (), bool(is_stable[0]), instability, level)
    if not answer.is_stable:
        return answer

    omega = np.geomspace(10**-DECADES, 0.999, POINTS) * math.pi / loop.period
    tail = (1 - level) / 2
    rows, notes = [], []
    for name, (value, where) in _quantities(loop, signal, omega, is_stable).items():
        low = high = math.nan
        if not np.allclose(value[drawn.stop :], value[0], rtol=1e-3):
            notes.append(f"The {name} depends on what the data of the fit do not determine.")
        elif instability <= tail:
            low, high = np.quantile(value[drawn], [tail, 1 - tail], method="closest_observation")
        exact, place = _refined(loop.first, signal, name, value[0], where[0])
        rows.append(Margin(name, UNITS[name], exact, float(low), float(high), place))
    return replace(answer, margins=tuple(rows), notes=tuple(notes))


def _draws(fit: Fit, names: Sequence[str]) -> Array:
    """Return values (plants, parameters): the estimate, draws from its distribution, others.

    The others lie beside the estimate in directions of which the data say nothing.
    """
    from scipy.special import chdtri, ndtri  # noqa: PLC0415  (takes a tenth of a second to import)
    from scipy.stats import qmc  # noqa: PLC0415  (takes a third of a second to import)

    if fit.directions is None:
        raise ValueError(
            f"the fit {fit.name!r} has no covariance, so that margins would have no errors: "
            "its data leave no degrees of freedom; add data or fix parameters."
        )
    lines = {q.name: q for q in fit.quantities}
    center = np.array([lines[name].value for name in names])
    known = fit.directions.of([fit.names.index(name) for name in names])
    variances, axes = np.linalg.eigh(known.covariance)
    root = axes * np.sqrt(np.maximum(variances, 0))
    dof = min((lines[n].dof for n in names if lines[n].standard_error > 0), default=fit.dof)

    shares = qmc.Sobol(len(names) + 1, rng=np.random.default_rng(0)).random(DRAWS)
    shares = np.clip(shares, 1e-9, 1 - 1e-9)
    normal = ndtri(shares[:, :-1]) @ root.T
    widening = np.sqrt(dof / chdtri(dof, shares[:, -1])) if math.isfinite(dof) else np.ones(DRAWS)
    bias = np.array([lines[name].bias for name in names])
    drawn = center - bias + normal * widening[:, None]
    beside = center + 0.1 * (known.size[:, None] * known.unseen).T

    limits = np.array([lines[name].bounds for name in names]).T
    return np.clip(np.vstack([center, drawn, beside]), *limits)


def _quantities(
    loop: SampledLoop, signal: str, omega: Array, is_stable: BoolArray
) -> dict[str, tuple[Array, Array]]:
    """Return every quantity (plants,) with its frequency, from the loop gain at `omega` (n,)."""
    gain = loop.broken_at(signal, omega)
    x = np.log(omega)
    with np.errstate(divide="ignore"):
        size = np.log(np.abs(gain))
    phase = np.unwrap(np.angle(gain), axis=1)

    # Where the gain is one, and how far the phase is from -180 degrees there.
    crosses, share = _crossings(size)
    lag = np.mod(_between(phase, share) + math.pi, 2 * math.pi)
    at = np.exp(x[:-1] + share * np.diff(x))
    answer = {
        "phase margin": _smallest(np.degrees(np.minimum(lag, 2 * math.pi - lag)), crosses, at)
    }

    # Where the gain is real and negative.
    real_axis, part = _crossings(gain.imag)
    real_axis &= _between(gain.real, part) < 0
    decibels = -20 / math.log(10) * _between(size, part)
    place = np.exp(x[:-1] + part * np.diff(x))
    answer["gain margin"] = _smallest(decibels, real_axis & (decibels > 0), place)
    answer["gain reduction margin"] = _smallest(-decibels, real_axis & (decibels < 0), place)
    answer["delay margin"] = _smallest(lag / at, crosses, at)

    distance = np.abs(1 + gain)
    nearest = distance.argmin(axis=1)
    answer["modulus margin"] = (distance.min(axis=1), omega[nearest])
    last = _smallest(-at, crosses, at)
    answer["crossover"] = (-last[0], last[1])
    rejects, share = _crossings(distance - math.sqrt(2))
    at = np.exp(x[:-1] + share * np.diff(x))
    answer["disturbance rejection bandwidth"] = _smallest(at, rejects, at)

    # An unstable loop has used its margins up.
    for name in (
        "phase margin",
        "gain margin",
        "gain reduction margin",
        "delay margin",
        "modulus margin",
    ):
        answer[name] = (np.where(is_stable, answer[name][0], 0.0), answer[name][1])
    return answer


def _crossings(values: Array) -> tuple[BoolArray, Array]:
    """Return between which neighbors (plants, n - 1) the sign changes, and where between them."""
    before, after = values[:, :-1], values[:, 1:]
    changes = (before < 0) != (after < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(changes, before / (before - after), 0.0)
    return changes, share


def _between(values: Array, share: Array) -> Array:
    return values[:, :-1] + share * np.diff(values, axis=1)


def _smallest(values: Array, where: BoolArray, omega: Array) -> tuple[Array, Array]:
    """Return the smallest value that counts in each row, and its frequency; inf, NaN for none."""
    counted = np.where(where, values, math.inf)
    place = counted.argmin(axis=1)
    rows = np.arange(len(counted))
    value = counted[rows, place]
    frequency = np.broadcast_to(omega, counted.shape)[rows, place]
    return value, np.where(np.isfinite(value), frequency, math.nan)


def _refined(
    loop: SampledLoop, signal: str, name: str, value: float, omega: float
) -> tuple[float, float]:
    """Return a quantity of the first plant and its frequency, to rounding."""
    width = DECADES * math.log(10) / POINTS
    while math.isfinite(omega) and width > 1e-9:
        top = 0.9999 * math.pi / loop.period
        near = np.minimum(omega * np.exp(np.linspace(-1.5, 1.5, 100) * width), top)
        found = _quantities(loop, signal, np.unique(near), np.ones(1, dtype=bool))[name]
        if not math.isfinite(found[0][0]):
            break
        value, omega, width = float(found[0][0]), float(found[1][0]), width / 30
    return float(value), float(omega)


def _with_interval(margin: Margin) -> str:
    if not math.isfinite(margin.value):
        return "infinity"
    if not (math.isfinite(margin.low) and math.isfinite(margin.high)):
        return number(margin.value, 3)
    return f"{number(margin.value, 3)} ({number(margin.low, 3)} to {number(margin.high, 3)})"
