"""The answer: estimates, errors, all runs and warnings, in plain values that print themselves."""

import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.pandas_frames import Frame, frame_of
from greybox.data.record import Record, share_samples
from greybox.estimate.fitted_part import FittedPart, FittedRecord, FittedResponse, FittedSpectrum
from greybox.estimate.identifiability import (
    Identifiability,
    KnownDirections,
    correlation,
    identifiability,
)
from greybox.estimate.profiles import Profiles
from greybox.estimate.response_band import (
    ResponseBand,
    band_of,
    require_level,
    response_and_slope,
    t_quantile,
)
from greybox.estimate.sensitivity import Sensitivity, sensitivity
from greybox.estimate.summary import summary
from greybox.files.arrays import Array
from greybox.files.html_text import html_list, html_table, html_text
from greybox.files.text_table import (
    alternatives,
    counted,
    number,
    one_line,
    some,
    text_table,
    with_error,
)
from greybox.formulation.included_criteria import CRITERIA
from greybox.formulation.input_assumptions import Inputs
from greybox.formulation.restated_parameter import restated
from greybox.formulation.spectrum_criteria import EquationError
from greybox.modeling.model import Model
from greybox.modeling.model_reference import reference, resolve
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.periodic_motions import response_of_test
from greybox.modeling.realization import dynamics
from greybox.simulation.model_at_estimate import ModelAtEstimate, criterion_of
from greybox.solve.minima import Minimum, Multistart, agreeing_runs, best_unfinished
from greybox.solve.runs import Runs
from greybox.statistics.metrics import rms

# The included criteria in words, by name: `Fit.costs` has names alone.
RULES = {criterion.name: criterion.description for criterion in CRITERIA}

MANY = 10  # records up to which the text has a line for each; what it leaves out is in `Fit.records` and `quantities`
WORST = 3  # records that are named where there are more
BIASED = 0.3  # of a standard error: a bias from which an interval that does not allow for it loses 1 % of its coverage


