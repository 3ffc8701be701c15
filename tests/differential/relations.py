"""Families of pairs whose answers are equal, whatever the truth is.

The same experiment is stated in two ways: with another origin of time, in other units, in another
order, under other names, or the answer goes through a worker, a file or pickle. No reference is
needed.
"""

import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import greybox as gb
from differential.clocks import uniform
from differential.models import importable, plant
from differential.records import Experiment, experiment, record, step_of
from differential.responses import CRITERIA, measurement, structure

# Standard errors between two statements of one problem. Solvers stop at 1e-4, and rounding decides
# where within.
SAME = 0.01

# Of the range of an output.
CONTINUED = 1e-6

SIGNALS = ("states", "inputs", "outputs")
CURVES = ("linear", "cubic", "drag", "tanh")


def _experiment(rng: np.random.Generator, **options: Any) -> Experiment:
    """Return an experiment of about a hundred samples."""
    system = plant(rng, CURVES, **options)
    return experiment(rng, system, uniform(rng, step_of(system), 100), missing=rng.random() < 0.2)


def _fit(model: Any, data: gb.Record, starts: Any = 1, **options: Any) -> gb.Fit:
    """Return the fit of one record from the declared values."""
    return gb.fit(gb.Problem(model, data, **options), starts, progress=False)


def _restated(
    model: Any,
    parameters: dict[str, gb.Parameter],
    *,
    read_states: Callable[[Any], Any] = lambda x: x,
    read_inputs: Callable[[Any], Any] = lambda u: u,
    read_values: Callable[[Any], Any] = lambda p: p,
    slopes: Callable[[Any], Any] = tuple,
    results: Callable[[Any], Any] = tuple,
    **signals: Any,
) -> Any:
    """Return a model with other parameters and signals whose formulas are those of `model`.

    The first three functions return what the formulas of `model` read; `slopes` and `results`
    change the derivatives and outputs that they return.
    """

    def derivative(_, x, u, p):
        return tuple(slopes(model.derivative(read_states(x), read_inputs(u), read_values(p))))

    def output(_, x, u, p):
        return tuple(results(model.output(read_states(x), read_inputs(u), read_values(p))))

    body = {"__doc__": "A restated plant.", "derivative": derivative, "output": output}
    same = {kind: getattr(model, kind) for kind in (*SIGNALS, "delays")}
    return importable(gb.StateSpace, body | same | signals | dict(parameters))()


def _scaled(parameter: gb.Parameter, factor: float) -> gb.Parameter:
    """Return the parameter in another unit."""
    low, high = parameter.bounds
    return gb.Parameter(factor * parameter.start, bounds=(factor * low, factor * high))


def _difference(
    what: Any, fit: gb.Fit, other: gb.Fit, same: Callable[[str], tuple[str, float]], tolerance=SAME
) -> str | None:
    """Return where the other fit has another estimate; `same` gives its name and unit there."""
    if not fit.converged:
        return f"{what}: did not converge" if other.converged else None
    if not other.converged:
        return f"{what}: converges in the first statement only"
    for name, value in fit.estimate.items():
        label, factor = same(name)
        off = (other.estimate[label] / factor - value) / (fit.standard_error[name] or 1.0)
        if not abs(off) <= tolerance:
            return f"{what}: {name} differs by {off:.2g} standard errors"
        ratio = other.standard_error[label] / factor / (fit.standard_error[name] or 1.0)
        if not abs(ratio - 1) <= max(tolerance, 1e-9):
            return f"{what}: the standard error of {name} is {ratio:.4g} times the first"
    return None


def _unchanged(name: str) -> tuple[str, float]:
    return name, 1.0


def origin(rng: np.random.Generator) -> str | None:
    """Another origin of time."""
    case = _experiment(rng, delayed=rng.random() < 0.3)
    data = case.record
    moved = float(rng.choice([-1e3, 1e2, 1e4])) * step_of(case.plant)
    other = gb.Record(data.time + moved, data.signals, hold=data.hold)
    fits = (_fit(case.plant.model, r) for r in (data, other))
    return _difference(case, *fits, _unchanged)


def unit_of_time(rng: np.random.Generator) -> str | None:
    """Time in another unit; slopes and delays change with it."""
    case = _experiment(rng, delayed=rng.random() < 0.3)
    model, data = case.plant.model, case.record
    factor = float(rng.choice([1e-3, 60.0, 1e3]))
    delays = set(model.delays.values())
    parameters = {
        n: _scaled(p, factor if n in delays else 1.0) for n, p in model.parameters.items()
    }
    restated = _restated(model, parameters, slopes=lambda slopes: [s / factor for s in slopes])
    other = _fit(restated, gb.Record(factor * data.time, data.signals, hold=data.hold))
    return _difference(
        case, _fit(model, data), other, lambda n: (n, factor if n in delays else 1.0)
    )


