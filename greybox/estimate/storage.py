"""Results in HDF5: one file holds the whole answer, in a layout that any HDF5 reader understands.

Layout, version 3 (2 had the criterion as text alone; 1 had no records and no ``white``)
-----------------------------------------------------------------------------------------
``/``            attributes ``format`` ("greybox fit"), ``layout``, ``name``, ``criterion``, ``delay``, ``status``,
                 ``cost``, ``dof``, ``seed``, ``starts``, ``seconds``, ``checksum`` (SHA-256 of the
                 data, part by part); JSON attributes ``costs``, ``versions`` and, of a fit from the
                 command line, ``command``; datasets ``warnings`` and, if any, ``notes``.
``/quantities``  one row per parameter and derived quantity: ``name, value, standard_error, bias,
kind, unit, about,
                 bounds, at_bound, dof``.
``/covariance``  ``names`` (k,) and ``values`` (k, k); if known, ``white`` (p, p) of the free ones
for white errors; if
                 errors are correlated along frequency, ``independent`` (p, p) as if they were not,
                 attribute ``dof``.
``/directions``  if known, ``covariance`` (p, p) of the free parameters within the directions that
the data determine,
                 and the other directions ``unseen`` (p, b) in multiples of ``size`` (p,), ``at``
                 the estimate (p,); if some are not determined, the same beside the estimate in
                 ``elsewhere``.
``/``            has the JSON attribute ``priors`` besides, if there are any: mean and standard deviation by name.
``/equivalents`` if there is an estimate, the parameter vectors (v, p) that give its response.
``/known``       the same, if known, of all the names of the covariance.
``/profiles``    if any, attributes ``name, level`` and, as JSON, ``limit, free, warnings``; a group of each profile by
                 its number: attributes ``name, unit, estimate, standard_error, bias, connected``
                 and, as JSON, ``ends, at_bound``; ``values, costs, roots`` (n,), ``others`` (n, p),
                 ``interval`` and ``bounds`` (2,).
``/runs``        one row per start: ``start`` and ``estimate`` (r, p), ``cost, status, reason, converged, iterations,
                 seconds``, ``minimum`` (the row of ``/minima``, -1 for none); attribute ``free``
                 names the p columns.
``/minima``      ``cost`` (m,), ``estimate`` (m, p), ``variants`` (m,), best first.
``/parts/0 ...`` one group per problem in the sum: attributes ``name, criterion, criterion_class,
is_likelihood, rule,
                 condition, delay, weight, label, equation, checksum`` and, as JSON, ``settings``
                 (of the criterion), ``model, rename, tied, constraints``, and group ``data``. Of a
                 response: attributes ``pade_error, nuisances``, as JSON ``at`` and, if any,
                 ``sine``; groups ``data`` and ``curve`` (``omega, alpha, beta`` and, if known,
                 ``coherence, variance, dof, stretches``), the fitted ``response_alpha,
                 response_beta`` at the data's frequencies. Of a record: attributes ``method,
                 inputs, nuisances``, as JSON ``outputs, biases, gains, driven``; groups ``data``
                 and ``simulated`` (``time`` and ``signals/...``, each with its ``unit`` and, if
                 known, ``hold``), ``initial/...`` by state (stretches,), ``noise`` (k, k) and, if
                 known, ``gain`` (gains,), ``gain_slope`` (gains, m) and ``error`` (k, n). Of all,
                 if known, ``information`` and ``information_alone`` (p, m). Of a manoeuvre: as JSON
                 ``at, ends, outputs``, attribute ``nuisances``; group ``data``, see
                 `greybox.data.transient_file`, ``fitted/...`` by output (2, n), real and imaginary
                 parts, and ``noise`` (k, k).

The file is sealed, see `greybox.files.sealed_files`. NaN means "not known". A file may come from
anyone: nothing in it is executed, nothing that it names is imported, and what is loaded fits
together (SECURITY.md).
"""

import ast
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import numpy as np