@dataclass(frozen=True)
class Quantity:
    """One line of the answer.

    Attributes
    ----------
    name, unit, about : str
    value, standard_error : float
        NaN for what is not known.
    kind : "free", "fixed", "tied" or "derived"
    bounds, box : (float, float)
        Of the estimate, and of the starts that were drawn.
    at_bound : bool
    dof : float
        Degrees of freedom of Student's t for its interval.
    bias : float
        Of the value, by what a relative criterion divides by: noise makes a gain over the measured
        magnitude too low, over the model's too high. To first order in the variance of the errors.
        The value has it; intervals are about the value without it.
    """

    name: str
    value: float
    standard_error: float
    kind: Literal["free", "fixed", "tied", "derived"]
    unit: str = ""
    about: str = ""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    at_bound: bool = False
    dof: float = math.inf
    box: tuple[float, float] = (-math.inf, math.inf)
    bias: float = 0.0

    def __repr__(self) -> str:
        value, error = with_error(self.value, self.standard_error)
        return one_line(self, f"{self.name} = {value} ± {error} {self.unit}", self.kind)


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of all starts of a problem. Printing it answers the reader's questions in order.

    It holds plain values only, so that a saved one loads without the model. `runs` and `minima` are
    those of the multistart, and the runs are columns besides, as in ``fit.runs.cost``; vectors
    follow `free`.

    Attributes
    ----------
    name : str
        Of the problem.
    quantities : tuple of Quantity
        Free, fixed and tied parameters, then derived quantities.
    names, covariance : tuple of str, (k, k) array
        Of free, fixed and tied parameters.
    dof : float
        Numbers in the data less the directions of parameter space that they determine. A record
        counts as its equivalent number of independent residuals, less its unknown initial states,
        whether its noise is given or not, since standard errors use the residual variance; fewer
        where the spectrum of the residuals is uncertain. Infinite where all data are frequency
        responses with given variances (`MaximumLikelihood`).
    cost : float
        The criterion minimized, without smoothing; NaN when no start converged.
    costs : mapping of str to float
        The value of every included criterion at the estimate, by its name (``relative-error``); NaN
        where the data do not hold what it needs. Empty for fits with records.
    white : (p, p) array or None
        What the covariance of the free parameters would be if the cost were the likelihood of white
        errors.
    independent : (p, p) array and float, or None
        What covariance and degrees of freedom would be if the errors of responses were independent
        along frequency; None where they are.
    directions : KnownDirections or None
        The covariance of the free parameters within the directions that the data determine, and the
        other directions.
    known : KnownDirections or None
        The same of all `names`, with what ended at a bound as known: the errors of whatever depends
        on them follow.
    profiles : Profiles or None
        Of the parameters whose standard error misleads; None where there are none, or they were not
        asked for.
    equivalents : (v, p) array or None
        Clearly different vectors of the free parameters that give the best response, the estimate
        first: two lags that change places, or signs that change together, make two. None without an
        estimate.
    priors : mapping of name to (float, float)
        Mean and standard deviation of what was known of parameters before the data: the estimate is
        then the maximum a posteriori one. One of the `parts` stands for it.
    warnings, notes : tuple of str
        What to know before believing the estimate; and what may be worth a look.
    command : tuple of str
        The arguments of the command ``greybox`` that made it; empty where it was made from Python.
    models, given : tuple of Model or None, tuple of Model or class
        The models that were fitted; None for a loaded fit, whose models are those of greybox and
        those given to `load`.
    """

    name: str
    parts: tuple[FittedResponse | FittedRecord | FittedSpectrum, ...]
    quantities: tuple[Quantity, ...]
    free: tuple[str, ...]
    names: tuple[str, ...]
    covariance: Array
    dof: float
    cost: float
    costs: Mapping[str, float]
    runs: Runs
    minima: tuple[Minimum, ...]
    warnings: tuple[str, ...]
    seed: int | None
    starts: str
    seconds: float
    versions: Mapping[str, str]
    models: tuple[Model, ...] | None = field(default=None, repr=False)
    given: tuple[Model | type[Model], ...] = field(default=(), repr=False)
    white: Array | None = field(default=None, repr=False)
    independent: tuple[Array, float] | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()
    directions: KnownDirections | None = field(default=None, repr=False)
    profiles: Profiles | None = field(default=None, repr=False)
    known: KnownDirections | None = field(default=None, repr=False)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    equivalents: Array | None = field(default=None, repr=False)
    command: tuple[str, ...] = field(default=(), repr=False)

    @property
    def responses(self) -> tuple[FittedResponse, ...]:
        """The parts whose data are frequency responses."""
        return tuple(part for part in self.parts if isinstance(part, FittedResponse))

    @property
    def records(self) -> tuple[FittedRecord, ...]:
        """The parts whose data are records."""
        return tuple(
            part for part in self.parts if isinstance(part, FittedRecord) and not part.is_prior
        )

    @property
    def spectra(self) -> tuple[FittedSpectrum, ...]:
        """The parts whose data are spectra of manoeuvres."""
        return tuple(part for part in self.parts if isinstance(part, FittedSpectrum))

    @property
    def converged(self) -> bool:
        """True when at least one start converged, so that there is an answer."""
        return bool(self.minima)

    @property
    def status(self) -> str:
        """The word "converged", or why there is no answer."""
        if self.converged:
            return "converged"
        return f"no start converged ({Multistart(self.runs, (), 0.0).failures})"

    @property
    def agreeing(self) -> int:
        """How many runs ended at a cost that cannot be told from the best one: 0.1 in log-likelihood, or its equal."""
        numbers = sum(2 * len(part.data) for part in self.responses)
        is_likelihood = any(part.is_likelihood for part in self.parts)
        return len(
            agreeing_runs(self.runs, self.minima, numbers=numbers, is_likelihood=is_likelihood)
        )

    @property
    def prior_share(self) -> dict[str, float]:
        """Which share the a-priori knowledge has in what is known of each free parameter, 0 to 1; the rest the data.

        Of the information on a parameter with the others estimated along, for independent errors.
        NaN where the fit has no standard error; empty without a prior.
        """
        found = [
            part.information
            for part in self.parts
            if part.is_prior and part.information is not None
        ]
        if not found:
            return {}
        shares = np.sum([each.sum(axis=1) for each in found], axis=0)
        return dict(zip(self.free, shares.tolist(), strict=True))

    @property
    def criterion(self) -> str:
        """The name of the criterion that was minimized, such as ``relative-error``; of several, joined by "; "."""
        return "; ".join(dict.fromkeys(part.criterion for part in self.parts))

    @property
    def rule(self) -> str:
        """The criterion that was minimized, in words."""
        return "; ".join(dict.fromkeys(part.rule for part in self.parts))

    @property
    def delay(self) -> str:
        """How delays were evaluated."""
        return "; ".join(dict.fromkeys(part.delay for part in self.parts))

    @property
    def estimate(self) -> dict[str, float]:
        """Values of free, fixed and tied parameters by name."""
        return {q.name: q.value for q in self.quantities if q.kind != "derived"}

    @property
    def best_effort(self) -> dict[str, float] | None:
        """Of a fit that failed, the values at which its best run ended, of free and fixed parameters by name.

        They are no estimate and have no errors. None where there is an estimate, or where no run
        ended at a finite cost.
        """
        run = None if self.converged else best_unfinished(self.runs)
        if run is None:
            return None
        ended = dict(zip(self.free, run.estimate.tolist(), strict=True))
        return {
            q.name: ended.get(q.name, q.value)
            for q in self.quantities
            if q.kind in ("free", "fixed")
        }

    @property
    def derived(self) -> dict[str, float]:
        """Values of the derived quantities by name."""
        return {q.name: q.value for q in self.quantities if q.kind == "derived"}

    @property
    def standard_error(self) -> dict[str, float]:
        """Standard errors by name, of derived quantities too; NaN where the data give none, 0 for a constant."""
        return {q.name: q.standard_error for q in self.quantities}

    @property
    def identifiability(self) -> Identifiability:
        """Errors and insensitivities in percent, correlations, and what is determined only in combination.

        Raises
        ------
        ValueError
            If the fit has no estimate, or was saved before files kept what this needs.
        """
        free = {q.name: q for q in self.quantities if q.kind == "free"}
        return identifiability(
            self.free,
            [free[name].unit for name in self.free],
            self._known_directions(),
            [name for name in self.free if free[name].at_bound],
        )

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p) of the free parameters; NaN for those without a standard error."""
        at_bound = {q.name for q in self.quantities if q.at_bound}
        return correlation(
            self._known_directions(),
            np.array([name not in at_bound for name in self.free], dtype=bool),
        )

    def _known_directions(self) -> KnownDirections:
        if not self.converged:
            raise ValueError(f"the fit {self.name!r} has no estimate: {self.status}.")
        if self.directions is None:
            raise ValueError(
                f"the fit {self.name!r} has no covariance from which to judge this: fit it again."
            )
        return self.directions

    @property
    def checksum(self) -> str:
        """Checksums of the data of all parts."""
        return " ".join(part.data.checksum for part in self.parts)

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return confidence intervals by Student's t, by name; NaN where there is no standard error.

        About the values less their `Quantity.bias`.
        """
        intervals = {}
        for q in self.quantities:
            if q.kind == "fixed" and not q.standard_error > 0:
                continue
            half = t_quantile(level, q.dof) * q.standard_error
            center = q.value - q.bias
            intervals[q.name] = (center - half, center + half)
        return intervals

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Return the covariance matrix of the named parameters."""
        for name in names:
            if name not in self.names:
                raise ValueError(
                    f"the fit has no parameter {name!r} with a covariance; it has {alternatives(name, self.names)}"
                )
        rows = [self.names.index(name) for name in names]
        return self.covariance[np.ix_(rows, rows)]

    def at_estimate(
        self,
        model: Model | None = None,
        *,
        inputs: Inputs | None = None,
        part: int | None = None,
        record: Record | None = None,
    ) -> ModelAtEstimate:
        """Return the model of a part, or another one of the same parameters, at the estimate.

        Parameters
        ----------
        model : Model, optional
            By default the one that was fitted; of a loaded fit, one that greybox includes or that
            was given to `load`.
        inputs : "record", "linear" or "held", optional
            How inputs run between samples; by default as in the fit.
        part : int, optional
            By default the one of `record`, else the first record, of this model if there is one.
        record : Record, optional
            What the model is to be run on.

        Raises
        ------
        ValueError
            If the fit did not converge, or has no value for a parameter of the model.
        LookupError
            If a loaded fit does not know the model.
        """
        if not self.converged:
            raise ValueError(f"the fit {self.name!r} has no estimate: {self.status}.")
        k = _part_index(self, model, part, record)
        if model is None:
            model = self.model_of(k)
        return _at_estimate(self, model, self.parts[k], inputs)

    def model_of(self, part: int = 0) -> Model:
        """Return the model of a part; of a loaded fit one that greybox includes, or that was given to `load`.

        Raises
        ------
        LookupError
            If a loaded fit does not know it; the sentence has the cure.
        """
        return self.models[part] if self.models else resolve(self.parts[part].model, self.given)

    def response(
        self, omega: ArrayLike, part: int = 0, model: Model | None = None
    ) -> FrequencyResponse:
        """Evaluate the fitted model of a part at `omega` (n,) rad/s.

        A loaded fit knows the models that greybox includes and those given to `load`; otherwise
        give the `model`.

        Raises
        ------
        LookupError
            If a loaded fit does not know the model; the sentence has the cure.
        """
        stated, model = self._response_part(part, model)
        values = {name: self.estimate[stated.rename.get(name, name)] for name in model.parameters}
        return response_of_test(
            model,
            values,
            omega,
            stated.sine,
            stated.data.omega,
            input=stated.data.input,
            output=stated.data.output,
            at=stated.at,
            delay=stated.delay,
        )

    def to_dict(self, level: float = 0.95) -> dict[str, Any]:
        """Return the numbers as plain values, as ``greybox fit --json`` gives them: None for what is not known.

        Estimates, standard errors, intervals of this `level`, bounds, units and fixed values are
        mappings by name; ``covariance`` has ``names`` and rows of ``values``. `save` keeps the
        whole fit.
        """
        return summary(self, level)

    def to_json(self, level: float = 0.95) -> str:
        """Return `to_dict` as a JSON object, indented, without NaN."""
        return json.dumps(self.to_dict(level), allow_nan=False, ensure_ascii=False, indent=2)

    def to_pandas(self, level: float = 0.95) -> Frame:
        """Return a row for every parameter and derived quantity as a pandas data frame.

        Its index is the name; its columns are ``value, standard_error``, the ends ``low, high`` of
        the interval of this `level`, ``unit, kind, lower_bound, upper_bound, at_bound, about``.

        Raises
        ------
        ModuleNotFoundError
            Without pandas, ``pip install 'greybox-id[pandas]'``.
        """
        intervals = self.interval(level)
        ends = np.array(
            [intervals.get(q.name, (math.nan, math.nan)) for q in self.quantities]
        ).reshape(-1, 2)
        bounds = np.array([q.bounds for q in self.quantities]).reshape(-1, 2)
        columns = {
            name: [getattr(q, name) for q in self.quantities]
            for name in ("value", "standard_error")
        }
        columns |= {"low": ends[:, 0], "high": ends[:, 1]}
        columns |= {name: [getattr(q, name) for q in self.quantities] for name in ("unit", "kind")}
        columns |= {"lower_bound": bounds[:, 0], "upper_bound": bounds[:, 1]}
        columns |= {
            name: [getattr(q, name) for q in self.quantities] for name in ("at_bound", "about")
        }
        about = {"name": self.name, "criterion": self.criterion, "cost": self.cost, "level": level}
        return frame_of(columns, [q.name for q in self.quantities], "name", about)

    def _repr_html_(self) -> str:
        return _html(self)

    def _response_part(self, part: int, model: Model | None) -> tuple[FittedResponse, Model]:
        """Return a part that is a frequency response, and its model where none is given."""
        stated = self.parts[part]
        if not isinstance(stated, FittedResponse):
            raise ValueError(
                f"part {part} of the fit is no response: use gb.frequency_response(model, fit.estimate, omega), or "
                "gb.simulate for time histories."
            )
        if model is None:
            model = self.model_of(part)
        return stated, model

    @property
    def residuals(self) -> tuple[NDArray[Any], ...]:
        """Measured less fitted values of every part.

        Of a response (n,) complex, of a record (outputs, n), of a manoeuvre (outputs, n) complex.
        Those of a record are NaN where nothing was compared; `plotting.residuals` draws them.
        """
        return tuple(
            part.data.response - part.response
            if isinstance(part, FittedResponse)
            else np.array([part.residual(name) for name in part.outputs])
            for part in self.parts
        )

    def response_band(
        self,
        omega: ArrayLike | None = None,
        level: float = 0.95,
        part: int = 0,
        model: Model | None = None,
    ) -> ResponseBand:
        """Return the fitted response of a part at `omega` (n,) rad/s with its confidence band at each frequency.

        To first order in the errors of the parameters, whose covariance is that of the criterion:
        the band holds where the standard errors do. By default at the frequencies of the curve in
        figures.

        Raises
        ------
        ValueError
            If the fit has no estimate or no covariance, or the part is a record (`output_band`).
        LookupError
            If a loaded fit does not know the model; the sentence has the cure.
        """
        stated, model = self._response_part(part, model)
        known = self._known_errors()
        if omega is None:
            omega = stated.data.omega if stated.sine or stated.curve is None else stated.curve.omega
        require_level(level)
        names = [stated.rename.get(name, name) for name in model.parameters]
        response, slope = response_and_slope(
            model,
            {
                name: self.estimate[outside]
                for name, outside in zip(model.parameters, names, strict=True)
            },
            np.atleast_1d(np.asarray(omega, dtype=float)),
            stated.sine,
            stated.data.omega,
            input=stated.data.input,
            output=stated.data.output,
            at=stated.at,
            delay=stated.delay,
        )
        places = [self.names.index(name) for name in names]
        of_all = {q.name: q.bias for q in self.quantities}
        bias = np.array([of_all[name] for name in names])
        return band_of(response, slope, known, places, level, self._fewest_degrees(names), bias)

    def output_band(
        self, level: float = 0.95, part: int | None = None
    ) -> dict[str, tuple[Array, Array]]:
        """Return the lower and upper limit (n,) of the confidence band of every fitted output of a record, by its name.

        To first order in the errors of the parameters and of the initial states: within lies, at
        each sample by itself, what the output would be without noise, if the model structure is
        right. NaN where nothing was compared.

        Parameters
        ----------
        level : float
        part : int, optional
            Which part of the fit, by default the first record.

        Raises
        ------
        ValueError
            If the fit has no estimate or no covariance, or the part is no record.
        """
        if part is None:
            part = next(
                (k for k, each in enumerate(self.parts) if isinstance(each, FittedRecord)), 0
            )
        stated = self.parts[part]
        if not isinstance(stated, FittedRecord):
            raise ValueError(
                f"part {part} of the fit is a frequency response: use fit.response_band()."
            )
        self._known_errors()
        if stated.error is None:
            raise ValueError(
                f"the fit {self.name!r} was saved without the errors of its outputs: fit it again."
            )
        half = t_quantile(level, self._fewest_degrees(self.names)) * stated.error
        values = [stated.simulated[name] for name in stated.outputs]
        return {
            name: (value - each, value + each)
            for name, value, each in zip(stated.outputs, values, half, strict=True)
        }

    def sensitivity(self, part: int = 0) -> Sensitivity:
        """Return which frequencies, or which times of a record, of a part tell of each free parameter.

        Raises
        ------
        ValueError
            If the fit has no estimate, no degrees of freedom, or was saved before files kept what
            this needs.
        """
        self._known_errors()
        stated = self.parts[part]
        if stated.is_prior:
            raise ValueError(
                f"part {part} is a-priori knowledge, not data: fit.prior_share has what it tells."
            )
        if stated.information is None or stated.information_alone is None:
            raise ValueError(
                f"the fit {self.name!r} was saved without what its data tell of parameters: fit it again."
            )
        if isinstance(stated, FittedResponse):
            unit, at, outputs = "rad/s", stated.data.omega, (stated.data.output or "response",)
        elif isinstance(stated, FittedSpectrum):
            unit, at, outputs = "rad/s", stated.data.omega, stated.outputs
        else:
            unit, outputs = "s" if stated.data.has_time else "row", stated.outputs
            edges = np.linspace(
                0, len(stated.data), stated.information.shape[1] // len(outputs) + 1
            )
            middle = (edges[1:] + edges[:-1] - 1) / 2
            at = np.interp(middle, np.arange(len(stated.data)), stated.data.time)
        return sensitivity(
            self.free, outputs, unit, at, stated.information, stated.information_alone
        )

    def _known_errors(self) -> KnownDirections:
        """Return what is known of the errors of all parameters, if anything is."""
        if not self.converged:
            raise ValueError(f"the fit {self.name!r} has no estimate: {self.status}.")
        if self.known is None:
            raise ValueError(
                f"the fit {self.name!r} has no covariance from which a band could follow: its data leave no degrees of "
                "freedom; add data or fix parameters."
            )
        return self.known

    def _fewest_degrees(self, names: Sequence[str]) -> float:
        """Return the fewest degrees of freedom of the parameters with an error, or of the fit where these have none."""
        return min(
            (q.dof for q in self.quantities if q.name in names and q.standard_error > 0),
            default=self.dof,
        )

    def __repr__(self) -> str:
        return one_line(
            self,
            f"{self.name!r}, {self.status}",
            f"cost {self.cost:.6g} ({self.criterion})",
            counted(len(self.free), "free parameter"),
        )

    def __str__(self) -> str:
        return _text(self)


