"""The command `greybox predict`: a saved model on another log, simulated and compared."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greybox.assessment.result import Fit
from greybox.assessment.simulation.prediction import Prediction
from greybox.assessment.simulation.simulate import predict
from greybox.cli.options import UsageError
from greybox.cli.output import Answer
from greybox.cli.read_log import read_log
from greybox.cli.saved_fits import saved_fit
from greybox.data.files.named_values import attributes, selected
from greybox.data.logs.prepare import prepare
from greybox.data.record import Record
from greybox.workflows.study.data_file import record_of

EXAMPLES = (
    "pitch_fit.h5 other_flight.BIN",
    "pitch_fit.h5 other_flight.csv --signals u=elevator q=gyro_y --horizon 2",
)
LOG_OPTIONS = """
result RESULT
    a fit that greybox identify or fit --out wrote
log LOG
    a log or a table with the inputs of the model
--signals NAME=SIGNAL...
    inputs and outputs of the model in the log (default: those of the log of the fit)
--rate HZ
    common sampling rate
--between START END
    use only this part of the log, s
--columns
--gaps
--model"""
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""{LOG_OPTIONS}
--horizon S
    time to predict from the measured past, s (default: chosen by greybox)
"""


def run(options: argparse.Namespace) -> Answer:
    """Predict the log, window by window."""
    fit = saved_fit(options.result, options)
    record = flown_record(fit, options)
    prediction = predict(fit, record=record, horizon=options.horizon)
    dead = [
        name for name in prediction.outputs if np.nanmin(record[name]) == np.nanmax(record[name])
    ]
    if len(dead) == len(prediction.outputs):
        raise UsageError(
            f"{', '.join(dead)} never changes in {options.log}, so that it shows nothing of the "
            "model: choose another log, another part (--between), or other --signals."
        )
    notes = [f"{name} never changes: a dead sensor, or a part at rest." for name in dead]
    findings = [*notes, *record.findings]
    return _json(prediction) | {"findings": findings}, str(prediction), *findings


def flown_record(fit: Fit, options: argparse.Namespace) -> Record:
    """Return the stated part of the log, with the signals of the model."""
    log = read_log(options)
    # The rows of a table are those that a fit takes. A simulation needs no uniform times.
    if fit.records and len(log) == 1 and not (options.signals or options.rate):
        record = record_of(log, Path(options.log), fit.model_of())
    else:
        record = prepare(log, options.signals or _signals_of(fit), options.rate)
    # Cut after resampling, which needs the samples before and after the excerpt.
    return record.between(*options.between) if options.between else record


def _signals_of(fit: Fit) -> Mapping[str, str]:
    """Return the signals of the log from which a fit was made; those of a record have its names."""
    # The signals of a fit to a record have the model's names; another log of the same kind has them
    # too.
    if fit.records:
        return {name: name for name in fit.records[0].data.signals}
    # `greybox response` notes in the file which signals of the log it has used.
    noted = fit.responses[0].data.about.get("signals") if fit.responses else None
    if noted:
        pairs = dict(pair.split(" = ") for pair in noted.split(", "))
        model = fit.model_of()
        names = (*model.input_names, *model.output_names)
        if set(names) <= set(pairs):
            return selected(pairs, names)
    raise UsageError(f"{fit.name} has no signals of its log: give --signals NAME=SIGNAL ...")


def _json(prediction: Prediction) -> dict[str, Any]:
    measures = {
        name: {
            "fit_percent": prediction.fit_percent(name),
            "rms": prediction.rms(name),
            "unit": prediction.data.units.get(name, ""),
        }
        for name in prediction.outputs
    }
    return {
        "model": prediction.label,
        "windows": len(prediction),
        "outputs": measures,
        **attributes(prediction, "horizon", "lead", "notes"),
    }
