"""The answer as values: estimates, errors, all runs and warnings."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from inspect import Parameter, Signature
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from greybox.assessment.at_estimate import at_estimate, part_index
from greybox.assessment.fitted_part import FittedRecord, FittedResponse, FittedSpectrum
from greybox.assessment.identifiability import Identifiability, identifiability
from greybox.assessment.misfit.answer import Misfit
from greybox.assessment.printed import details, summary, text
from greybox.assessment.profile_result import Profiles
from greybox.assessment.response_band import (
    ResponseBand,
    band_of,
    require_level,
    response_and_slope,
    t_quantile,
)
from greybox.assessment.simulation.model_at_estimate import ModelAtEstimate
from greybox.data.checked_array import finite_numbers
from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import (
    AnyArray,
    Array,
    Interval,
)
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import ByName, Values, attributes, places_of
from greybox.data.files.numbers_in_text import with_error
from greybox.data.files.printed import Printed, one_line
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.pandas_frames import Frame, frame_of
from greybox.data.record import NOT_STORED, Record
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.engine.solve.minima import Minimum, Multistart
from greybox.engine.solve.runs import Runs
from greybox.modeling.formulation.frequency_criteria import evaluate
from greybox.modeling.formulation.included_criteria import CRITERIA
from greybox.modeling.formulation.input_assumptions import Inputs
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import AnyModel, Model, require_known
from greybox.modeling.model_reference import resolve
from greybox.modeling.rational import Rational, rational


@dataclass(frozen=True)
class Quantity:
    """One line of the answer.

    Attributes
    ----------
    name, unit, about : str
    value, standard_error : float
        NaN where unknown.
    kind : "free", "fixed", "tied" or "derived"
    bounds, box : (float, float)
        Limits of the estimate, and of the drawn starts.
    at_bound : bool
        Whether the value ended at one of `bounds`, or of a tied parameter.
    dof : float
        Degrees of freedom of Student's t for its interval.
    bias : float
        Bias of the value from noise in the magnitude by which a relative criterion divides: with
        the measured magnitude a gain comes out too low, with the model's too high. First
        order in the variance of the errors. The value includes the bias; intervals are centered on
        the value without it.
    systematic : float
        Share of the standard error, in the same units, of errors that all points of a response have
        in common, such as that of a truncated output: longer tests do not reduce it. The squares of
        it and of the scatter add up to that of `standard_error`.
    has_computed_bounds : bool
        Whether the model computed the bounds, which then say nothing to a reader.
    """

    name: str
    value: float
    standard_error: float
    kind: Literal["free", "fixed", "tied", "derived"]
    unit: str = ""
    about: str = ""
    bounds: Interval = (-math.inf, math.inf)
    at_bound: bool = False
    dof: float = math.inf
    box: Interval = (-math.inf, math.inf)
    bias: float = 0.0
    systematic: float = 0.0
    has_computed_bounds: bool = False

    def __repr__(self) -> str:
        value, error = with_error(self.value, self.standard_error)
        return one_line(self, f"{self.name} = {value} ± {error} {self.unit}", self.kind)


@public
@frozen
class Fit(Printed):
    """The answer to a problem: estimates with their errors, all runs, warnings. It prints itself.

    `fit` and `load` return it.

    A fit contains plain values only, so that a saved one loads without the model. `runs` are
    columns, as in ``fit.runs.cost``. Vectors and matrices are in the order of `free` unless stated
    otherwise.

    Attributes
    ----------
    name : str
        Name of the problem.
    parts : tuple of FittedResponse, FittedRecord or FittedSpectrum
        Data and fitted values of each part of the problem.
    quantities : tuple of Quantity
        Free, fixed and tied parameters, then derived quantities.
    covariance : (k, k) array
        Covariance of the free, fixed and tied parameters, in the order of `names`.
    dof : float
        Degrees of freedom: the numbers in the data minus the parameters that they determine. A
        record counts as its equivalent number of independent residuals minus its unknown initial
        states. Infinite if all data are frequency responses with given variances
        (`MaximumLikelihood`).
    cost : float
        Value of the criterion, without smoothing; NaN when no start converged.
    runs, minima : Runs, tuple of Minimum
        All runs in the order of their starts, and the distinct minima, best first.
    agreeing : int
        Number of runs whose cost differs from the best by less than 0.1 in log-likelihood, or, for
        other criteria, by an equivalent amount. It is 0 if the best response is nearly zero. Where
        parameters of frequency responses share no data, it counts the runs that reached the minimum
        of the block that fewest of them reached.
    white : (p, p) array or None
        Covariance of the free parameters if the cost were the likelihood of white errors.
    independent : (p, p) array and float, or None
        Covariance and degrees of freedom that the fit would have if errors of responses were
        independent along frequency; None where they are.
    directions : KnownDirections or None
        Covariance of all `names` in the directions that the data determine, and the other
        directions. Parameters that a bound holds count as known.
    profiles : Profiles or None
        Profiles of the parameters whose standard error misleads.
    priors : mapping of name to (float, float)
        Mean and standard deviation of every prior. With priors the estimate is the maximum a
        posteriori one, and one of the `parts` represents them.
    prior_share : mapping of name to float
        Share of the prior in the information on each free parameter, 0 to 1; the rest comes from
        the data. The other parameters are estimated too, and errors are taken as independent. NaN
        for a parameter without a standard error; empty without a prior.
    misfit : Misfit or None
        Whether the model explains the data, and what it may lack; None where that cannot be
        decided.
    best_effort : mapping of name to float, or None
        Values of free, fixed and tied parameters at the end of the best run of a failed fit. They
        are not an estimate and have no errors. None if a run converged, or if no run ended at a
        finite cost.
    warnings, notes : tuple of str
        Reasons to doubt the estimate; and remarks.
    seed, starts, seconds, versions
        Seed and rule of the starts, duration of the fit, versions of the packages.
    command : tuple of str
        Arguments of the ``greybox`` command that made the fit; empty from Python.
    left_out : tuple of str
        Names of the included checks that were not made, see ``greybox.CHECKS``.
    models, given : tuple of Model or None, tuple of Model or class
        The fitted models, None for a loaded fit; and the models that were given to `load`.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> low, high = fit.interval(0.95)["a1"]
    >>> low < fit.estimate["a1"] < high
    True
    >>> fit.misfit.explains
    True
    """

    name: str
    parts: tuple[FittedResponse | FittedRecord | FittedSpectrum, ...]
    quantities: tuple[Quantity, ...]
    covariance: Array
    dof: float
    cost: float
    runs: Runs
    minima: tuple[Minimum, ...]
    agreeing: int
    warnings: tuple[str, ...]
    seed: int | None
    starts: str
    seconds: float
    versions: Mapping[str, str]
    models: tuple[Model, ...] | None = field(default=None, metadata=NOT_STORED)
    given: tuple[AnyModel, ...] = field(default=(), metadata=NOT_STORED)
    white: Array | None = None
    independent: tuple[Array, float] | None = None
    notes: tuple[str, ...] = ()
    directions: KnownDirections | None = None
    profiles: Profiles | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    prior_share: Values = field(default_factory=dict)
    misfit: Misfit | None = None
    best_effort: Values | None = None
    command: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(q.name for q in self.quantities if q.kind == "free")

    @cached_property
    def at_bound(self) -> tuple[str, ...]:
        """Names of the parameters that ended at a bound."""
        return tuple(q.name for q in self.quantities if q.at_bound)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free, fixed and tied parameters, in this order."""
        return tuple(q.name for q in self.quantities if q.kind != "derived")

    @cached_property
    def by_name(self) -> dict[str, Quantity]:
        """Every quantity by its name."""
        return ByName({q.name: q for q in self.quantities})

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
    def labels(self) -> tuple[str, ...]:
        """What the models are called, each once, without priors."""
        return tuple(dict.fromkeys(part.label for part in self.parts if not part.is_prior))

    @property
    def spectra(self) -> tuple[FittedSpectrum, ...]:
        """The parts whose data are spectra of manoeuvres."""
        return tuple(part for part in self.parts if isinstance(part, FittedSpectrum))

    @cached_property
    def costs(self) -> dict[str, float]:
        """Value of every included criterion at the estimate, by its name (``relative-error``).

        NaN where the data lack what it needs. Empty without an estimate, and for fits with other
        data than frequency responses.
        """
        # Published fits state the cost of one criterion or another: with all of them any can be
        # compared.
        responses = self.responses if self.converged else ()
        if len(responses) < len(self.parts):
            return {}
        return {
            criterion.name: sum(
                part.weight * evaluate(criterion, part.response, part.data) for part in responses
            )
            for criterion in CRITERIA
        }

    @property
    def converged(self) -> bool:
        """True when at least one start converged, so that there is an answer."""
        return bool(self.minima)

    @property
    def status(self) -> str:
        """The word "converged", or why there is no answer."""
        if self.converged:
            return "converged"
        return f"no start converged ({Multistart(self.runs, ()).failures})"

    def require_estimate(self) -> None:
        """Raise ValueError if no start converged."""
        if not self.converged:
            raise ValueError(f"the fit {self.name!r} has no estimate: {self.status}.")

    @property
    def is_explained(self) -> bool:
        """False if the test of misfit shows that the model does not explain the data."""
        return not self.misfit or self.misfit.explains

    @property
    def details(self) -> str:
        """What ``print(fit)`` leaves out: starts, cost, delay, correlations beyond 0.9, time."""
        return details(self)

    @property
    def criterion(self) -> str:
        """Name of the criterion that was minimized, such as ``relative-error``; several by "; "."""
        return self._of_parts("criterion")

    @property
    def rule(self) -> str:
        """The criterion that was minimized, in words."""
        return self._of_parts("rule")

    @property
    def delay(self) -> str:
        """How delays were evaluated."""
        return self._of_parts("delay")

    def _of_parts(self, field: str) -> str:
        return "; ".join(unique(getattr(part, field) for part in self.parts))

    @property
    def estimate(self) -> dict[str, float]:
        """Values of free, fixed and tied parameters by name."""
        return ByName({q.name: q.value for q in self.quantities if q.kind != "derived"})

    @property
    def derived(self) -> dict[str, float]:
        """Values of the derived quantities by name."""
        return ByName({q.name: q.value for q in self.quantities if q.kind == "derived"})

    @property
    def standard_error(self) -> dict[str, float]:
        """Standard errors by name, also of derived quantities; NaN if unknown, 0 for a constant."""
        return ByName({q.name: q.standard_error for q in self.quantities})

    @property
    def identifiability(self) -> Identifiability:
        """Errors and insensitivities in percent, correlations, and determined combinations.

        Raises
        ------
        ValueError
            If the fit has no estimate or no covariance.
        """
        return identifiability(
            self.free,
            [self.by_name[name].unit for name in self.free],
            self.known_directions(self.free),
            self.at_bound,
        )

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p) of the free parameters; NaN without a standard error."""
        return self.known_directions(self.free).correlation

    def known_directions(self, names: Sequence[str]) -> KnownDirections:
        """Return the covariance of these parameters in the directions that the data determine.

        Raises
        ------
        ValueError
            If the fit has no estimate or no covariance.
        """
        self.require_estimate()
        if self.directions is None:
            raise ValueError(
                f"the fit {self.name!r} has no covariance: its warnings say why, and what to do."
            )
        return self.directions.of([self.names.index(name) for name in names])

    @property
    def inflation(self) -> float:
        """Median of variances over those for errors that are independent along frequency."""
        if self.independent is None:
            return 1.0
        alone = self.independent[0].diagonal()
        variances = self.covariance.diagonal()[: len(alone)]
        known = (alone > 0) & (variances > 0)
        return float(np.median(variances[known] / alone[known])) if known.any() else math.nan

    @property
    def checksum(self) -> str:
        """Checksums of the data of all parts."""
        return " ".join(part.data.checksum for part in self.parts)

    def interval(self, level: float = 0.95) -> dict[str, Interval]:
        """Return confidence intervals by Student's t, by name; NaN if the error is unknown.

        Their centers are the values without their `Quantity.bias`. Where standard errors mislead,
        `profiles` has other intervals, or a note asks for them.
        """
        intervals: dict[str, Interval] = ByName()
        for q in self.quantities:
            if q.kind == "fixed" and not q.standard_error > 0:
                continue
            # Each quantity has degrees of freedom of its own (Welch and Satterthwaite).
            half = t_quantile(level, q.dof) * q.standard_error
            center = q.value - q.bias
            intervals[q.name] = (center - half, center + half)
        return intervals

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Return the covariance matrix of the named parameters."""
        require_known(names, self.names, "parameter", f"the fit {self.name!r}")
        rows = places_of(names, self.names)
        return self.covariance[np.ix_(rows, rows)]

    def at_estimate(
        self,
        model: Model | None = None,
        *,
        inputs: Inputs | None = None,
        part: int | None = None,
        record: Record | None = None,
    ) -> ModelAtEstimate:
        """Return the model of a part, or another one with the same parameters, at the estimate.

        Parameters
        ----------
        model : Model, optional
            By default the one that was fitted; for a loaded fit, a model of greybox or one given
            to `load`.
        inputs : "record", "linear" or "held", optional
            How inputs vary between samples; by default as in the fit.
        part : int, optional
            By default the part of `record`, else the first record, preferably with this model.
        record : Record, optional
            The record on which the model will be run.

        Raises
        ------
        ValueError
            If the fit did not converge, or has no value for a parameter of the model.
        LookupError
            If a loaded fit does not know the model.
        """
        if self.best_effort:
            raise ValueError(
                f"the fit {self.name!r} has no estimate: {self.status}. To see what its best run "
                "does, give the model and the values at its end, gb.simulate(model, "
                "fit.best_effort, record=...)."
            )
        self.require_estimate()
        k = part_index(self, model, part, record)
        return at_estimate(self, model or self.model_of(k), self.parts[k], inputs)

    def model_of(self, part: int = 0) -> Model:
        """Return the model of a part; for a loaded fit, a model of greybox or one given to `load`.

        Raises
        ------
        ValueError
            If the fit does not have this part, or its model has other parameters than the fitted
            one.
        LookupError
            If a loaded fit does not know it.
        """
        part = part_index(self, None, part, None)
        return self.models[part] if self.models else resolve(self.parts[part].model, self.given)

    def response(self, omega: ArrayLike, part: int = 0) -> FrequencyResponse:
        """Evaluate the fitted model of a part at `omega` (n,) rad/s.

        A loaded fit knows the models of greybox and those given to `load`.

        Raises
        ------
        LookupError
            If a loaded fit does not know the model.
        """
        response, model, values = self._response_part(part)
        return frequency_response(model, values, omega, **response.signals)

    def to_dict(self, level: float = 0.95) -> dict[str, Any]:
        """Return the numbers as plain values, as ``greybox fit --json`` does; None where unknown.

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

        The index is the name; the columns are ``value, standard_error``, the ends ``low, high`` of
        the interval of this `level`, ``unit, kind, lower_bound, upper_bound, at_bound, about``.

        Raises
        ------
        ModuleNotFoundError
            Without pandas, ``pip install 'greybox-id[pandas]'``.
        """
        names = ("value", "standard_error", "unit", "kind", "at_bound", "about")
        columns: dict[str, Any] = {
            name: [getattr(q, name) for q in self.quantities] for name in names
        }
        # A constant has no interval, but a column of a frame needs a number in every row.
        intervals = self.interval(level)
        unknown = (math.nan, math.nan)
        limits = [(*intervals.get(q.name, unknown), *q.bounds) for q in self.quantities]
        ends = ("low", "high", "lower_bound", "upper_bound")
        columns |= zip(ends, np.reshape(limits, (-1, 4)).T, strict=True)
        about = attributes(self, "name", "criterion", "cost") | {"level": level}

        return frame_of(columns, [q.name for q in self.quantities], "name", about)

    def _response_part(self, part: int) -> tuple[FittedResponse, Model, dict[str, float]]:
        """Return a frequency response, its model, and the model's parameters."""
        model = self.model_of(part)
        fitted = self.parts[part]
        if not isinstance(fitted, FittedResponse):
            raise ValueError(
                f"part {part} of the fit is not a frequency response: use "
                "gb.frequency_response(model, fit.estimate, omega), or gb.simulate for time "
                "histories."
            )
        return (
            fitted,
            model,
            {name: self.estimate[fitted.outside(name)] for name in model.parameters},
        )

    def transfer_function(self, part: int = 0) -> Rational:
        """Return the transfer function of a response at the estimate; it prints its factors.

        Raises
        ------
        ValueError, LookupError
            If the part is not a frequency response, its model has no rational form, or a loaded fit
            does not know the model.
        """
        fitted, model, values = self._response_part(part)
        return rational(
            model, values, input=fitted.data.input, output=fitted.data.output, at=fitted.at
        )

    @property
    def residuals(self) -> tuple[AnyArray, ...]:
        """Measured minus fitted values of every part; `plotting.residuals` draws them.

        A response has (n,) complex ones, a record (outputs, n), a manoeuvre (outputs, n) complex
        ones. Residuals of a record are NaN where nothing was compared.
        """
        return tuple(part.residuals for part in self.parts)

    def response_band(
        self,
        omega: ArrayLike | None = None,
        level: float = 0.95,
        part: int = 0,
    ) -> ResponseBand:
        """Return the fitted response of a part at `omega` (n,) rad/s with its confidence band.

        The band is of first order in the errors of the parameters and holds where their standard
        errors do. By default `omega` is the grid of the curve in figures.

        Raises
        ------
        ValueError
            If the fit has no estimate or no covariance, or the part is a record.
        LookupError
            If a loaded fit does not know the model.
        """
        fitted, model, values = self._response_part(part)
        # Renamed parameters stand among those of the fit under their outside names.
        names = [fitted.outside(name) for name in model.parameters]
        directions = self.known_directions(names)
        require_level(level)
        if omega is None:
            omega = fitted.curve.omega if fitted.curve is not None else fitted.data.omega

        response, slope = response_and_slope(
            model,
            values,
            finite_numbers("omega", omega),
            **fitted.signals,
        )
        bias = np.array([self.by_name[name].bias for name in names])
        return band_of(response, slope, directions, level, self.fewest_degrees(names), bias)

    def fewest_degrees(self, names: Sequence[str]) -> float:
        """Return the fewest degrees of freedom of these parameters, by default those of the fit."""
        # By Welch and Satterthwaite a combination has at least the fewest degrees of its members.
        lines = [self.by_name[name] for name in names]
        return min((q.dof for q in lines if q.standard_error > 0), default=self.dof)

    def __repr__(self) -> str:
        return one_line(
            self,
            f"{self.name!r}, {self.status}",
            f"cost {self.cost:.6g} ({self.criterion})",
            counted(len(self.free), "free parameter"),
        )

    def __str__(self) -> str:
        return text(self)


Fits = Sequence[Fit]


def require_fit(fit: object) -> None:
    """Raise TypeError for anything but a fit, such as the name of its file."""
    require_kind("fit", fit, Fit, "what gb.fit or gb.load returns")


# `fit` and `load` make fits: thirty arguments would hide what a reader of help() looks for.
Fit.__init__.__dict__["__signature__"] = Signature([Parameter("self", Parameter.POSITIONAL_ONLY)])