def _text(fit: Fit) -> str:
    """Answer in order: converged, starts that agree, cost, values and their errors, what to beware of."""
    title = _title(fit)
    warnings = [f"  warning: {text}" for text in fit.warnings]
    if not fit.converged:
        lines = [title, "", f"  FAILED: {fit.status}.", *warnings]
        if fit.best_effort is not None:
            lines += [
                "",
                "  best effort, no estimate:",
                "",
                *_best_effort_table(fit, fit.best_effort),
            ]
        return "\n".join(lines)

    sections = (
        [title],
        _overview(fit),
        [
            *_table(fit),
            *(
                ["", f"  ± is the standard error for {error_condition(fit)}."]
                if fit.dof > 0
                else []
            ),
        ],
        _profile_lines(fit),
        _other_criteria(fit),
        [
            *warnings,
            *(f"  note: {text}" for text in fit.notes),
            f"  {fit.seconds:.2f} s; starts: {fit.starts}",
        ],
    )
    return "\n\n".join("\n".join(lines) for lines in sections if lines)


def _profile_lines(fit: Fit) -> list[str]:
    """Return the intervals by profile of the parameters whose standard error misleads."""
    if fit.profiles is None:
        return []
    width = max(len(profile.name) for profile in fit.profiles.profiles)
    return [
        f"  {100 * fit.profiles.level:g} % intervals by profile likelihood, where the standard error misleads:",
        *(f"    {profile.name:<{width}}  {profile}" for profile in fit.profiles.profiles),
    ]


