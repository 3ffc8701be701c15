"""The command `greybox identify`: from logs to a fitted model in one go."""

import argparse
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from greybox.cli.catalog import find_model
from greybox.cli.measurement_options import add_measurement_options, stated_choices
from greybox.cli.options import (
    UsageError,
    add_common_options,
    add_words,
    nonnegative,
    positive,
    stated_columns,
)
from greybox.cli.orders_command import selection_json
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, require_writable, save_figure
from greybox.cli.parameter_options import add_value_options, stated_values
from greybox.cli.response_command import response_json
from greybox.data.response_file import write_response
from greybox.estimate.storage import save
from greybox.identification.families import FAMILIES, Structure
from greybox.identification.identify import STARTS, Identification, identify
from greybox.identification.measurement import Settings
from greybox.logs.readers import read

EXAMPLES = (
    "flight.BIN",
    "flight.BIN --axis pitch --band 0.5 12 Hz --out pitch",
    "first.BIN second.BIN --vehicle multirotor --fix T_rotor=0.048",
    "flight.BIN --structures rate:DampedAngle tilt:Tilt+T_delay my.py:Mine",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add(
        "logs",
        nargs="+",
        metavar="LOG",
        help="flight logs with tests of one axis, or tables of signals",
    )
    for flag, about in (
        ("--input", "the control (default: the control of the axis)"),
        ("--output", "the output (default: the best-sampled angle)"),
    ):
        add(flag, default="", metavar="[NAME=]SIGNAL", help=about)

    add_measurement_options(parser)
    add(
        "--all-points",
        action="store_true",
        help="also fit the frequencies about which the check of the response warns",
    )
    add(
        "--through",
        nargs="*",
        metavar="FILTER",
        help="filters between the output and its log, by their names in the log: gyro-filter, "
        "gyro-notch, d-term-filter, target-filter; without a name, no filter (default: the filters "
        "that the log names for this output)",
    )
    add(
        "--vehicle",
        default="",
        metavar="FAMILY",
        help=f"fit the structures of {' or '.join(FAMILIES)} (default: rational transfer "
        "functions of rising order, for any vehicle)",
    )
    add_words(
        parser,
        "--structures",
        "MODEL[+NAME]",
        "models to fit and compare instead, as in greybox fit --model, each with the parameters to "
        "free",
    )
    add_value_options(parser)
    add(
        "--starts",
        type=positive,
        default=STARTS,
        help=f"number of starts of every fit of --vehicle and --structures (default: {STARTS})",
    )
    add("--seed", type=nonnegative, default=0, help="seed of the starts (default: 0)")
    add(
        "--out",
        metavar="PREFIX",
        help="first part of the names of response, result and figure (default: the name of the "
        "log, in this folder)",
    )
    add_common_options(parser, writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Identify; write response, result and figure."""
    prefix = options.out or Path(options.logs[0]).stem or "log"
    responses = _response_files(prefix, len(options.logs))
    result, figure = Path(f"{prefix}_fit.h5"), Path(f"{prefix}.png")
    # All files that will be written are checked before the log is read.
    for path in (*responses, result):
        require_writable(path, options.force)
    require_figure(figure, options.force)
    if options.vehicle and options.structures:
        raise UsageError("--vehicle and --structures exclude each other: give one of them.")

    columns = stated_columns(options) or None
    identification = identify(
        [read(log, columns=columns) for log in options.logs],
        vehicle=options.vehicle,
        structures=[_structure(word) for word in options.structures],
        through=options.through,
        free=options.free,
        **stated_values(options),
        all_points=options.all_points,
        starts=options.starts,
        seed=options.seed,
        **stated_choices(options),
    )
    # Printed even after a refusal: a user can change one step and run the others as they are.
    lines = commands(identification, options, prefix)
    answer = _json(identification, lines)
    text = [str(identification), "", "The same in single commands:", *(f"  {x}" for x in lines)]
    selection, fit = identification.selection, identification.fit
    # Nothing is written for data that cannot be trusted: the next command would take the files.
    if identification.refusals or selection is None:
        answer["error"] = " ".join(identification.refusals)
        return answer, "\n".join(text), FAILED

    for measurement, path in zip(identification.measurements, responses, strict=True):
        assert measurement.response is not None
        write_response(measurement.response, path)

    text += ["", *(f"saved {path}" for path in responses)]
    if fit is not None:
        save(replace(fit, command=options.arguments), result)
        text += [f"saved {result}", *save_figure(figure, "plot", fit)]
        answer["files"] = [*responses, result, figure]
    # The fit is saved even if no structure explains the data: the user must see what is missing.
    if fit is None or not selection.explains:
        answer["error"] = selection.verdict
        return answer, "\n".join(text), FAILED

    text += ["", "Next:", f"  greybox report {result}", f"  greybox profile {result}"]
    return answer, "\n".join(text), USABLE


def _response_files(prefix: str, count: int) -> list[Path]:
    numbers = [""] if count == 1 else [f"_{k}" for k in range(1, count + 1)]
    return [Path(f"{prefix}{number}_response.csv") for number in numbers]


def _structure(word: str) -> Structure:
    name, *free = word.split("+")
    return Structure(find_model(name), name, "stated", free)


def commands(result: Identification, options: argparse.Namespace, prefix: str) -> list[str]:
    """Return the commands that do the same step by step; files are named after `prefix`."""
    reading = ["--columns", *options.columns] if options.columns else []
    # Commands name the files of one another, so that they can be pasted in this order.
    files = [str(path) for path in _response_files(prefix, len(options.logs))]
    lines = []
    for log, measurement, file in zip(options.logs, result.measurements, files, strict=True):
        settings = measurement.settings
        finding = _words(settings, "announced", "fields", "setpoint")
        signals = ["--input", settings.input, "--output", settings.output]
        names = ("axis", "tests", "instrument", "rate", "settle", "period", "points")
        names += ("conditioned", "band", "whole", "open_loop", "drop_warned")
        measuring = [*signals, *finding, *_words(settings, *names)]
        lines.append(["inspect", log, *finding, *reading])
        lines.append(["response", log, *measuring, "--out", file, *reading])

    if result.selection is not None and result.selection.chosen is not None:
        lines.append([*_fitting(result, options, files), "--out", f"{prefix}_fit.h5"])
    return [shlex.join(["greybox", *words]) for words in lines]


def _words(settings: Settings, *names: str) -> list[str]:
    """Return the options for settings that differ from their defaults."""
    # A command with every default written out would hide what was chosen.
    usual = Settings(settings.input, settings.output)
    words = []
    for name in names:
        value = getattr(settings, name)
        if not value or value == getattr(usual, name):
            continue
        texts = [] if value is True else [str(value)]
        if isinstance(value, Mapping):
            texts = [f"{key}={field}" for key, field in value.items()]
        elif isinstance(value, tuple | list):
            texts = [part if isinstance(part, str) else repr(float(part)) for part in value]
        words += [f"--{name.replace('_', '-')}", *texts]
    return words


def _fitting(
    result: Identification, options: argparse.Namespace, files: Sequence[str]
) -> list[str]:
    """Return the command that fits the chosen structure, or that selects the orders again."""
    assert result.selection is not None
    assert result.selection.chosen is not None
    through = ["--through", *result.through] if result.through else []
    if not (options.vehicle or options.structures):
        words_by_option = {name: getattr(options, name) for name in ("fix", "bounds", "start")}
        return ["orders", *files, *through, *_flags(words_by_option)]

    # Only what differs from the declaration of the model has to be on the command line.
    chosen = result.selection.chosen
    declared = find_model(chosen.label).parameters
    # Filters in front of the model have parameters that `--through` states, not these options.
    free = [q for q in chosen.fit.quantities if q.kind == "free" and q.name in declared]
    words_by_option = {
        "free": [q.name for q in free if declared[q.name].fixed],
        "bounds": [
            f"{q.name}={float(q.bounds[0])!r}:{float(q.bounds[1])!r}"
            for q in free
            if q.bounds != declared[q.name].bounds
        ],
    }
    for name in ("fix", "start"):
        words = [word for word in getattr(options, name) if word.partition("=")[0] in declared]
        words_by_option[name] = words

    return [
        *("fit", "--model", chosen.label, "--data", *files, *through, *_flags(words_by_option)),
        *("--criterion", chosen.fit.criterion, "--starts", str(options.starts)),
        *("--seed", str(options.seed)),
    ]


def _flags(words_by_option: Mapping[str, Sequence[str]]) -> list[str]:
    return [
        word for name, words in words_by_option.items() if words for word in (f"--{name}", *words)
    ]


def _json(result: Identification, lines: list[str]) -> dict[str, Any]:
    return {
        "chosen": [
            {"what": choice.what, "why": choice.why, "option": f"--{choice.argument}"}
            for choice in result.choices
        ],
        "measurements": [
            response_json(recording, measurement)
            for recording, measurement in zip(result.recordings, result.measurements, strict=True)
        ],
        "through": result.through,
        **(selection_json(result.selection) if result.selection else {"explains": False}),
        "commands": lines,
    }