from greybox.data.record_file import escaped, read_record, unescaped, write_record
from greybox.data.response_file import read_group, write_group
from greybox.data.transient_file import read_group as read_spectrum_group
from greybox.data.transient_file import write_group as write_spectrum_group
from greybox.estimate.fitted_part import FittedPart, FittedRecord, FittedResponse, FittedSpectrum
from greybox.estimate.fitted_record import criterion_values
from greybox.estimate.identifiability import KnownDirections
from greybox.estimate.profiles import End, ProfileOf, Profiles
from greybox.estimate.result import Fit, Quantity
from greybox.files.sealed_files import Node, Stored, open_sealed, write_sealed
from greybox.files.text_table import printable
from greybox.formulation.included_criteria import CRITERIA, TIME_CRITERIA
from greybox.formulation.input_assumptions import Inputs
from greybox.formulation.prior import as_prior
from greybox.modeling.model import Model
from greybox.modeling.model_file import models_of, module_from_file
from greybox.modeling.sine import Sine
from greybox.solve.minima import Minimum
from greybox.solve.outcome import POLISHED
from greybox.solve.runs import Runs

KIND = "fit"
LAYOUT = 3
_QUANTITY_NUMBERS = ("value", "standard_error", "bias", "bounds", "at_bound", "dof", "box")
_PART_TEXTS = ("name", "rule", "condition", "delay", "label", "equation")
_PROFILE_NUMBERS = ("estimate", "standard_error", "bias")
_PROFILE_COLUMNS = ("values", "costs", "roots")
_CRITERION = ("criterion", "criterion_class", "is_likelihood")
LINES = "\n\t"  # what texts of several lines hold: docstrings, source, warnings