def _title(fit: Fit) -> str:
    return f"{fit.name}: {', '.join(dict.fromkeys(part.label for part in fit.parts if not part.is_prior))}"


def _html(fit: Fit) -> str:
    """Return the same for a notebook, without what the other criteria say."""
    said = [
        *(f"warning: {text}" for text in fit.warnings),
        *(f"note: {text}" for text in fit.notes),
    ]
    if not fit.converged:
        return html_text(_title(fit), "b") + html_text(f"FAILED: {fit.status}.") + html_list(said)
    overview = [" ".join(line.split()) for line in _overview(fit)]
    error = html_text(f"± is the standard error for {error_condition(fit)}.") if fit.dof > 0 else ""
    return (
        html_text(_title(fit), "b")
        + html_list(overview)
        + html_table(TABLE, _rows(fit), TABLE_LEFT)
        + error
        + html_list(said)
    )


def _overview(fit: Fit) -> list[str]:
    """Return what was searched, found and fitted, a line for each."""
    tried = Multistart(fit.runs, fit.minima, fit.seconds)
    screened = len(fit.runs) - len(tried.brought)
    only_screened = f" ({screened} of {len(fit.runs)} starts were screened out)" if screened else ""
    agreeing = counted(fit.agreeing, "agrees", "agree")
    minima = counted(len(fit.minima), "distinct minimum", "distinct minima")
    pade = [
        f"; Padé phase error up to {part.pade_error:.2g}° ({part.name})"
        for part in fit.responses
        if part.pade_error is not None
    ]
    return [
        f"  starts     {tried.converged} of {len(tried.brought)} converged{only_screened}; "
        f"{agreeing} on the best of {minima}",
        f"  cost       {fit.cost:.6g}  ({fit.rule})",
        f"  data       {_data_text(fit)}, delay {fit.delay}{''.join(pade)}",
        *(f"  prior      {text}" for text in _prior_texts(fit)),
        *(f"  inputs     {text}" for text in _inputs_texts(fit.records)),
        *(f"  output     {text}" for text in _output_texts(fit.records)),
        *(f"  response   {text}" for text in _response_texts(fit.responses)),
        *(f"  output     {text}" for text in _spectrum_texts(fit.spectra)),
    ]


