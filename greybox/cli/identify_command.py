"""The command `greybox identify`: from a log to a fitted model in one go."""

import argparse
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from greybox.cli.catalog import find_model
from greybox.cli.log_tests import read_log
from greybox.cli.measurement_options import add_measurement_options, stated_choices
from greybox.cli.options import UsageError, add_common_options, nonnegative, positive
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, require_writable, save_figure
from greybox.cli.response_command import response_json
from greybox.data.response_file import write_response
from greybox.estimate.storage import save
from greybox.estimate.summary import summary
from greybox.files.json_numbers import finite
from greybox.identification.identify import STARTS, Identification, identify
from greybox.identification.measurement import Settings
from greybox.modeling.transfer_function import TransferFunction

EXAMPLES = (
    "flight.BIN",
    "flight.BIN --axis pitch --band 0.5 12 Hz --out pitch",
    "flight.BIN --structures rate:DampedAngle tilt:Tilt+T_delay my.py:Mine",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("log", metavar="LOG", help="a flight log, or a table of signals")
    add(
        "--input",
        default="",
        metavar="[NAME=]SIGNAL",
        help="the control (default: that of the axis)",
    )
    add(
        "--output",
        default="",
        metavar="[NAME=]SIGNAL",
        help="the output (default: the best-sampled angle)",
    )
    add_measurement_options(parser)
    add(
        "--through",
        nargs="*",
        metavar="FILTER",
        help="filters between the output and its log, by the names that the log gives them: gyro-filter, gyro-notch, "
        "d-term-filter, target-filter; none without a name (default: what the output is known to have passed)",
    )
    add(
        "--structures",
        nargs="+",
        metavar="MODEL[+NAME]",
        help="models to fit and compare, the simplest first, as of greybox fit --model, each with the parameters to "
        "free (default: those that are known for this output)",
    )
    add(
        "--starts",
        type=positive,
        default=STARTS,
        help=f"number of starts of every fit (default: {STARTS})",
    )
    add("--seed", type=nonnegative, default=0, help="seed of the starts (default: 0)")
    add(
        "--out",
        metavar="PREFIX",
        help="begin the names of response, result and figure with this (default: the name of the log, in this folder)",
    )
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Identify; write response, result and figure."""
    prefix = options.out or Path(options.log).stem
    response, result, figure = (
        Path(f"{prefix}_response.csv"),
        Path(f"{prefix}_fit.h5"),
        Path(f"{prefix}.png"),
    )
    for path in (response, result):
        require_writable(path, options.force)
    require_figure(figure, options.force)
    ladder = [
        (model, tuple(free), "stated")
        for model, *free in (word.split("+") for word in options.structures or ())
    ]
    found = identify(
        read_log(options),
        ladder=ladder,
        declared={name: _transfer_function(name) for name, *_ in ladder},
        through=options.through,
        starts=options.starts,
        seed=options.seed,
        **stated_choices(options),
    )

    lines = commands(found, options.log, prefix, options.columns)
    answer = _json(found, lines)
    text = "\n".join(
        [str(found), "", "The same in single commands:", *(f"  {line}" for line in lines)]
    )
    measured = found.measurement.response
    fit = found.fit
    if measured is None or not found.measurement.quality.usable:
        answer["error"] = " ".join(found.measurement.quality.refusals)
        return answer, text, FAILED
    write_response(measured, response)
    notes = [f"saved {response}"]
    if fit is None:
        answer["error"] = "no structure of the ladder converged."
        return answer, "\n".join([text, "", *notes]), FAILED
    save(replace(fit, command=options.arguments), result)
    notes += [f"saved {result}", *save_figure(figure, lambda: _figure(found))]
    answer["files"] = [str(response), str(result), str(figure)]
    return answer, "\n".join([text, "", *notes]), USABLE


def _transfer_function(name: str) -> TransferFunction:
    model = find_model(name)
    if not isinstance(model, TransferFunction):
        raise UsageError(
            f"--structures {name}: {model.label} is an ODE; fit it to the response by greybox fit --model."
        )
    return model


def commands(result: Identification, log: str, prefix: str, columns: Sequence[str]) -> list[str]:
    """Return the single commands that do the same as `identify`; files are named after `prefix`."""
    settings = result.measurement.settings
    finding = _given("announced", settings.announced)
    if settings.fields:
        finding += ["--fields", *(f"{key}={name}" for key, name in settings.fields.items())]
    finding += _given("setpoint", settings.setpoint)
    reading = ["--columns", *columns] if columns else []

    response = f"{prefix}_response.csv"
    measuring = ["response", log, "--input", settings.input, "--output", settings.output, *finding]
    usual = Settings(settings.input, settings.output)
    for name in ("axis", "tests", "instrument", "rate", "settle", "period", "points"):
        value = getattr(settings, name)
        measuring += _given(name, "" if value == getattr(usual, name) else value)
    if settings.band:
        measuring += ["--band", *(repr(float(edge)) for edge in settings.band)]
    measuring += ["--whole"] if settings.whole else []
    measuring += ["--open-loop"] if settings.open_loop else []
    lines = [["inspect", log, *finding, *reading], [*measuring, "--out", response, *reading]]

    if result.chosen:
        step = result.chosen
        fitting = ["fit", "--model", step.model, "--data", response]
        fitting += ["--through", *step.through] if step.through else []
        fitting += ["--free", *step.free] if step.free else []
        fitting += ["--criterion", step.criterion]
        fitting += ["--starts", str(result.starts), "--seed", str(result.seed)]
        lines.append([*fitting, "--out", f"{prefix}_fit.h5", "--plot", f"{prefix}.png"])
    return [shlex.join(["greybox", *words]) for words in lines]


def _given(name: str, value: Any) -> list[str]:
    return [f"--{name}", str(value)] if value not in ("", None) else []


def _figure(found: Identification) -> Any:
    from greybox.plotting import plot  # noqa: PLC0415  (imports matplotlib)

    assert found.fit is not None
    return plot(found.fit)


def _json(found: Identification, lines: list[str]) -> dict[str, Any]:
    steps = [
        {
            "model": s.model,
            "free": list(s.free),
            "through": list(s.through),
            "about": s.about,
            "converged": s.fit.converged,
        }
        | {"cost": finite(s.fit.cost), "chosen": s is found.chosen}
        for s in found.steps
    ]
    return {
        "chosen": [
            {"what": c.what, "why": c.why, "option": f"--{c.argument}"} for c in found.choices
        ],
        "measurement": response_json(found.recording, found.measurement),
        "structures": steps,
        "comparison": found.comparison.table if found.comparison else [],
        "reason": found.reason,
        "fit": summary(found.fit) if found.fit is not None else None,
        "commands": lines,
    }