def save(fit: Fit, path: str | Path) -> None:
    """Write `fit` to an HDF5 file; an existing file is replaced only once the new one is complete.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    write_sealed(Path(path), KIND, lambda file: _write(file, fit))


def load(
    path: str | Path, models: Sequence[Model | type[Model] | ModuleType | str | Path] = ()
) -> Fit:
    """Read a `Fit` that `save` wrote. The file may come from anyone, see SECURITY.md.

    Parameters
    ----------
    path : str or Path
    models : sequence
        Models of your own that the fit may use where it evaluates its model (`Fit.response`,
        `gb.predict`): classes, models, modules, or paths of Python files. Those that greybox
        includes are known; no other is imported, whatever the file names.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a greybox fit, is damaged, or was written by a later version.
    """
    path = Path(path)
    given = tuple(model for thing in models for model in _models(thing))
    with open_sealed(path, KIND) as file:
        layout = int(file.attrs["layout"])
        if file.attrs["format"] != "greybox fit":
            raise ValueError(f"its format is {file.attrs['format']!r:.60}")
        if layout <= LAYOUT:
            return replace(_read(file), given=given)
    raise ValueError(
        f"{path} has layout {layout} and this version reads up to {LAYOUT}: install a newer greybox."
    )


def _models(thing: Model | type[Model] | ModuleType | str | Path) -> Sequence[Model | type[Model]]:
    """Return the models that one entry of `models` hands over."""
    if isinstance(thing, (str, Path)):
        return models_of(module_from_file(Path(thing)))
    if isinstance(thing, ModuleType):
        return models_of(thing)
    if isinstance(thing, Model) or (isinstance(thing, type) and issubclass(thing, Model)):
        return [thing]
    raise TypeError(
        f"models has {thing!r:.60}: give model classes, models, modules, or paths of Python files."
    )


def _write(file: Node, fit: Fit) -> None:
    scalars = (
        "name",
        "criterion",
        "delay",
        "status",
        "cost",
        "dof",
        "seed",
        "starts",
        "seconds",
        "checksum",
    )
    _attributes(
        file, format="greybox fit", layout=LAYOUT, **{name: getattr(fit, name) for name in scalars}
    )
    _attributes(file, costs=json.dumps(_finite(fit.costs)), versions=json.dumps(dict(fit.versions)))
    _attributes(file, command=json.dumps(fit.command) if fit.command else None)
    _texts(file, "warnings", fit.warnings)
    if fit.notes:
        _texts(file, "notes", fit.notes)
    group = file.create_group("quantities")
    for column in ("name", "kind", "unit", "about"):
        _texts(group, column, [getattr(q, column) for q in fit.quantities])
    for column in _QUANTITY_NUMBERS:
        group[column] = np.array([getattr(q, column) for q in fit.quantities])
    _texts(file, "covariance/names", fit.names)
    file["covariance/values"] = fit.covariance
    if fit.white is not None:
        file["covariance/white"] = fit.white
    if fit.independent is not None:
        file["covariance/independent"], dof = fit.independent
        _attributes(file["covariance/independent"], dof=dof)
    _write_judgment(file, fit)
    _write_runs(file, fit)
    for k, part in enumerate(fit.parts):
        _write_part(file.create_group(f"parts/{k}"), part)


def _write_profiles(group: Node, profiles: Profiles) -> None:
    _attributes(group, name=profiles.name, level=profiles.level)
    _attributes(
        group,
        **{name: json.dumps(getattr(profiles, name)) for name in ("limit", "free", "warnings")},
    )
    for k, profile in enumerate(profiles.profiles):
        own = group.create_group(str(k))
        _attributes(
            own, **{name: getattr(profile, name) for name in ("name", "unit", *_PROFILE_NUMBERS)}
        )
        _attributes(own, connected=profile.connected)
        _attributes(
            own, **{name: json.dumps(getattr(profile, name)) for name in ("ends", "at_bound")}
        )
        for name in ("interval", "bounds", *_PROFILE_COLUMNS, "others"):
            own[name] = np.asarray(getattr(profile, name), dtype=float)


def _read_profiles(group: Stored) -> Profiles:
    attributes = group.attrs
    free = _json_names(attributes["free"])
    return Profiles(
        name=_text(attributes["name"]),
        level=float(attributes["level"]),
        limit={name: float(value) for name, value in _json_object(attributes["limit"]).items()},
        free=free,
        profiles=tuple(_read_profile(group[str(k)], len(free)) for k in range(len(group))),
        warnings=_json_names(attributes["warnings"], keep=LINES),
    )


def _read_profile(group: Stored, p: int) -> ProfileOf:
    attributes = group.attrs
    count = np.size(group["values"][()])
    ends, at_bound = json.loads(attributes["ends"]), json.loads(attributes["at_bound"])
    _require(len(ends) == 2 and {*ends} <= {*get_args(End)}, "how a profile ended is not known")
    _require(len(at_bound) == 2, "a profile has no two sides")
    interval, bounds = (_array(group[name], (2,)).tolist() for name in ("interval", "bounds"))
    return ProfileOf(
        name=_text(attributes["name"]),
        unit=_text(attributes["unit"]),
        **{name: float(attributes[name]) for name in _PROFILE_NUMBERS if name in attributes},
        **{name: _array(group[name], (count,)) for name in _PROFILE_COLUMNS},
        others=_array(group["others"], (count, p)),
        interval=(interval[0], interval[1]),
        ends=(ends[0], ends[1]),
        bounds=(bounds[0], bounds[1]),
        at_bound=(
            tuple(_text(name) for name in at_bound[0]),
            tuple(_text(name) for name in at_bound[1]),
        ),
        connected=bool(attributes["connected"]),
    )


def _write_judgment(file: Node, fit: Fit) -> None:
    """Write how far the answer can be believed, as far as that is known."""
    if fit.directions is not None:
        _write_directions(file.create_group("directions"), fit.directions)
    if fit.known is not None:
        _write_directions(file.create_group("known"), fit.known)
    if fit.profiles is not None:
        _write_profiles(file.create_group("profiles"), fit.profiles)
    if fit.equivalents is not None:
        file["equivalents"] = fit.equivalents
    if fit.priors:
        _attributes(
            file, priors=json.dumps({name: list(pair) for name, pair in fit.priors.items()})
        )


def _write_runs(file: Node, fit: Fit) -> None:
    group, runs = file.create_group("runs"), Runs.of(fit.runs)
    for column in ("status", "reason", "stage"):
        _texts(group, column, getattr(runs, column))
    for column in ("start", "estimate", "cost", "converged", "iterations", "seconds"):
        group[column] = getattr(runs, column)
    _attributes(group, free=json.dumps(fit.free))

    minimum_of_run = np.full(len(runs), -1)
    for k, minimum in enumerate(fit.minima):
        minimum_of_run[list(minimum.runs)] = k
    group["minimum"] = minimum_of_run

    minima = file.create_group("minima")
    minima["cost"] = np.array([m.cost for m in fit.minima])
    minima["variants"] = np.array([m.variants for m in fit.minima], dtype=int)
    minima["estimate"] = np.array([m.estimate for m in fit.minima]).reshape(
        len(fit.minima), len(fit.free)
    )


def _write_part(group: Node, part: FittedPart) -> None:
    texts = {name: getattr(part, name) for name in _PART_TEXTS}
    criterion = {name: getattr(part, name) for name in _CRITERION}
    _attributes(group, checksum=part.data.checksum, weight=part.weight, **criterion, **texts)
    for name in ("settings", "model", "rename", "tied"):
        _attributes(group, **{name: json.dumps(dict(getattr(part, name)))})
    _attributes(group, constraints=json.dumps(part.constraints))
    for name in ("information", "information_alone"):
        if (values := getattr(part, name)) is not None:
            group[name] = values
    if isinstance(part, FittedRecord):
        _write_fitted_record(group, part)
    elif isinstance(part, FittedSpectrum):
        _write_fitted_spectrum(group, part)
    elif isinstance(part, FittedResponse):
        _write_fitted_response(group, part)


def _write_fitted_response(group: Node, part: FittedResponse) -> None:
    error = math.nan if part.pade_error is None else part.pade_error
    _attributes(group, pade_error=error, nuisances=part.nuisances)
    _attributes(group, at=json.dumps(dict(part.at)))
    _attributes(group, sine=None if part.sine is None else json.dumps(part.sine.plain))
    group["response_alpha"] = part.response.real
    group["response_beta"] = part.response.imag
    for name, response in (("data", part.data), ("curve", part.curve)):
        if response is not None:
            write_group(group.create_group(name), response)


def _write_fitted_record(group: Node, part: FittedRecord) -> None:
    _attributes(
        group,
        method=part.method,
        inputs=part.inputs,
        nuisances=part.nuisances,
        is_static=part.is_static,
    )
    _attributes(
        group,
        **{
            name: json.dumps(getattr(part, name))
            for name in ("outputs", "biases", "gains", "driven")
        },
    )
    write_record(group.create_group("data"), part.data)
    write_record(group.create_group("simulated"), part.simulated)
    group["noise"] = part.noise
    if part.gain is not None:
        group["gain"] = part.gain
    if part.gain_slope is not None:
        group["gain_slope"] = part.gain_slope
    if part.error is not None:
        group["error"] = part.error
    initial = group.create_group("initial", track_order=True)
    for state, values in part.initial.items():
        initial[state] = values


def _write_fitted_spectrum(group: Node, part: FittedSpectrum) -> None:
    _attributes(
        group,
        nuisances=part.nuisances,
        at=json.dumps(dict(part.at)),
        outputs=json.dumps(part.outputs),
    )
    _attributes(group, ends=json.dumps(_finite(part.ends)))
    write_spectrum_group(group.create_group("data"), part.data)
    fitted = group.create_group("fitted", track_order=True)
    for name in part.outputs:
        fitted[escaped(name)] = np.array([part.fitted[name].real, part.fitted[name].imag])
    group["noise"] = part.noise


def _read(file: Stored) -> Fit:
    free = _json_names(file["runs"].attrs["free"])
    runs = _read_runs(file["runs"], len(free))
    attributes = file.attrs
    names = _read_texts(file["covariance/names"])
    fit = Fit(
        name=_text(attributes["name"]),
        parts=tuple(_read_part(file[f"parts/{k}"]) for k in range(len(file["parts"]))),
        quantities=_read_quantities(file["quantities"]),
        free=free,
        names=names,
        covariance=_array(file["covariance/values"], (len(names), len(names))),
        dof=float(attributes["dof"]),
        cost=float(attributes["cost"]),
        costs=_read_costs(_json_object(attributes["costs"])),
        runs=runs,
        minima=_read_minima(file, runs, len(free)),
        warnings=_read_texts(file["warnings"], keep=LINES),
        notes=_read_texts(file["notes"], keep=LINES) if "notes" in file else (),
        seed=int(attributes["seed"]) if "seed" in attributes else None,
        starts=_text(attributes["starts"]),
        seconds=float(attributes["seconds"]),
        command=_json_names(attributes["command"]) if "command" in attributes else (),
        versions=_json_texts(attributes["versions"]),
        white=_array(file["covariance/white"], (len(free), len(free)))
        if "white" in file["covariance"]
        else None,
        independent=_read_independent(file["covariance"], len(free)),
        profiles=_read_profiles(file["profiles"]) if "profiles" in file else None,
        directions=_read_directions(file["directions"], len(free))
        if "directions" in file
        else None,
        known=_read_directions(file["known"], len(names)) if "known" in file else None,
        equivalents=_read_equivalents(file["equivalents"][()], len(free))
        if "equivalents" in file
        else None,
        priors=_read_priors(attributes, free) if "priors" in attributes else {},
    )
    return _checked(fit)


def _read_independent(group: Stored, p: int) -> tuple[Any, float] | None:
    if "independent" not in group:
        return None
    stored = group["independent"]
    return _array(stored, (p, p)), float(stored.attrs["dof"])


def _write_directions(group: Node, directions: KnownDirections) -> None:
    for name in ("covariance", "unseen", "size", "at"):
        group[name] = getattr(directions, name)
    if directions.elsewhere is not None:
        _write_directions(
            group.create_group("elsewhere"), replace(directions.elsewhere, elsewhere=None)
        )


def _read_directions(group: Stored, p: int, *, inside: bool = False) -> KnownDirections:
    unseen = group["unseen"][()]
    _require(
        isinstance(unseen, np.ndarray) and unseen.ndim == 2,
        "the directions that are not determined are missing",
    )
    return KnownDirections(
        _array(group["covariance"], (p, p)),
        _array(group["unseen"], (p, unseen.shape[1])),
        _array(group["size"], (p,)),
        _array(group["at"], (p,)),
        _read_directions(group["elsewhere"], p, inside=True)
        if "elsewhere" in group and not inside
        else None,
    )


def _checked(fit: Fit) -> Fit:
    """Return a fit whose parts agree with one another, so that nothing fails later when it is printed or used."""
    names = [q.name for q in fit.quantities]
    _require(len({*names}) == len(names), "two quantities have the same name")
    _require({*fit.free} <= {*fit.names} <= {*fit.estimate}, "a parameter has no value")
    _require(len({*fit.names}) == len(fit.names), "a parameter appears twice in the covariance")
    _require(bool(fit.parts) and bool(fit.runs), "it has no data or no runs")
    for part in fit.parts:
        for values in (part.information, part.information_alone):
            is_table = values is None or (isinstance(values, np.ndarray) and values.ndim == 2)
            _require(
                is_table and (values is None or len(values) == len(fit.free)),
                "what its data tell is incomplete",
            )
        if isinstance(part, FittedResponse):
            size = len(part.data)
            _require(
                part.response.shape == (size,), "the fitted response and the data differ in length"
            )
            _require(
                part.sine is None or np.size(part.sine.amplitude) in (1, size),
                "an amplitude is missing",
            )
        elif isinstance(part, FittedSpectrum):
            _require(
                {*part.outputs} <= {*part.data.outputs} & {*part.fitted},
                "an output is not in the spectrum",
            )
        else:
            _require(
                np.array_equal(part.data.time, part.simulated.time),
                "the simulated record has other times than its data",
            )
            held = {*part.data.signals} & {*part.simulated.signals}
            _require({*part.outputs} <= held, "an output is not in the record")
            _require(
                part.inputs in get_args(Inputs), "how its inputs run between samples is not known"
            )
    return fit


def _read_equivalents(stored: Any, parameters: int) -> Any:
    shaped = (
        isinstance(stored, np.ndarray)
        and stored.ndim == 2
        and stored.shape[1] == parameters
        and len(stored) > 0
    )
    _require(shaped, "the parameter vectors of one response are not those of its parameters")
    return stored


def _read_priors(
    attributes: Mapping[str, Any], free: Sequence[str]
) -> dict[str, tuple[float, float]]:
    stored = _json_object(attributes["priors"])
    _require({*stored} <= {*free}, "a parameter with a prior was not free")
    return {name: as_prior(value, f"the prior of {name!r:.40}") for name, value in stored.items()}


def _read_costs(stored: Mapping[str, Any]) -> dict[str, float]:
    """Return the costs by the names of the criteria; layouts 1 and 2 have their descriptions."""
    names = {criterion.description: criterion.name for criterion in CRITERIA}
    return {
        names.get(key, key): math.nan if value is None else float(value)
        for key, value in stored.items()
    }


def _read_quantities(group: Stored) -> tuple[Quantity, ...]:
    numbers = [name for name in _QUANTITY_NUMBERS if name != "bias" or "bias" in group]
    rows = _rows(group, ("name", "kind", "unit", "about"), numbers)
    for row in rows:
        _require(
            row["kind"] in ("free", "fixed", "tied", "derived"),
            f"{row['kind']!r:.40} is not a kind of quantity",
        )
    return tuple(
        Quantity(
            **{name: row[name] for name in ("name", "kind", "unit", "about")},
            value=float(row["value"]),
            standard_error=float(row["standard_error"]),
            bounds=(float(row["bounds"][0]), float(row["bounds"][1])),
            box=(float(row["box"][0]), float(row["box"][1])),
            at_bound=bool(row["at_bound"]),
            dof=float(row["dof"]),
            bias=float(row.get("bias", 0.0)),
        )
        for row in rows
    )


def _read_runs(group: Stored, parameters: int) -> Runs:
    texts = {name: _read_texts(group[name]) for name in ("status", "reason")}
    texts["stage"] = (
        _read_texts(group["stage"]) if "stage" in group else (POLISHED,) * len(texts["status"])
    )
    numbers = {
        name: group[name][()]
        for name in ("start", "estimate", "cost", "converged", "iterations", "seconds")
    }
    count = len(texts["status"])
    _require(
        all(len(column) == count for column in (*texts.values(), *numbers.values())),
        "its runs are incomplete",
    )
    for name, values in numbers.items():
        shape = (count, parameters) if name in ("start", "estimate") else (count,)
        numbers[name] = np.asarray(_array(values, shape), dtype=float)
    return Runs(
        indices=np.arange(count),
        start=numbers["start"],
        estimate=numbers["estimate"],
        cost=numbers["cost"],
        converged=numbers["converged"].astype(bool),
        iterations=numbers["iterations"].astype(int),
        seconds=numbers["seconds"],
        **{name: np.array(column, dtype=object) for name, column in texts.items()},
    )


def _rows(group: Stored, texts: Sequence[str], numbers: Sequence[str]) -> list[dict[str, Any]]:
    """Return the rows of a table that is stored by columns, which must be of one length."""
    columns = [
        *(_read_texts(group[name]) for name in texts),
        *(group[name][()] for name in numbers),
    ]
    return [dict(zip((*texts, *numbers), row, strict=True)) for row in zip(*columns, strict=True)]


def _read_minima(file: Stored, runs: Runs, parameters: int) -> tuple[Minimum, ...]:
    group = file["minima"]
    cost, variants = (group[column][()] for column in ("cost", "variants"))
    estimate = _array(group["estimate"], (len(cost), parameters))
    reached = _array(file["runs/minimum"], (len(runs),))
    _require(
        len(reached) == 0 or reached.max() < len(cost),
        "a run ended at a minimum that it does not have",
    )
    best_first = np.lexsort((runs.cost, reached))
    ends = np.searchsorted(reached[best_first], np.arange(len(cost) + 1))
    members = [best_first[begin:end] for begin, end in pairwise(ends)]
    _require(all(map(len, members)), "no run ended at one of its minima")
    return tuple(
        Minimum(float(cost[k]), estimate[k], tuple(found.tolist()), int(variants[k]))
        for k, found in enumerate(members)
    )


def _read_part(group: Stored) -> FittedResponse | FittedRecord | FittedSpectrum:
    attributes = group.attrs
    stated: dict[str, Any] = {name: _text(attributes[name]) for name in _PART_TEXTS}
    stated["equation"] = _text(attributes["equation"], keep=LINES)
    stated["rename"] = _json_texts(attributes["rename"])
    stated["tied"] = _json_texts(attributes["tied"], keep=LINES)
    stated["constraints"] = _json_names(attributes["constraints"], keep=LINES)
    stated["model"] = _json_object(attributes["model"])
    _require(isinstance(stated["model"]["class"], str), "its model has no class")
    _require(
        isinstance(stated["model"]["arguments"], list), "the arguments of its model are not a list"
    )
    _require(
        isinstance(stated["model"]["keywords"], dict), "the keywords of its model have no names"
    )
    stated["weight"] = float(attributes["weight"])
    for name in ("information", "information_alone"):
        stated[name] = group[name][()] if name in group else None
    stated |= (
        _read_criterion(attributes)
        if "settings" in attributes
        else _read_criterion_text(attributes)
    )
    if "fitted" in group:
        part = _read_fitted_spectrum(group, stated)
    else:
        part = (
            _read_fitted_record(group, stated)
            if "simulated" in group
            else _read_fitted_response(group, stated)
        )
    if part.data.checksum != attributes["checksum"]:
        raise KeyError(f"the data of part {attributes['name']!r:.60} do not match their checksum")
    return part


def _read_criterion(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "criterion": _text(attributes["criterion"]),
        "criterion_class": _text(attributes["criterion_class"]),
        "settings": _json_object(attributes["settings"]),
        "is_likelihood": bool(attributes["is_likelihood"]),
    }


def _read_criterion_text(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Read the criterion of layouts 1 and 2, the text of its constructor; without settings where it held functions."""
    text = _text(attributes["criterion"])
    included = {type(criterion).__name__: criterion for criterion in (*CRITERIA, *TIME_CRITERIA)}
    usual: Any = included[text.partition("(")[0]]
    try:
        call: Any = ast.parse(text, mode="eval").body
        return criterion_values(
            replace(usual, **{k.arg: ast.literal_eval(k.value) for k in call.keywords})
        )
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return criterion_values(usual) | {"settings": {"text": text}}