def _prior_texts(fit: Fit) -> Iterator[str]:
    """Yield what was known before the data, and how much of what is known now that is."""
    if not fit.priors:
        return
    share = fit.prior_share
    told = [
        f"{name} = {' ± '.join(with_error(mean, sigma))} ({number(100 * share.get(name, math.nan), 2)} %)"
        for name, (mean, sigma) in fit.priors.items()
    ]
    yield f"{some(told, MANY)}: maximum a posteriori, with the share that the prior has in what is known of each"


def _inputs_texts(records: Sequence[FittedRecord]) -> list[str]:
    """Say how inputs ran between their samples, one line for all that ran alike in the same records."""
    alike: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for name in dict.fromkeys(name for part in records for name in part.between):
        said = {part.between[name]: None for part in records if name in part.between}
        for text in said:
            where = (
                tuple(part.name for part in records if part.between.get(name) == text)
                if len(said) > 1
                else ()
            )
            alike.setdefault((text, where), []).append(name)
    return [
        f"{', '.join(names)} {text}{f' ({some(where)})' if any(where) else ''}"
        for (text, where), names in alike.items()
    ]


def _data_text(fit: Fit) -> str:
    """Say how many points, samples and rows there are, and how many were compared where these are fewer."""
    texts = []
    if fit.responses:
        points = sum(len(part.data) for part in fit.responses)
        texts.append(f"{counted(points, 'point')} in {counted(len(fit.responses), 'response')}")
    if fit.spectra:
        lines = sum(len(part.data) for part in fit.spectra)
        texts.append(f"{counted(lines, 'line')} in {counted(len(fit.spectra), 'manoeuvre')}")
    for has_time, noun, remark in ((True, "sample", ""), (False, "row", " without a time")):
        records = [part for part in fit.records if part.data.has_time == has_time]
        if records:
            count = sum(len(part.data) for part in records)
            compared = sum(part.compared for part in records)
            share = "" if compared == count else f"{compared} of "
            texts.append(
                f"{share}{counted(count, noun)}{remark} in {counted(len(records), 'record')}"
            )
    return " and ".join(texts)