def unit_of_signals(rng: np.random.Generator) -> str | None:
    """Inputs and outputs in other units."""
    case = _experiment(rng)
    model, data = case.plant.model, case.record
    factors = {
        n: float(rng.choice([1e-3, 0.3048, 57.3, 1e3])) for n in (*model.inputs, *model.outputs)
    }
    restated = _restated(
        model,
        model.parameters,
        read_inputs=lambda u: SimpleNamespace(
            **{n: getattr(u, n) / factors[n] for n in model.inputs}
        ),
        results=lambda y: [factors[n] * v for n, v in zip(model.outputs, y, strict=True)],
    )
    signals = {name: factors[name] * values for name, values in data.signals.items()}
    other = _fit(restated, gb.Record(data.time, signals, hold=data.hold))
    return _difference(case, _fit(model, data), other, _unchanged)


def unit_of_parameters(rng: np.random.Generator) -> str | None:
    """Parameters in other units."""
    case = _experiment(rng)
    model, data = case.plant.model, case.record
    factors = {name: float(10.0 ** rng.integers(-4, 5)) for name in model.parameters}
    parameters = {name: _scaled(p, factors[name]) for name, p in model.parameters.items()}
    restated = _restated(
        model,
        parameters,
        read_values=lambda p: SimpleNamespace(**{n: getattr(p, n) / f for n, f in factors.items()}),
    )
    other = _fit(restated, data)
    return _difference(case, _fit(model, data), other, lambda n: (n, factors[n]))


def order_of_records(rng: np.random.Generator) -> str | None:
    """The records of a fit in another order."""
    system = plant(rng, CURVES)
    cases = [experiment(rng, system, uniform(rng, step_of(system), 60)) for _ in range(3)]
    data = [case.record for case in cases]
    fits = (
        gb.fit(gb.several(system.model, order), 1, progress=False) for order in (data, data[::-1])
    )
    return _difference(cases[0], *fits, _unchanged)


def names(rng: np.random.Generator) -> str | None:
    """Other names of parameters and signals, and parameters declared in another order."""
    case = _experiment(rng)
    model, data = case.plant.model, case.record
    signals = (*model.states, *model.inputs, *model.outputs)
    new = {name: f"{name}_renamed" for name in (*signals, *model.parameters)}

    def under_old_names(names):
        return lambda values: SimpleNamespace(**{n: getattr(values, new[n]) for n in names})

    restated = _restated(
        model,
        {new[name]: parameter for name, parameter in reversed(model.parameters.items())},
        read_states=under_old_names(model.states),
        read_inputs=under_old_names(model.inputs),
        read_values=under_old_names(model.parameters),
        **{kind: tuple(new[n] for n in getattr(model, kind)) for kind in SIGNALS},
    )
    renamed = gb.Record(
        data.time,
        {new[name]: values for name, values in data.signals.items()},
        hold={new[name]: value for name, value in data.hold.items()},
    )
    # The answer has a name of its own for one parameter.
    answer = new | {"k": "gain"}
    other = _fit(restated, renamed, rename={new["k"]: "gain"})
    return _difference(case, _fit(model, data), other, lambda n: (answer[n], 1.0))


def unused_signals(rng: np.random.Generator) -> str | None:
    """An output that the record lacks, before the others, and a signal that the model lacks."""
    case = _experiment(rng)
    model, data = case.plant.model, case.record
    extended = _restated(
        model,
        model.parameters,
        results=lambda y: (y[0] ** 2 - 1, *y),
        outputs=("more", *model.outputs),
    )
    signals = {"other": np.cos(data.time), **data.signals}
    other = _fit(extended, gb.Record(data.time, signals, hold=data.hold))
    return _difference(case, _fit(model, data), other, _unchanged)


def cut(rng: np.random.Generator) -> str | None:
    """A simulation that is cut at a sample and continued from the state there."""
    system = plant(rng, CURVES)
    case = experiment(rng, system, uniform(rng, step_of(system), 60))
    drive = record(system, case.clock.time, case.motion)

    def simulated(data, initial):
        known = dict(zip(system.states, map(float, initial), strict=True))
        return gb.simulate(system.model, system.truth, record=data, initial=known)

    whole = simulated(drive, case.initial)
    first = int(rng.integers(5, 50))
    rest = simulated(
        drive.between(drive.time[first], np.inf), [whole[n][first] for n in system.states]
    )
    for name in system.outputs:
        error = np.abs(rest[name] - whole[name][first:]).max() / np.ptp(whole[name])
        if not error < CONTINUED:
            return f"{case}, cut at sample {first}: {name} differs by {error:.2g} of its range"
    return None


