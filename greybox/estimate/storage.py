"""Results in HDF5: one file holds the whole answer, in a layout that any HDF5 reader understands.

Layout, version 3 (2 had the criterion as text alone; 1 had no records and no ``white``)
-----------------------------------------------------------------------------------------
``/``            attributes ``format`` ("greybox fit"), ``layout``, ``name``, ``criterion``, ``delay``, ``status``,
                 ``cost``, ``dof``, ``seed``, ``starts``, ``seconds``, ``checksum`` (SHA-256 of the data, part by part);
                 JSON attributes ``costs`` and ``versions``; dataset ``warnings``.
``/quantities``  one row per parameter and derived quantity: ``name, value, standard_error, kind, unit, about, bounds,
                 at_bound, dof``.
``/covariance``  ``names`` (k,) and ``values`` (k, k); if known, ``white`` (p, p) of the free ones for white errors.
``/runs``        one row per start: ``start`` and ``estimate`` (r, p), ``cost, status, reason, converged, iterations,
                 seconds``, ``minimum`` (the row of ``/minima``, -1 for none); attribute ``free`` names the p columns.
``/minima``      ``cost`` (m,), ``estimate`` (m, p), ``variants`` (m,), best first.
``/parts/0 ...`` one group per problem in the sum: attributes ``name, criterion, criterion_class, is_likelihood, rule,
                 condition, delay, weight, label, equation, checksum`` and, as JSON, ``settings`` (of the criterion),
                 ``model, rename, tied, constraints``, and group ``data``.
                 Of a response: attribute ``pade_error``, as JSON ``at`` and, if any, ``sine``; groups ``data`` and
                 ``curve`` (``omega, alpha, beta`` and, if known, ``coherence, variance, dof``) and the fitted
                 ``response_alpha, response_beta`` at the data's frequencies.
                 Of a record: attributes ``method, inputs, nuisances``, as JSON ``outputs, biases, gains``; groups
                 ``data`` and ``simulated`` (``time`` and ``signals/...``, each with its ``unit``), ``initial/...`` by
                 state (stretches,) and ``noise`` (k, k).

The file is sealed, see `greybox.data.sealed_files`. NaN means "not known". Nothing in a file is executed when it is
loaded.
"""

import ast
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from greybox.data.record_file import read_record, write_record
from greybox.data.response_file import read_group, write_group
from greybox.data.sealed_files import Node, open_sealed, write_sealed
from greybox.estimate.fitted_record import criterion_values
from greybox.estimate.result import Fit, FittedRecord, FittedResponse, Quantity
from greybox.formulation.included_criteria import CRITERIA, TIME_CRITERIA
from greybox.modeling.sine import Sine
from greybox.solve.minima import Minimum
from greybox.solve.outcome import Run

KIND = "fit"
LAYOUT = 3
_PART_TEXTS = ("name", "rule", "condition", "delay", "label", "equation")
_CRITERION = ("criterion", "criterion_class", "is_likelihood")


