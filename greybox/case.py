"""A model at one estimate, as simulation and prediction take it: values, their covariance, and what the fit assumed."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from greybox.answer import Fit, FittedRecord, FittedResponse
from greybox.dynamics import Dynamics, dynamics
from greybox.linear import delay_order
from greybox.model import Model, require_known
from greybox.output_error import OutputError, PredictionError, TimeCriterion
from greybox.record import Record
from greybox.reference import reference, resolve
from greybox.table import counted

Array = NDArray[np.float64]
Inputs = Literal["linear", "held"]


@dataclass(frozen=True, eq=False)
class Case:
    """What is simulated.

    Attributes
    ----------
    label : str
        Name of the model.
    system : Dynamics
    names, q : tuple of str, (declared,) array
        The model's parameters, then biases of sensors and gains of the innovations, and their values.
    covariance : (declared, declared) array or None
        Of these values; None where they came as plain numbers. What ended at its bound counts as exact, and what the
        data do not determine has NaN.
    criterion : TimeCriterion
        How inputs run, which signals are biased, and whether innovations correct the states.
    part : FittedRecord or None
        The record that the values were fitted to.
    """

    label: str
    system: Dynamics
    names: tuple[str, ...]
    q: Array
    covariance: Array | None
    criterion: TimeCriterion
    part: FittedRecord | None

    @property
    def p(self) -> Array:
        """The parameters of the model alone."""
        return self.q[: len(self.system.parameters)]

    @property
    def delays(self) -> Array:
        """The delay of every input (m,), s."""
        return np.asarray(self.system.delay(self.p).full()).ravel()

    @property
    def uncertain(self) -> NDArray[np.integer]:
        """Which values have an error, or one that is not known."""
        if self.covariance is None:
            return np.zeros(0, dtype=int)
        variance = np.diag(self.covariance)
        return np.flatnonzero(np.isnan(variance) | (variance > 0))

    def noise(self, outputs: tuple[str, ...]) -> Array | None:
        """Return the covariance (k, k) of the errors of these outputs, where the fit knows it."""
        if self.part is None or not set(outputs) <= set(self.part.outputs):
            return None
        places = [self.part.outputs.index(name) for name in outputs]
        return self.part.noise[np.ix_(places, places)]

    def free_running(self) -> TimeCriterion:
        """Return the criterion without corrections of the states."""
        return OutputError(inputs=self.criterion.inputs, biases=self.criterion.biases)


def case(
    model: Model | Fit,
    estimate: Mapping[str, float] | Fit | None = None,
    *,
    inputs: Inputs | None = None,
    part: int | None = None,
) -> Case:
    """Bring model and estimate together; a `Fit` may stand for both.

    Raises
    ------
    TypeError, ValueError
        If they do not fit together, or the fit did not converge.
    LookupError
        If the model of a loaded fit cannot be imported.
    """
    if isinstance(model, Fit):
        if estimate is not None:
            cure = "give the record by name, record=r" if isinstance(estimate, Record) else "leave the other out"
            raise TypeError(f"the model is a Fit, which has an estimate of its own: {cure}.")
        _require_answer(model)
        k = _part(model, None, part)
        alive = model.models[k] if model.models else resolve(dict(model.parts[k].model))
        return _of_fit(alive, model, model.parts[k], inputs)
    if not isinstance(model, Model):
        raise TypeError(f"model is {model!r:.80}: give an instance such as LinearTilt(), or a Fit.")
    if isinstance(estimate, Fit):
        _require_answer(estimate)
        return _of_fit(model, estimate, estimate.parts[_part(estimate, model, part)], inputs)
    if not isinstance(estimate, Mapping):
        raise TypeError(f"estimate is {estimate!r:.60}: give {{name: value}} or a Fit.")
    return _of_values(model, estimate, inputs or "linear")


def _of_values(model: Model, estimate: Mapping[str, float], inputs: Inputs) -> Case:
    system = dynamics(model)
    biases = tuple(n for n in (*model.output_names, *model.input_names) if f"{n}_bias" in estimate)
    gains = tuple((s, o) for s in system.states for o in system.outputs if f"K_{s}_{o}" in estimate)
    added = [f"{n}_bias" for n in biases] + [f"K_{s}_{o}" for s, o in gains]
    added = [name for name in added if name not in model.parameters]
    require_known(estimate, (*model.parameters, *added), "parameter", model.label)
    for name, value in estimate.items():
        real = isinstance(value, (int, float, np.number, np.ndarray)) and not (np.ndim(value) or np.iscomplexobj(value))
        if not (real and np.isfinite(value)):
            raise ValueError(f"estimate gives {name!r} the value {value!r:.60}: give a finite number.")
    values = dict(model.values({n: v for n, v in estimate.items() if n in model.parameters}))
    values |= {name: float(estimate[name]) for name in added}
    criterion = _criterion(inputs, tuple(b for b in biases if f"{b}_bias" in added), gains)
    return Case(model.label, system, tuple(values), np.array([*values.values()]), None, criterion, None)


def _of_fit(model: Model, fit: Fit, part: FittedRecord | FittedResponse, inputs: Inputs | None) -> Case:
    record = part if isinstance(part, FittedRecord) else None
    biases, gains = (record.biases, record.gains) if record else ((), ())
    names = [*model.parameters, *(f"{b}_bias" for b in biases), *(f"K_{s}_{o}" for s, o in gains)]
    outside = [part.rename.get(name, name) for name in names]
    missing = [name for name in outside if name not in fit.estimate]
    if missing:
        raise ValueError(
            f"the fit has no {missing[0]!r}, which {model.label} needs; it has {', '.join(fit.estimate)}: "
            "give the model that was fitted, or the values as {name: value}."
        )
    return Case(
        model.label,
        dynamics(model, delay_order(part.delay)),
        tuple(names),
        np.array([fit.estimate[name] for name in outside]),
        _covariance(fit, outside),
        _criterion(inputs or (record.inputs if record else "linear"), biases, gains),
        record,
    )


def _covariance(fit: Fit, names: Sequence[str]) -> Array:
    """Return the covariance of these values, zero for those at a bound: the errors of all others take them as exact."""
    at_bound = {q.name for q in fit.quantities if q.at_bound and q.kind == "free"}
    exact = np.array([name in at_bound for name in names], dtype=bool)
    return np.where(exact | exact[:, None], 0.0, fit.covariance_of(names))


def _criterion(inputs: Inputs, biases: tuple[str, ...], gains: tuple[tuple[str, str], ...]) -> TimeCriterion:
    if gains:
        return PredictionError(inputs=inputs, biases=biases, corrected=tuple(dict.fromkeys(s for s, _ in gains)))
    return OutputError(inputs=inputs, biases=biases)


def _part(fit: Fit, model: Model | None, part: int | None) -> int:
    """Return the part of a fit that is meant: the one asked for, else the first record, of this model if it has one."""
    count = len(fit.parts)
    if part is not None:
        whole = isinstance(part, (int, np.integer)) and not isinstance(part, bool)
        if not whole or not -count <= part < count:
            raise ValueError(f"part is {part!r}: the fit has {counted(count, 'part')}, counted from 0.")
        return part % count
    order = sorted(range(count), key=lambda k: not isinstance(fit.parts[k], FittedRecord))
    own = [k for k in order if model is not None and _class(fit.parts[k].model) == _class(reference(model))]
    return (own or order)[0]


def _class(stated: Mapping[str, object]) -> str:
    """Return a model's class without its module, which is another one where the file was run as a script."""
    return re.sub(r"^.*:", "", str(stated["class"]))


def _require_answer(fit: Fit) -> None:
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate: {fit.status}.")