def workers(rng: np.random.Generator) -> str | None:
    """The runs made by workers, one of them from a start that needs finer steps."""
    case = _experiment(rng, order=2)
    truth, parameters = case.plant.truth, dict(case.plant.model.parameters)
    for name in ("a", "d"):
        wide = truth[name] / 200, truth[name] * 200
        parameters[name] = gb.Parameter(parameters[name].start, bounds=wide)
    model, data = _restated(case.plant.model, parameters), case.record
    # A damper so strong that steps of a sample are unstable.
    far = {"a": rng.uniform(10, 60) * truth["a"], "d": rng.uniform(40, 120) * truth["d"]}
    starts = [{}, {name: float(value) for name, value in far.items()}]
    with gb.solve.WorkerPool(int(rng.integers(1, 3))) as pool:
        other = gb.fit(gb.Problem(model, data), starts, executor=pool, progress=False)
    fit = _fit(model, data, starts)
    for number, (run, twin) in enumerate(zip(fit.runs, other.runs, strict=True)):
        if not (run.status == twin.status and np.array_equal(run.cost, twin.cost, equal_nan=True)):
            return f"{case}: run {number} ends as {run.status!r} here, as {twin.status!r} there"
    return _difference(case, fit, other, _unchanged, 0.0)


def file(rng: np.random.Generator) -> str | None:
    """A fit that is saved and loaded."""
    case = _experiment(rng, delayed=rng.random() < 0.3)
    fit = _fit(case.plant.model, case.record)
    with tempfile.TemporaryDirectory() as folder:
        gb.save(fit, Path(folder) / "fit.h5")
        other = gb.load(Path(folder) / "fit.h5", models=[type(case.plant.model)])
    return _difference(case, fit, other, _unchanged, 0.0) or _other_use(case, fit, other)


def pickled(rng: np.random.Generator) -> str | None:
    """A fit that went through pickle."""
    case = _experiment(rng, delayed=rng.random() < 0.3)
    fit = _fit(case.plant.model, case.record)
    other = pickle.loads(pickle.dumps(fit))
    return _difference(case, fit, other, _unchanged, 0.0) or _other_use(case, fit, other)


def _other_use(case: Experiment, fit: gb.Fit, other: gb.Fit) -> str | None:
    """Return where a simulation with the other fit is another one."""
    if not fit.converged:
        return None
    first, second = (gb.simulate(f, record=case.record) for f in (fit, other))
    name = case.plant.outputs[0]
    equal = np.array_equal(first[name], second[name], equal_nan=True)
    return None if equal else f"{case}: a simulation with the other fit differs"


def response(rng: np.random.Generator) -> str | None:
    """A response whose points are in another order, and whose output is in another unit."""
    system = structure(rng)
    omega = np.geomspace(0.1, 6, 25) * system.corner
    data = measurement(rng, omega, system.response(omega, system.truth)[:, 0])
    model, factor = system.model(rng), float(rng.choice([1e-3, 57.3, 1e3]))
    points = rng.permutation(omega.size)
    other_data = gb.FrequencyResponse(
        omega[points],
        factor * data.response[points],
        input="u",
        output="q",
        variance=factor**2 * data.variance[points],
    )
    # Another gain in the same place: everything else is the same structure.
    other_model = importable(
        type(model), {"__doc__": "In another unit.", "K": _scaled(model.parameters["K"], factor)}
    )()
    criterion = CRITERIA[rng.integers(len(CRITERIA))][0]
    fits = (
        gb.fit(gb.Problem(m, d, criterion), 20, progress=False)
        for m, d in ((model, data), (other_model, other_data))
    )
    where = f"{system.name}, {type(criterion).__name__}"
    return _difference(where, *fits, lambda n: (n, factor if n == "K" else 1.0))


FAMILIES = {
    "relation-origin": origin,
    "relation-unit-of-time": unit_of_time,
    "relation-unit-of-signals": unit_of_signals,
    "relation-unit-of-parameters": unit_of_parameters,
    "relation-order-of-records": order_of_records,
    "relation-names": names,
    "relation-unused-signals": unused_signals,
    "relation-cut": cut,
    "relation-workers": workers,
    "relation-file": file,
    "relation-pickle": pickled,
    "relation-response": response,
}
