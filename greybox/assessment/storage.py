"""Fits in HDF5: one file holds the whole answer.

The text ``/fit`` is a list in JSON: the number of this layout, the checksum of the data, and the
fields of a `Fit`, see `greybox.assessment.stored_values`. The database of a study has the same
text.

The file is sealed, see `greybox.data.files.sealed_files`. NaN means "not known". A file may come
from anyone: nothing in it is executed, nothing that it names is imported, and the loaded values are
checked for consistency (SECURITY.md).
"""

import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from greybox.assessment.fitted_part import require_shapes
from greybox.assessment.result import Fit, require_fit
from greybox.assessment.stored_values import fields_of, read, require, write
from greybox.data.files.argument_checks import checked_items
from greybox.data.files.bounded_json import parsed
from greybox.data.files.control_characters import printable
from greybox.data.files.escapes import in_sentences
from greybox.data.files.public import public
from greybox.data.files.safe_files import HDF5
from greybox.data.files.sealed_files import read_sealed, write_sealed
from greybox.engine.solve.runs import Runs
from greybox.modeling.formulation.prior import normal_prior
from greybox.modeling.model import Model
from greybox.modeling.model_file import models_of, module_from_file

LAYOUT = 11
# Errors that reading a damaged or hostile file may raise.
READ_ERRORS = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError)

# A model of the user, or what contains some
ModelSource = Model | type[Model] | ModuleType | str | Path


@public
def save(fit: Fit, path: str | Path) -> None:
    """Write `fit` to an HDF5 file; an existing file is replaced only once the new one is complete.

    Raises
    ------
    ValueError
        If the name of the file does not end in .h5 or .hdf5: it would be taken for something else.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> gb.save(fit, "pitch.h5")
    >>> gb.load("pitch.h5").cost == fit.cost
    True
    """
    require_fit(fit)
    path = Path(path)
    if path.suffix.lower() not in HDF5:
        raise ValueError(
            f"{path} is not the name of an HDF5 file: give one that ends in {' or '.join(HDF5)}; "
            "for JSON see Fit.to_json."
        )
    write_sealed(path, to_bytes(fit))


@public
@in_sentences
def load(path: str | Path, models: ModelSource | Iterable[ModelSource] = ()) -> Fit:
    """Read a `Fit` that `save` wrote. The file may come from anyone, see SECURITY.md.

    Parameters
    ----------
    path : str or Path
    models : iterable, or one of its entries
        Your own models, with which the fit can evaluate its response (`Fit.response`,
        `gb.predict`): classes, models, modules, or paths of Python files. The models of greybox
        are known; no other model is imported, whatever the file names.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it is not a greybox fit, is damaged, or was written by another version, and if a given
        model has other parameters than the fitted one.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> fit = gb.fit(pitch_hover.problem(), starts=20)
    >>> gb.save(fit, "pitch.h5")
    >>> again = gb.load("pitch.h5")  # models=[Mine] for a model of your own
    >>> again.estimate == fit.estimate
    True
    """
    fit = from_bytes(read_sealed(path), models, f"{path}")
    if fit.given:
        # A given model with other parameters than the fitted one raises its error here.
        for part in range(len(fit.parts)):
            with suppress(LookupError):  # a model that is not given may not be needed
                fit.model_of(part)
    return fit


def to_bytes(fit: Fit) -> bytes:
    """Return a fit as JSON with its arrays."""
    # Runs are stored as columns, also those of a fit that has them one by one.
    fit = replace(fit, runs=Runs.of(fit.runs))
    return json.dumps([LAYOUT, fit.checksum, write(fit)]).encode()