def _read_fitted_response(group: Stored, stated: dict[str, Any]) -> FittedResponse:
    attributes = group.attrs
    error = float(attributes["pade_error"])
    return FittedResponse(
        **stated,
        at={name: float(value) for name, value in _json_object(attributes["at"]).items()},
        sine=Sine(**_json_object(attributes["sine"])) if "sine" in attributes else None,
        pade_error=None if math.isnan(error) else error,
        data=read_group(group["data"]),
        response=group["response_alpha"][()] + 1j * group["response_beta"][()],
        curve=read_group(group["curve"]) if "curve" in group else None,
        nuisances=int(attributes["nuisances"])
        if "nuisances" in attributes
        else _usual_nuisances(stated["criterion"]),
    )


def _read_fitted_spectrum(group: Stored, stated: dict[str, Any]) -> FittedSpectrum:
    attributes = group.attrs
    data = read_spectrum_group(group["data"])
    outputs = _json_names(attributes["outputs"])
    fitted = {
        _text(unescaped(key)): _array(values, (2, len(data)))
        for key, values in group["fitted"].items()
    }
    return FittedSpectrum(
        **stated,
        data=data,
        fitted={name: real + 1j * imaginary for name, (real, imaginary) in fitted.items()},
        outputs=outputs,
        noise=_array(group["noise"], (len(outputs), len(outputs))),
        ends={
            _text(name): math.nan if value is None else float(value)
            for name, value in _json_object(attributes["ends"]).items()
        },
        at={name: float(value) for name, value in _json_object(attributes["at"]).items()},
        nuisances=int(attributes["nuisances"]),
    )