def save(fit: Fit, path: str | Path) -> None:
    """Write `fit` to an HDF5 file; an existing file is replaced only once the new one is complete.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    write_sealed(Path(path), KIND, lambda file: _write(file, fit))


def load(path: str | Path) -> Fit:
    """Read a `Fit` that `save` wrote. The model is imported by name only when `Fit.response` asks for it.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a greybox fit, is damaged, or was written by a later version.
    """
    path = Path(path)
    with open_sealed(path, KIND) as file:
        layout = int(file.attrs["layout"])
        if file.attrs["format"] != "greybox fit":
            raise ValueError(f"its format is {file.attrs['format']!r}")
        if layout <= LAYOUT:
            return _read(file)
    raise ValueError(f"{path} has layout {layout} and this version reads up to {LAYOUT}: install a newer greybox.")


def _write(file: Node, fit: Fit) -> None:
    scalars = ("name", "criterion", "delay", "status", "cost", "dof", "seed", "starts", "seconds", "checksum")
    _attributes(file, format="greybox fit", layout=LAYOUT, **{name: getattr(fit, name) for name in scalars})
    _attributes(file, costs=json.dumps(_finite(fit.costs)), versions=json.dumps(dict(fit.versions)))
    _texts(file, "warnings", fit.warnings)
    group = file.create_group("quantities")
    for column in ("name", "kind", "unit", "about"):
        _texts(group, column, [getattr(q, column) for q in fit.quantities])
    for column in ("value", "standard_error", "bounds", "at_bound", "dof"):
        group[column] = np.array([getattr(q, column) for q in fit.quantities])
    _texts(file, "covariance/names", fit.names)
    file["covariance/values"] = fit.covariance
    if fit.white is not None:
        file["covariance/white"] = fit.white
    _write_runs(file, fit)
    for k, part in enumerate(fit.parts):
        _write_part(file.create_group(f"parts/{k}"), part)


def _write_runs(file: Node, fit: Fit) -> None:
    group = file.create_group("runs")
    for column in ("status", "reason"):
        _texts(group, column, [getattr(run, column) for run in fit.runs])
    for column in ("start", "estimate", "cost", "converged", "iterations", "seconds"):
        group[column] = np.array([getattr(run, column) for run in fit.runs])
    _attributes(group, free=json.dumps(fit.free))

    minimum_of_run = np.full(len(fit.runs), -1)
    for k, minimum in enumerate(fit.minima):
        minimum_of_run[list(minimum.runs)] = k
    group["minimum"] = minimum_of_run

    minima = file.create_group("minima")
    minima["cost"] = np.array([m.cost for m in fit.minima])
    minima["variants"] = np.array([m.variants for m in fit.minima], dtype=int)
    minima["estimate"] = np.array([m.estimate for m in fit.minima]).reshape(len(fit.minima), len(fit.free))


def _write_part(group: Node, part: FittedResponse | FittedRecord) -> None:
    texts = {name: getattr(part, name) for name in _PART_TEXTS}
    criterion = {name: getattr(part, name) for name in _CRITERION}
    _attributes(group, checksum=part.data.checksum, weight=part.weight, **criterion, **texts)
    for name in ("settings", "model", "rename", "tied"):
        _attributes(group, **{name: json.dumps(dict(getattr(part, name)))})
    _attributes(group, constraints=json.dumps(part.constraints))
    if isinstance(part, FittedRecord):
        _write_fitted_record(group, part)
    else:
        _write_fitted_response(group, part)


def _write_fitted_response(group: Node, part: FittedResponse) -> None:
    _attributes(group, pade_error=math.nan if part.pade_error is None else part.pade_error)
    _attributes(group, at=json.dumps(dict(part.at)))
    _attributes(group, sine=None if part.sine is None else json.dumps(part.sine.plain))
    group["response_alpha"] = part.response.real
    group["response_beta"] = part.response.imag
    for name, response in (("data", part.data), ("curve", part.curve)):
        if response is not None:
            write_group(group.create_group(name), response)


def _write_fitted_record(group: Node, part: FittedRecord) -> None:
    _attributes(group, method=part.method, inputs=part.inputs, nuisances=part.nuisances)
    _attributes(group, **{name: json.dumps(getattr(part, name)) for name in ("outputs", "biases", "gains")})
    write_record(group.create_group("data"), part.data)
    write_record(group.create_group("simulated"), part.simulated)
    group["noise"] = part.noise
    initial = group.create_group("initial", track_order=True)
    for state, values in part.initial.items():
        initial[state] = values


def _read(file: Node) -> Fit:
    free = tuple(json.loads(file["runs"].attrs["free"]))
    runs = _read_runs(file["runs"])
    attributes = file.attrs
    return Fit(
        name=str(attributes["name"]),
        parts=tuple(_read_part(file[f"parts/{k}"]) for k in range(len(file["parts"]))),
        quantities=_read_quantities(file["quantities"]),
        free=free,
        names=_read_texts(file["covariance/names"]),
        covariance=file["covariance/values"][()],
        dof=float(attributes["dof"]),
        cost=float(attributes["cost"]),
        costs=_read_costs(json.loads(attributes["costs"])),
        runs=runs,
        minima=_read_minima(file, runs),
        warnings=_read_texts(file["warnings"]),
        seed=int(attributes["seed"]) if "seed" in attributes else None,
        starts=str(attributes["starts"]),
        seconds=float(attributes["seconds"]),
        versions=json.loads(attributes["versions"]),
        white=file["covariance/white"][()] if "white" in file["covariance"] else None,
    )


def _read_costs(stored: dict[str, float | None]) -> dict[str, float]:
    """Return the costs by the names of the criteria; layouts 1 and 2 have their descriptions."""
    names = {criterion.description: criterion.name for criterion in CRITERIA}
    return {names.get(key, key): math.nan if value is None else value for key, value in stored.items()}


def _read_quantities(group: Node) -> tuple[Quantity, ...]:
    rows = _rows(group, ("name", "kind", "unit", "about"), ("value", "standard_error", "bounds", "at_bound", "dof"))
    return tuple(
        Quantity(
            **{name: row[name] for name in ("name", "kind", "unit", "about")},
            value=float(row["value"]),
            standard_error=float(row["standard_error"]),
            bounds=(float(row["bounds"][0]), float(row["bounds"][1])),
            at_bound=bool(row["at_bound"]),
            dof=float(row["dof"]),
        )
        for row in rows
    )


def _read_runs(group: Node) -> tuple[Run, ...]:
    rows = _rows(group, ("status", "reason"), ("start", "estimate", "cost", "converged", "iterations", "seconds"))
    return tuple(
        Run(
            index=k,
            start=row["start"],
            estimate=row["estimate"],
            cost=float(row["cost"]),
            status=row["status"],
            reason=row["reason"],
            converged=bool(row["converged"]),
            iterations=int(row["iterations"]),
            seconds=float(row["seconds"]),
        )
        for k, row in enumerate(rows)
    )


def _rows(group: Node, texts: Sequence[str], numbers: Sequence[str]) -> list[dict[str, Any]]:
    """Return the rows of a table that is stored by columns, which must be of one length."""
    columns = [*(_read_texts(group[name]) for name in texts), *(group[name][()] for name in numbers)]
    return [dict(zip((*texts, *numbers), row, strict=True)) for row in zip(*columns, strict=True)]


def _read_minima(file: Node, runs: tuple[Run, ...]) -> tuple[Minimum, ...]:
    minimum, group = file["runs/minimum"][()], file["minima"]
    cost, estimate, variants = (group[c][()] for c in ("cost", "estimate", "variants"))
    result = []
    for k in range(len(cost)):
        members = sorted(np.flatnonzero(minimum == k).tolist(), key=lambda i: runs[i].cost)
        result.append(Minimum(float(cost[k]), estimate[k], tuple(members), int(variants[k])))
    return tuple(result)


def _read_part(group: Node) -> FittedResponse | FittedRecord:
    attributes = group.attrs
    stated: dict[str, Any] = {name: str(attributes[name]) for name in _PART_TEXTS}
    stated |= {name: json.loads(attributes[name]) for name in ("model", "rename", "tied")}
    stated["constraints"] = tuple(json.loads(attributes["constraints"]))
    stated["weight"] = float(attributes["weight"])
    stated |= _read_criterion(attributes) if "settings" in attributes else _read_criterion_text(attributes)
    part = _read_fitted_record(group, stated) if "simulated" in group else _read_fitted_response(group, stated)
    if part.data.checksum != attributes["checksum"]:
        raise KeyError(f"the data of part {attributes['name']!r} do not match their checksum")
    return part


def _read_criterion(attributes: Any) -> dict[str, Any]:
    return {
        "criterion": str(attributes["criterion"]),
        "criterion_class": str(attributes["criterion_class"]),
        "settings": json.loads(attributes["settings"]),
        "is_likelihood": bool(attributes["is_likelihood"]),
    }


def _read_criterion_text(attributes: Any) -> dict[str, Any]:
    """Read the criterion of layouts 1 and 2, the text of its constructor; without settings where it held functions."""
    text = str(attributes["criterion"])
    included = {type(criterion).__name__: criterion for criterion in (*CRITERIA, *TIME_CRITERIA)}
    usual: Any = included[text.partition("(")[0]]
    try:
        call: Any = ast.parse(text, mode="eval").body
        return criterion_values(replace(usual, **{k.arg: ast.literal_eval(k.value) for k in call.keywords}))
    except (ValueError, SyntaxError):
        return criterion_values(usual) | {"settings": {"text": text}}


def _read_fitted_response(group: Node, stated: dict[str, Any]) -> FittedResponse:
    attributes = group.attrs
    error = float(attributes["pade_error"])
    return FittedResponse(
        **stated,
        at=json.loads(attributes["at"]),
        sine=Sine(**json.loads(attributes["sine"])) if "sine" in attributes else None,
        pade_error=None if math.isnan(error) else error,
        data=read_group(group["data"]),
        response=group["response_alpha"][()] + 1j * group["response_beta"][()],
        curve=read_group(group["curve"]) if "curve" in group else None,
    )


def _read_fitted_record(group: Node, stated: dict[str, Any]) -> FittedRecord:
    attributes = group.attrs
    return FittedRecord(
        **stated,
        data=read_record(group["data"]),
        simulated=read_record(group["simulated"]),
        outputs=tuple(json.loads(attributes["outputs"])),
        noise=group["noise"][()],
        initial={state: values[()] for state, values in group["initial"].items()},
        method=str(attributes["method"]),
        inputs=attributes["inputs"],
        biases=tuple(json.loads(attributes["biases"])),
        gains=tuple((state, output) for state, output in json.loads(attributes["gains"])),
        nuisances=int(attributes["nuisances"]),
    )


def _attributes(group: Node, **values: Any) -> None:
    for name, value in values.items():
        if value is not None:
            group.attrs[name] = value


def _texts(group: Node, name: str, values: Any) -> None:
    group.create_dataset(name, data=list(values), dtype=h5py.string_dtype(), shape=(len(values),))


def _read_texts(dataset: Node) -> tuple[str, ...]:
    return tuple(dataset.asstr()[()].tolist())


def _finite(costs: Any) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in costs.items()}
