"""The command `greybox response`: from a log to a frequency response, a matrix of them, or a manoeuvre's spectrum."""

import argparse
import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from greybox.cli.log_tests import add_test_options, read_log, segment_as_json, stated_fields
from greybox.cli.options import UsageError, add_common_options
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, require_writable, save_figure
from greybox.data.record import Recording
from greybox.data.response_file import write_response, write_responses
from greybox.data.transient_file import write_spectrum
from greybox.identification.manoeuvre import ManoeuvreMeasurement, measure_manoeuvre
from greybox.identification.matrix import MatrixMeasurement, measure_matrix
from greybox.identification.measurement import INSTRUMENT, Measurement, Settings, measure

EXAMPLES = (
    "flight.BIN --input u=RATE.POut --output theta=ATT.Pitch --out pitch.csv --plot bode.png",
    "flight.csv --input u --output theta --whole --band 1 40",
    "flight.csv --input da dr --output p r --period 20 --instrument e_a e_r --out matrix.csv",
    "flight.csv --manoeuvre 2-1-1 --input da dr --output p r --out manoeuvre.csv",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("log", metavar="LOG", help="a flight log, or a table of signals")
    add(
        "--input",
        required=True,
        nargs="+",
        metavar="[NAME=]SIGNAL",
        help="the control, e.g. u=RATE.POut",
    )
    add(
        "--output",
        required=True,
        nargs="+",
        metavar="[NAME=]SIGNAL",
        help="the output, e.g. theta=ATT.Pitch",
    )
    add(
        "--manoeuvre",
        metavar="NUMBER|KIND",
        help="the spectrum of a doublet, 2-1-1, step or the like instead, by its number in `greybox inspect` or its "
        "kind; of any number of inputs and outputs",
    )
    add_measurement_options(parser)
    add(
        "--held",
        nargs="+",
        default=[],
        metavar="NAME",
        help="with --manoeuvre: inputs held between samples",
    )
    add("--out", type=Path, metavar="FILE", help="save the response to this .csv file")
    add_common_options(parser, "Bode diagram and coherence")


def add_measurement_options(parser: argparse.ArgumentParser) -> None:
    """Declare what `identify` shares: which tests, which samples, which estimate."""
    add = parser.add_argument
    add(
        "--instrument",
        nargs="+",
        default=[],
        metavar="SIGNAL",
        help="the injected signal, for the joint estimate in closed loop (default: what the log says was injected); of "
        "several inputs, one for each",
    )
    add(
        "--open-loop",
        action="store_true",
        help="direct estimate, whatever controller the log shows",
    )
    add(
        "--rate",
        type=float,
        metavar="HZ",
        help="common sampling rate (default: that of the slowest signal)",
    )
    add(
        "--band",
        nargs="+",
        default=[],
        metavar="FREQUENCY",
        help="lowest and highest frequency to use, in rad/s, or with Hz after them (default: what was excited)",
    )
    add("--axis", default="", help="use only the tests of this axis")
    add(
        "--tests",
        default="",
        metavar="1,3-5",
        help="use only these tests, numbered as `greybox inspect` does",
    )
    add(
        "--settle",
        type=float,
        default=2.0,
        metavar="SECONDS",
        help="settling time discarded at the beginning of each sine (default: 2)",
    )
    add(
        "--period",
        type=float,
        metavar="SECONDS",
        help="period of a multisine, to evaluate its lines exactly, without windows; with several inputs or outputs, "
        "of the multisines on all inputs at once, for the matrix of responses",
    )
    add("--whole", action="store_true", help="use the whole log if no test is found")
    add(
        "--method",
        default="least-squares",
        help="for sines: least-squares or quadrature (default: least-squares)",
    )
    add(
        "--points",
        type=int,
        default=40,
        help="number of frequencies of a sweep's estimate (default: 40)",
    )
    add_test_options(parser)


def stated_choices(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the options state of a measurement of one input and one output, by the names of `Settings`."""
    if len(options.instrument) > 1:
        raise UsageError(
            f"--instrument {' '.join(options.instrument)} are several signals: give one for each input."
        )
    names = {field.name for field in fields(Settings)}
    values = {name: value for name, value in vars(options).items() if name in names}
    parsed = {"fields": stated_fields(options), "band": stated_band(options.band)}
    return values | parsed | {"instrument": "".join(options.instrument)}


def stated_band(words: list[str]) -> tuple[float, float] | None:
    """Return the band in rad/s from ``1 80``, ``0.2 12 Hz`` or ``0.2Hz 12Hz``."""
    if not words:
        return None
    text = " ".join(words)
    in_hz = text.lower().endswith("hz")
    plain = text.lower().replace("rad/s", " ").replace("hz", " ").split()
    try:
        low, high = (float(word) * (2 * math.pi if in_hz else 1) for word in plain)
    except ValueError:
        raise UsageError(
            f"--band {text} is not understood: write two frequencies, --band 1 80 or --band 0.2 12 Hz."
        ) from None
    return low, high


def run(options: argparse.Namespace) -> Answer:
    """Measure the response; save and draw it where asked to."""
    require_figure(options.plot, options.force)
    require_writable(options.out, options.force, (".csv",), "table")
    if options.manoeuvre is not None:
        return _run_manoeuvre(options)
    if len(options.input) > 1 or len(options.output) > 1:
        return _run_matrix(options)
    stated = stated_choices(options) | {"input": options.input[0], "output": options.output[0]}
    settings = Settings(**stated)
    recording = read_log(options)
    measured = measure(recording, settings)
    answer, response = response_json(recording, measured), measured.response
    if not measured.quality.usable or response is None:
        answer["error"] = " ".join(measured.quality.refusals)
        return answer, _text(recording, measured), FAILED

    notes = []
    if options.out is not None:
        write_response(response, options.out)
        notes.append(f"saved {options.out}")
    notes += save_figure(options.plot, lambda: _figure("bode", response))
    return answer, "\n".join([_text(recording, measured), *notes]), USABLE


def _run_manoeuvre(options: argparse.Namespace) -> Answer:
    """Measure a manoeuvre; save and draw its spectrum where asked to."""
    recording = read_log(options)
    measured = measure_manoeuvre(
        recording,
        options.input,
        options.output,
        options.manoeuvre,
        setpoint=options.setpoint,
        band=stated_band(options.band),
        rate=options.rate,
        held=options.held,
    )
    spectrum = measured.spectrum
    notes = []
    if options.out is not None:
        write_spectrum(spectrum, options.out)
        notes.append(f"saved {options.out}")
    notes += save_figure(options.plot, lambda: _figure("spectrum", spectrum))
    answer = {
        **_said(recording, measured),
        "manoeuvre": segment_as_json(measured.manoeuvre),
        "manoeuvres": [segment_as_json(segment) for segment in measured.manoeuvres],
        "omega": spectrum.omega.tolist(),
        **{
            kind: {
                n: {"alpha": x.real.tolist(), "beta": x.imag.tolist()}
                for n, x in getattr(spectrum, kind).items()
            }
            for kind in ("inputs", "outputs")
        },
        "duration": spectrum.duration,
        "step": spectrum.step,
        "units": dict(spectrum.units),
    }
    return answer, "\n".join([_text(recording, measured), *notes]), USABLE


def _run_matrix(options: argparse.Namespace) -> Answer:
    """Measure all outputs against all inputs; save and draw the matrix where asked to."""
    if options.period is None:
        several = [
            (f"--{name}", words)
            for name in ("input", "output")
            if len(words := getattr(options, name)) > 1
        ]
        said = " and ".join(f"{flag} {' '.join(words)}" for flag, words in several)
        raise UsageError(
            f"{said} are several signals: give one, or the --period of the multisines that excite all inputs at once, "
            "or a --manoeuvre."
        )
    recording = read_log(options)
    measured = measure_matrix(
        recording,
        options.input,
        options.output,
        options.period,
        excitations=options.instrument,
        rate=options.rate,
        band=stated_band(options.band),
        settle=options.settle,
    )
    notes = []
    if options.out is not None:
        write_responses(measured.responses, options.out)
        notes.append(f"saved {options.out}")
        first = measured.responses[0]
        notes.append(
            f"  fit one: greybox fit --data {options.out} --prefix {first.output}_{first.input}_ --model MODEL"
        )
    notes += save_figure(options.plot, lambda: _figure("bode", *measured.responses))
    answer = {
        **_said(recording, measured),
        "responses": [
            {name: getattr(r, name) for name in ("input", "output")}
            | {name: values.tolist() for name, values in {"omega": r.omega, **r.columns}.items()}
            for r in measured.responses
        ],
        "units": {name: unit for name, unit in measured.record.units.items() if unit},
    }
    return answer, "\n".join([_text(recording, measured), *notes]), USABLE


AnyMeasurement = Measurement | ManoeuvreMeasurement | MatrixMeasurement


def _text(recording: Recording, measured: AnyMeasurement) -> str:
    return "\n\n".join(part for part in (str(measured), "\n".join(recording.findings)) if part)


def _said(recording: Recording, measured: AnyMeasurement) -> dict[str, Any]:
    """Return what the JSON of every measurement says of its log."""
    return {
        "log": recording.source,
        "checksum": recording.checksum,
        "choices": list(measured.choices),
        "log_findings": list(recording.findings),
    }


def _figure(name: str, *drawn: Any) -> Any:
    import greybox.plotting  # noqa: PLC0415  (imports matplotlib)

    return getattr(greybox.plotting, name)(*drawn)[0].figure


def response_json(recording: Recording, measured: Measurement) -> dict[str, Any]:
    """Return a measurement as JSON has it."""
    response, quality = measured.response, measured.quality
    columns: Mapping[str, Any] = {}
    if response is not None:
        known = {"omega": response.omega, **response.columns}
        columns = dict.fromkeys(("coherence", "variance", "dof")) | {
            name: x.tolist() for name, x in known.items()
        }
    return {
        **_said(recording, measured),
        "input": response.input if response else None,
        "output": response.output if response else None,
        **columns,
        "units": dict(response.units) if response else {},
        "about": dict(response.about) if response else {},
        "closed_loop": bool(measured.controller),
        "instrument": measured.signals.get(INSTRUMENT),
        "segments": [segment_as_json(segment) for segment in measured.tests],
        "usable": quality.usable,
        "findings": [
            {"about": f.about, "severity": f.severity, "text": f.text} for f in quality.findings
        ],
    }