def _usual_nuisances(criterion: str) -> int:
    """Return what files did not state while only criteria of greybox had variances that are estimated along."""
    return next((c.nuisances for c in CRITERIA if c.name == criterion), 0)


def _read_fitted_record(group: Stored, stated: dict[str, Any]) -> FittedRecord:
    attributes = group.attrs
    outputs = _json_names(attributes["outputs"])
    inputs: Any = attributes["inputs"]
    gains = tuple(
        (_text(state), _text(output)) for state, output in json.loads(attributes["gains"])
    )
    slope = group["gain_slope"][()] if "gain_slope" in group else None
    _require(
        slope is None or (slope.ndim == 2 and len(slope) == len(gains)),
        "its gains follow from nothing",
    )
    return FittedRecord(
        **stated,
        data=read_record(group["data"]),
        simulated=read_record(group["simulated"]),
        outputs=outputs,
        noise=_array(group["noise"], (len(outputs), len(outputs))),
        initial={
            _text(state): np.atleast_1d(values[()]) for state, values in group["initial"].items()
        },
        method=_text(attributes["method"]),
        inputs=inputs,
        biases=_json_names(attributes["biases"]),
        gains=gains,
        driven=_json_names(attributes["driven"]),
        gain=_array(group["gain"], (len(gains),)) if "gain" in group else None,
        gain_slope=slope,
        nuisances=int(attributes["nuisances"]),
        is_static=bool(attributes.get("is_static", False)),
        error=_array(group["error"], (len(outputs), len(group["data/time"][()])))
        if "error" in group
        else None,
    )