def _output_texts(records: Sequence[FittedRecord]) -> list[str]:
    """Say how well every output of every record is reproduced; of many records the range and the worst."""
    if len(records) <= MANY:
        return [_output_text(part, output) for part in records for output in part.outputs]
    texts = []
    for output in dict.fromkeys(output for part in records for output in part.outputs):
        holders = [(k, part) for k, part in enumerate(records, start=1) if output in part.outputs]
        residuals = [rms(part.residual(output)) for _, part in holders]
        percents = [part.fit_percent(output) for _, part in holders]
        units = dict.fromkeys(part.data.units.get(output, "") for _, part in holders)
        worst = sorted(zip(percents, holders, strict=True), key=lambda pair: pair[0])[:WORST]
        named = [f"{percent:.1f} % in {_record_name(k, part)}" for percent, (k, part) in worst]
        residual = f"{_range(residuals)} {'/'.join(units)}".rstrip()
        texts.append(
            f"{output} in {counted(len(holders), 'record')}: residual {residual} rms, fit {min(percents):.1f} to "
            f"{max(percents):.1f} % (least: {', '.join(named)})"
        )
    return texts


def _response_texts(responses: Sequence[FittedResponse]) -> list[str]:
    """Say how far the points of a response are from the model, and which one most; of many responses of the worst."""
    with np.errstate(divide="ignore", invalid="ignore"):  # zeros, which are left out
        off = [
            np.abs(part.data.response - part.response) / np.abs(part.data.response)
            for part in responses
        ]
    known = [
        (part, values)
        for part, values in zip(responses, off, strict=True)
        if np.all(np.isfinite(values))
    ]
    many = len(known) > MANY
    if many:
        known.sort(key=lambda pair: -rms(pair[1]))
    texts = []
    for part, values in known[:WORST] if many else known:
        worst = int(np.argmax(values))
        where = f" ({part.name})" if part.name and len(responses) > 1 else ""
        texts.append(
            f"residual {number(100 * rms(values), 2)} % rms, largest {number(100 * float(values[worst]), 2)} % at "
            f"{part.data.omega[worst]:.4g} rad/s{where}"
        )
    return texts


def _spectrum_texts(spectra: Sequence[FittedSpectrum]) -> list[str]:
    """Say how well every output of every manoeuvre is reproduced, and the noise that this leaves in a sample."""
    texts = []
    for part in spectra:
        where = f" ({part.name})" if part.name and len(spectra) > 1 else ""
        by_equation = part.criterion == EquationError().name
        for k, output in enumerate(part.outputs):
            unit = "" if by_equation else f" {part.data.units.get(output, '')}".rstrip()
            noise = f"{'error of its equation' if by_equation else 'noise of a sample'} {number(part.noise[k, k] ** 0.5)}"
            texts.append(f"{output}{where}: {noise}{unit}, fit {part.fit_percent(output):.1f} %")
    return texts


