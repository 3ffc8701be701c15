"""The command `greybox response`: a response, or a matrix of responses."""

import argparse
import shlex
from collections.abc import Sequence
from typing import Any, NamedTuple

from greybox.cli.measurement_options import MEASUREMENT_OPTIONS, stated_band, stated_choices
from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_figure, require_writable, save_figure
from greybox.cli.read_log import read_log
from greybox.data.files.named_values import attributes, non_empty
from greybox.data.frequency_response import FrequencyResponse
from greybox.data.record import Recording
from greybox.data.response_file import write_response, write_responses
from greybox.workflows.identification.matrix import measure_matrix
from greybox.workflows.identification.measurement import INSTRUMENT, Measurement, Settings, measure

EXAMPLES = (
    "flight.BIN --input u=RATE.POut --output theta=ATT.Pitch --out pitch.csv --plot bode.png",
    "flight.csv --input u --output theta --whole --band 1 40",
    "flight.csv --input da dr --output p r --period 20 --instrument e_a e_r --out matrix.csv",
)
# The options that people use; the help shows the others below them.
USED = "--input --output --instrument --axis --band --tests --period --columns --out --plot"
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
log LOG
    a flight log, or a table of signals
--input [NAME=]SIGNAL...
    the control, e.g. u=RATE.POut (required)
--output [NAME=]SIGNAL...
    the output, e.g. theta=ATT.Pitch (required)
{MEASUREMENT_OPTIONS}
--drop-warned
    omit the frequencies about which the check of the response warns, as identify does
--refined
    measure a sweep or noise twice, as identify does: the second time, the local polynomials
    describe only what the best rational function leaves
--out FILE
    save the response to this .csv file
--plot FILE
    draw Bode diagram and coherence into this png, pdf or svg file
--hz
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Measure, save and draw."""
    # A long log takes minutes to read: check the files to be written before.
    require_figure(options.plot, options.force)
    require_writable(options.out, options.force, (".csv",), "table")
    is_matrix = len(options.input) > 1 or len(options.output) > 1
    if is_matrix and not options.period:
        raise UsageError(
            "--input or --output has several signals: give one of each, or the --period of the "
            "multisines that excite all inputs at once."
        )

    recording = read_log(options)
    measured = _matrix(options, recording) if is_matrix else _response(options, recording)
    responses = measured.responses
    lines = [measured.text]
    # Every measurement lacks what the reader of the log has left out.
    if recording.findings:
        lines += ["", *recording.findings]
    if responses and options.out is not None:
        if is_matrix:
            write_responses(responses, options.out)
        else:
            write_response(responses[0], options.out)
        lines.append(f"saved {options.out}")
    if responses:
        lines += save_figure(options.plot, "bode", *responses, hz=options.hz)
    if is_matrix and options.out is not None:
        pair = ["--input", responses[0].input, "--output", responses[0].output]
        command = ["greybox", "fit", "--model", "MODEL", "--data", str(options.out), *pair]
        lines.append(f"  fit one: {shlex.join(command)}")
    return measured.answer, *lines


class _Measured(NamedTuple):
    """A measurement as text and as JSON, and its responses; none if they are not usable."""

    text: str
    answer: dict[str, Any]
    responses: Sequence[FrequencyResponse]


def _response(options: argparse.Namespace, recording: Recording) -> _Measured:
    """Measure the response of one pair."""
    names = {"input": options.input[0], "output": options.output[0]}
    measured = measure(recording, Settings(**(stated_choices(options) | names)))
    answer = response_json(recording, measured)
    response = measured.response
    if not measured.quality.usable or response is None:
        answer["error"] = " ".join(measured.quality.refusals)
        return _Measured(str(measured), answer, ())
    return _Measured(str(measured), answer, [response])


def _matrix(options: argparse.Namespace, recording: Recording) -> _Measured:
    """Measure the responses of all pairs at once."""
    measured = measure_matrix(
        recording,
        options.input,
        options.output,
        options.period,
        excitations=options.instrument,
        band=stated_band(options.band),
        rate=options.rate,
        settle=options.settle,
    )
    responses = []
    for response in measured.responses:
        responses.append({**attributes(response, "input", "output", "omega"), **response.columns})
    answer = {
        **_origin(recording, measured),
        "responses": responses,
        "units": non_empty(measured.record.units),
    }
    return _Measured(str(measured), answer, measured.responses)


def _origin(recording: Recording, measured: Any) -> dict[str, Any]:
    """Return the part about the log in the JSON of every measurement."""
    return {
        "log": recording.source,
        "checksum": recording.checksum,
        "choices": measured.choices,
        "log_findings": recording.findings,
    }


def response_json(recording: Recording, measured: Measurement) -> dict[str, Any]:
    """Return the JSON of a measurement; without a response it has no columns."""
    response, quality = measured.response, measured.quality
    if response is None:
        of_response = {"input": None, "output": None, "units": {}, "about": {}}
    else:
        # A column that the response does not have is None.
        of_response = {"coherence": None, "variance": None, "dof": None, **response.columns}
        of_response |= attributes(response, "omega", "input", "output", "units", "about")

    return {
        **_origin(recording, measured),
        **of_response,
        "closed_loop": bool(measured.controller),
        "instrument": measured.signals.get(INSTRUMENT),
        "segments": measured.tests,
        "usable": quality.usable,
        "findings": quality.findings,
    }