def _require(true: bool, otherwise: str) -> None:
    """Refuse a file in which things do not fit together."""
    if not true:
        raise ValueError(otherwise)


def _text(value: Any, keep: str = "") -> str:
    """Return a text that can be printed."""
    _require(isinstance(value, str), f"{value!r:.40} is not text")
    return printable(value, keep)


def _array(dataset: Stored, shape: tuple[int, ...]) -> Any:
    """Return the numbers of a dataset that has this shape."""
    _require(
        isinstance(dataset[()], np.ndarray) and dataset[()].shape == shape,
        f"its shape is not {shape}",
    )
    return dataset[()]


def _json_object(text: str) -> dict[str, Any]:
    """Return values by name from JSON."""
    stored = json.loads(text)
    _require(isinstance(stored, dict), f"{stored!r:.40} has no names")
    return {_text(name): value for name, value in stored.items()}


def _json_texts(text: str, keep: str = "") -> dict[str, str]:
    return {name: _text(value, keep) for name, value in _json_object(text).items()}


def _json_names(text: str, keep: str = "") -> tuple[str, ...]:
    stored = json.loads(text)
    _require(isinstance(stored, list), f"{stored!r:.40} is not a list")
    return tuple(_text(name, keep) for name in stored)


def _attributes(group: Node, **values: Any) -> None:
    for name, value in values.items():
        if value is not None:
            group.attrs[name] = value


def _texts(group: Node, name: str, values: Any) -> None:
    import h5py  # noqa: PLC0415  (reading does not need it)

    group.create_dataset(name, data=list(values), dtype=h5py.string_dtype(), shape=(len(values),))


def _read_texts(dataset: Stored, keep: str = "") -> tuple[str, ...]:
    return tuple(_text(text, keep) for text in dataset[()])


def _finite(costs: Any) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in costs.items()}