def _record_name(number: int, part: FittedRecord) -> str:
    return f"record {number}{f' ({part.data.name})' if part.data.name else ''}"


def _range(values: Sequence[float]) -> str:
    low, high = number(min(values), 3), number(max(values), 3)
    return low if low == high else f"{low} to {high}"


def _output_text(part: FittedRecord, output: str) -> str:
    where = f" ({part.name})" if part.name else ""
    residual = f"{number(rms(part.residual(output)))} {part.data.units.get(output, '')}".rstrip()
    percent = part.fit_percent(output)  # NaN of an output that never changes
    return f"{output}{where}: residual {residual} rms" + (
        "" if math.isnan(percent) else f", fit {percent:.1f} %"
    )


TABLE = ["parameter", "estimate", "± error", "unit", "bounds", "", "meaning"]
TABLE_LEFT = (0, 3, 5, 6)  # columns that are flush left


def _table(fit: Fit) -> list[str]:
    return ["  " + line for line in text_table(TABLE, _rows(fit), left=TABLE_LEFT).splitlines()]


def _rows(fit: Fit) -> list[list[str]]:
    """Return the cells of the table of quantities."""
    rows = []
    own = _own_of_many(fit)
    for quantity in fit.quantities:
        if quantity.name in own:
            of_all = [
                other for other in fit.quantities if own.get(other.name) == own[quantity.name]
            ]
            if quantity is of_all[0]:
                rows.append(_row_of_many(of_all))
            continue
        value, error = with_error(quantity.value, quantity.standard_error)
        bounds = note = ""
        if quantity.kind == "free":
            low, high = quantity.bounds
            bounds = f"[{low:g}, {high:g}]"
            note = "AT BOUND" if quantity.at_bound else ""
        else:
            note = quantity.kind
        rows.append([quantity.name, value, error, quantity.unit, bounds, note, quantity.about])
    return rows


def _own_of_many(fit: Fit) -> dict[str, tuple[str, str]]:
    """Return the parameters that many records have each for itself, with their name inside and their kind."""
    kinds = {quantity.name: quantity.kind for quantity in fit.quantities}
    own = {
        outside: (inside, kinds[outside])
        for part in fit.records
        for inside, outside in part.rename.items()
        if outside in kinds and re.fullmatch(rf"{re.escape(inside)}_\d+", outside)
    }
    number_of = Counter(own.values())
    return {name: known_as for name, known_as in own.items() if number_of[known_as] > MANY}


def _row_of_many(quantities: Sequence[Quantity]) -> list[str]:
    """Return one row of the table for one parameter of many records."""
    first, last = quantities[0], quantities[-1]
    errors = [
        quantity.standard_error for quantity in quantities if math.isfinite(quantity.standard_error)
    ]
    boxes = {quantity.bounds for quantity in quantities}
    at_bound = sum(quantity.at_bound for quantity in quantities)
    low, high = first.bounds
    return [
        f"{first.name} ... {last.name}",
        _range([quantity.value for quantity in quantities]),
        _range(errors) if errors else "-",
        first.unit,
        f"[{low:g}, {high:g}]" if first.kind == "free" and len(boxes) == 1 else "",
        f"{at_bound} AT BOUND" if at_bound else "" if first.kind == "free" else first.kind,
        first.about,
    ]


def _best_effort_table(fit: Fit, values: Mapping[str, float]) -> list[str]:
    header = ["parameter", "value", "unit", "bounds", "", "meaning"]
    rows = []
    for quantity in fit.quantities:
        if quantity.name in values:
            low, high = quantity.bounds
            bounds, note = (
                (f"[{low:g}, {high:g}]", "") if quantity.kind == "free" else ("", quantity.kind)
            )
            rows.append(
                [
                    quantity.name,
                    number(values[quantity.name]),
                    quantity.unit,
                    bounds,
                    note,
                    quantity.about,
                ]
            )
    return ["  " + line for line in text_table(header, rows, left=(0, 2, 4, 5)).splitlines()]


def error_condition(fit: Fit) -> str:
    """Say for what errors of the data the standard errors hold, and of which distribution they are the scale."""
    conditions = "; ".join(dict.fromkeys(part.condition for part in fit.parts))
    if fit.independent is not None:
        conditions += "; correlated along frequency as far as the residuals are"
    if math.isinf(fit.dof):
        return conditions
    return f"{conditions}; Student's t with {counted(round(fit.dof), 'degree of', 'degrees of')} freedom{_biased(fit)}"


def _biased(fit: Fit) -> str:
    """Name the quantities from whose bias intervals differ, most biased first."""
    found = [q for q in fit.quantities if abs(q.bias) > BIASED * q.standard_error > 0]
    found.sort(key=lambda q: -abs(q.bias) / q.standard_error)
    if not found:
        return ""
    named = some([f"{q.name} {-q.bias:+.2g}" for q in found], WORST)
    return f"; intervals are corrected for the bias by the noise ({named})"