def from_bytes(
    data: bytes, models: Any, place: str = "the stored fit", stored: int | None = None
) -> Fit:
    """Return the fit that `to_bytes` wrote.

    Parameters
    ----------
    data : bytes
    models : iterable, or one of its entries
        As in `load`.
    place : str
        What messages call the fit.
    stored : int, optional
        Size of the data in their file, where they may be compressed; by default their length.

    Raises
    ------
    ValueError
        If it is damaged, or was written by another version.
    """
    given = _given_models(models)
    try:
        layout, checksum, values = parsed(data, len(data) if stored is None else stored)
        is_sine = layout == LAYOUT and _pop_sines(values)
        # An older layout is refused, not converted: fits are cheap to repeat.
        if layout == LAYOUT and not is_sine:
            fit = read(values, Fit)
            _require_consistent(fit, checksum)
            return replace(fit, given=tuple(given))
        cure = "install a newer greybox" if layout > LAYOUT else "fit again"
    except READ_ERRORS as error:
        raise ValueError(
            f"{place} is not a greybox fit or is damaged ({printable(str(error))})."
        ) from None

    if is_sine:
        raise ValueError(
            f"{place} is a fit to a sine of finite amplitude, which this version cannot make: fit "
            "the record in the time domain."
        )
    raise ValueError(f"{place} has layout {layout} and this version reads {LAYOUT}: {cure}.")


def _given_models(models: Any) -> list[Model | type[Model]]:
    """Return the models of the argument `models` of `load`."""
    accepted = "model classes, models, modules, or paths of Python files"
    given: list[Model | type[Model]] = []
    for entry in checked_items("models", models, Model | type | ModuleType | str | Path, accepted):
        source = module_from_file(entry) if isinstance(entry, str | Path) else entry
        if isinstance(source, ModuleType):
            given += models_of(source)
        else:
            given.append(source)
    return given


def _pop_sines(values: Any) -> bool:
    """Remove the former field `sine` from all parts; return whether a part had such a sine."""
    sines = [part.pop("sine", None) for part in values["parts"]]
    return any(sine is not None for sine in sines)


def _require_consistent(fit: Fit, checksum: str) -> None:
    """Require that the values of a fit agree with one another, so that it can be printed and used.

    Raises
    ------
    ValueError
        The message names what does not agree.
    """
    # Everything that printing, predicting and comparing rely on is checked: a damaged or hostile
    # file must be refused here, with a sentence.
    # Printing a fit looks quantities up by name: a duplicate would hide one of them.
    names = [q.name for q in fit.quantities]
    require(len({*names}) == len(names), "two quantities have the same name")
    require(bool(fit.parts) and len(fit.runs.cost) > 0, "it has no data or no runs")
    require({*fit.priors} <= {*fit.free}, "a parameter with a prior was not free")

    for name, prior in fit.priors.items():
        normal_prior(prior, f"the prior of {name!r:.40}")

    # The shape of an array is a letter for each axis.
    sizes = {"p": len(fit.free), "k": len(fit.names), "r": len(fit.runs.cost)}
    require_shapes(fit, {"covariance": "kk", "white": "pp"}, sizes)
    if fit.independent is not None:
        size = (sizes["p"], sizes["p"])
        require(fit.independent[0].shape == size, "independent has another shape")

    if fit.directions is not None:
        axes = {"covariance": "kk", "unseen": "k*", "size": "k", "at": "k"}
        require_shapes(fit.directions, axes, sizes)
    if fit.directions is not None and fit.directions.elsewhere is not None:
        axes = {"covariance": "pp", "unseen": "p*", "size": "p", "at": "p"}
        require_shapes(fit.directions.elsewhere, axes, sizes)

    # Runs are columns: in a shorter one, values would belong to other runs.
    columns = dict.fromkeys(fields_of(type(fit.runs)), "r")
    require_shapes(fit.runs, columns | {"start": "rp", "estimate": "rp"}, sizes)
    require(np.array_equal(fit.runs.indices, np.arange(sizes["r"])), "its runs are not in order")
    for minimum in fit.minima:
        require_shapes(minimum, {"estimate": "p"}, sizes)
        require(len(minimum.runs) > 0, "no run ended at one of its minima")
        has_runs = min(minimum.runs) >= 0 and max(minimum.runs) < sizes["r"]
        require(has_runs, "a minimum belongs to a run that it does not have")

    require(fit.checksum == checksum, "its data do not match their checksum")
    for part in fit.parts:
        part.check()
    if fit.profiles is not None:
        for profile in fit.profiles.profiles:
            sizes = {"n": len(profile.values), "f": len(fit.profiles.free)}
            require_shapes(profile, {"costs": "n", "roots": "n", "others": "nf"}, sizes)