def _other_criteria(fit: Fit) -> list[str]:
    """Return the values of the other criteria that the data allow, a line for each."""
    others = {
        name: cost
        for name, cost in fit.costs.items()
        if not math.isnan(cost) and name != fit.criterion
    }
    if not others:
        return []
    lines = [f"    {number(cost):>10}  {RULES.get(name, name)}" for name, cost in others.items()]
    return ["  other criteria at this estimate:", *lines]


def _at_estimate(
    fit: Fit, model: Model, part: FittedPart, inputs: Inputs | None
) -> ModelAtEstimate:
    """Return a model at the values, covariance and assumptions that a fit has for a part."""
    record = part if isinstance(part, FittedRecord) else None
    biases = record.biases if record else ()
    gains = record.gains if record else ()
    if inputs is None:
        inputs = record.inputs if record else "record"

    names = [*model.parameters, *(f"{b}_bias" for b in biases), *(f"K_{s}_{o}" for s, o in gains)]
    outside = [part.rename.get(name, name) for name in names]
    driven = record if record is not None and record.driven else None
    estimated = outside
    if driven is not None:  # gains follow from the variances of the noise
        estimated = [part.rename.get(name, name) for name in (*model.parameters, *driven.added)]
    for name in estimated:
        if name not in fit.estimate:
            raise ValueError(
                f"the fit has no {name!r}, which {model.label} needs; it has {', '.join(fit.estimate)}: "
                "give the model that was fitted, or the values as {name: value}."
            )

    bounds = {q.name: q.bounds for q in fit.quantities if q.kind == "free"}

    # Standard errors treat what ended at its bound as known, and so does everything that follows
    # from them.
    at_bound = {q.name for q in fit.quantities if q.at_bound and q.kind == "free"}
    known = np.array([name in at_bound for name in estimated], dtype=bool)
    values = np.array([fit.estimate[name] for name in estimated])
    covariance = np.where(known | known[:, None], 0.0, fit.covariance_of(estimated))
    if driven is not None:
        assert driven.gain is not None
        assert driven.gain_slope is not None
        own = len(names) - len(gains)
        values = np.concatenate([values[:own], driven.gain])
        covariance = _through(
            np.vstack([np.eye(own, len(estimated)), driven.gain_slope]), covariance
        )
    return ModelAtEstimate(
        label=model.label,
        system=dynamics(model, delay_order(part.delay)),
        names=tuple(names),
        q=values,
        covariance=covariance,
        criterion=criterion_of(inputs, biases, gains),
        part=record,
        declared={
            name: restated(name, p, bounds=bounds.get(part.rename.get(name, name)))
            for name, p in model.parameters.items()
        },
        own=_own_names(fit, model, record, dict(zip(names, outside, strict=True)))
        if record
        else (),
    )


def _through(slope: Array, covariance: Array) -> Array:
    """Return the covariance (m, m) of what has derivatives (m, k) by values whose covariance may have NaN."""
    unknown = np.isnan(np.diag(covariance))
    found = slope @ np.where(unknown | unknown[:, None], 0.0, covariance) @ slope.T
    lost = (slope[:, unknown] != 0).any(axis=1)
    return np.where(lost | lost[:, None], np.nan, found)


def _own_names(
    fit: Fit, model: Model, part: FittedRecord, outside: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the names inside of the free values that belong to the record of a part alone, by their names `outside`.

    Biases, unless records share them under one name; and parameters of which other records have
    another one.
    """
    free = {q.name for q in fit.quantities if q.kind == "free"}
    others = [
        other
        for other in fit.records
        if _class_name(other.model) == _class_name(part.model)
        and not share_samples(other.data, part.data)
    ]
    own = []
    for name, known_as in outside.items():
        elsewhere = [other.rename.get(name, name) for other in others]
        if name in model.parameters:
            is_own = any(other != known_as for other in elsewhere)
        else:
            is_own = name.endswith("_bias") and known_as not in elsewhere
        if is_own and known_as in free:
            own.append(name)
    return tuple(own)


def _part_index(fit: Fit, model: Model | None, part: int | None, record: Record | None) -> int:
    """Return the part of a fit that is meant: the one asked for, else that of the record, else the first record.

    Of those of the given model where the fit has any.
    """
    count = len(fit.parts)
    if part is not None:
        whole = isinstance(part, (int, np.integer)) and not isinstance(part, bool)
        if not whole or not -count <= part < count:
            raise ValueError(
                f"part is {part!r}: the fit has {counted(count, 'part')}, counted from 0."
            )
        return part % count

    def later(k: int) -> int:
        data = fit.parts[k].data
        if not isinstance(data, Record) or fit.parts[k].is_prior:
            return 3 if fit.parts[k].is_prior else 2
        return int(record is None or not share_samples(data, record))

    records_first = sorted(range(count), key=later)
    if model is not None:
        wanted = _class_name(reference(model))
        for k in records_first:
            if _class_name(fit.parts[k].model) == wanted:
                return k
    return records_first[0]


def _class_name(stated: Mapping[str, object]) -> str:
    """Return a model's class without its module, which is another one where the file was run as a script."""
    return re.sub(r"^.*:", "", str(stated["class"]))
