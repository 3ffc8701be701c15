"""The command `greybox identify`: from logs to a fitted model in one step."""

import argparse
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from greybox.assessment.storage import save
from greybox.cli.measurement_options import MEASUREMENT_OPTIONS, stated_choices
from greybox.cli.options import UsageError
from greybox.cli.orders_command import selection_json
from greybox.cli.output import Answer, require_figure, require_writable, save_figure
from greybox.cli.response_command import response_json
from greybox.data.files.json_numbers import plain
from greybox.data.files.named_values import attributes, non_empty
from greybox.data.logs.flight_controllers import axis_of
from greybox.data.logs.readers import read
from greybox.data.record import Recording
from greybox.data.response_file import write_response
from greybox.workflows.identification.identify import Identification, identify
from greybox.workflows.identification.orders import STARTS
from greybox.workflows.identification.stages import Staged, fit_in_stages
from greybox.workflows.identification.structure_fit import Structure
from greybox.workflows.study.catalog import find_model

EXAMPLES = (
    "flight.BIN",
    "flight.BIN --axis pitch --band 0.5 12 Hz --out pitch",
    "first.BIN second.BIN --fix T_delay=0.004",
    "flight.BIN --structures rate:DampedAngle tilt:Tilt+T_delay my.py:Mine",
    "log10 --structures 'multirotor:Multirotor((4, 0.04))' --fix m=0.027",
)
# The options that people use; the help shows the others below them.
USED = "--input --output --axis --band --columns --structures --fix --bounds --out --details"
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""
logs LOG...
    flight logs with tests of one axis, or tables of signals
--input [NAME=]SIGNAL
    the control (default: the control of the axis)
--output [NAME=]SIGNAL
    the output (default: the best-sampled angle)
{MEASUREMENT_OPTIONS}
--all-points
    also fit the frequencies about which the check of the response warns
--through [FILTER]...
    filters between the output and its log, by their names in the log: gyro-filter, gyro-notch,
    d-term-filter, target-filter; without a name, no filter (default: the filters that the log
    names for this output)
--structures MODEL[+NAME]...
    models to fit and compare, as in greybox fit --model, each with the parameters to free (default:
    rational transfer functions of rising order, for any vehicle); one with stages, such as
    multirotor:Multirotor((4, 0.04)), is fitted alone, to the records of the logs
--fix
--free
--bounds
--start
--starts N
    number of starts of every fit of --structures, or other starts of the chosen rational transfer
    function (default: {STARTS})
--seed K
    seed of the starts (default: 0)
--out PREFIX
    first part of the names of response, result and figure (default: the name of the log, in this
    folder)
--hz
--details
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Identify; write response, result and figure."""
    prefix = (options.out or Path(options.logs[0]).stem).removesuffix(".h5") or "log"
    count = len(options.logs)
    numbers = [""] if count == 1 else [f"_{k}" for k in range(1, count + 1)]
    responses = [Path(f"{prefix}{number}_response.csv") for number in numbers]
    result, figure = Path(f"{prefix}_fit.h5"), Path(f"{prefix}.png")
    # All files that will be written are checked before the log is read.
    for path in (*responses, result):
        require_writable(path, options.force)
    require_figure(figure, options.force)

    gaps = options.gaps or "auto"
    recordings = [read(log, columns=options.columns, gaps=gaps) for log in options.logs]
    structures = [_structure(word) for word in options.structures]
    if any(isinstance(structure.model, Staged) for structure in structures):
        return _in_stages(structures, recordings, options, result)
    identification = identify(
        recordings,
        structures=structures,
        fixed=options.fix,
        **attributes(options, "through", "free", "bounds", "start", "all_points", "starts", "seed"),
        **stated_choices(options),
    )
    answer = _json(identification)
    text = [str(identification)]
    if options.details and identification.selection is not None:
        text += ["", identification.details]
    selection, fit = identification.selection, identification.fit
    # Nothing is written for data that cannot be trusted: the next command would take the files.
    if selection is None:
        answer["error"] = " ".join(identification.refusals)
        return answer, *text

    for measurement, path in zip(identification.measurements, responses, strict=True):
        assert measurement.response is not None
        write_response(measurement.response, path)

    text += ["", *(f"saved {path}" for path in responses)]
    if fit is not None:
        save(replace(fit, command=options.arguments), result)
        text += [f"saved {result}", *save_figure(figure, "plot", fit, hz=options.hz)]
        answer["files"] = [*responses, result, figure]
    # The fit is saved even if no structure explains the data: the user must see what is missing.
    if not selection.explains:
        answer["error"] = selection.verdict
        return answer, *text

    following = [
        ["report", str(result)],
        ["profile", str(result)],
        ["predict", str(result), "ANOTHER_LOG"],
    ]
    # Only a log with parameters has the gains of the controllers.
    has_axis = axis_of(next(iter(identification.measurements[0].signals.values())))
    if has_axis and recordings[0].metadata.get("parameters"):
        following.append(["margins", str(result), "--log", str(options.logs[0])])
    answer["next"] = [shlex.join(["greybox", *words]) for words in following]
    return answer, *text, "", "Next:", *(f"  {command}" for command in answer["next"])


def _in_stages(
    structures: Sequence[Structure],
    recordings: Sequence[Recording],
    options: argparse.Namespace,
    path: Path,
) -> Answer:
    """Fit the only structure in its stages; write the last fit."""
    if len(structures) > 1:
        raise UsageError(
            f"{structures[0].name} is fitted in stages, to the records of a log and not to a "
            "frequency response: give it as the only structure."
        )
    (structure,) = structures
    stated = {"fixed": options.fix, **attributes(options, "bounds", "start")}
    stated["free"] = [*structure.free, *options.free]
    found = fit_in_stages(
        structure.model,
        recordings,
        non_empty(stated),
        label=structure.name,
        seed=options.seed,
    )
    fits = {name: fit.to_dict() for name, fit in found.fits.items()}
    answer: dict[str, Any] = {"stages": fits}
    if found.failure:
        answer["error"] = found.failure
    if not found.fit.converged:
        return answer, str(found)
    save(replace(found.fit, command=options.arguments), path)
    answer["files"] = [path]
    return answer, str(found), "", f"saved {path}"


def _structure(word: str) -> Structure:
    name, *free = word.split("+")
    return Structure(find_model(name), name, free)


def _json(result: Identification) -> dict[str, Any]:
    return {
        "chosen": [
            {"what": choice.what, "why": choice.why, "option": f"--{choice.argument}"}
            for choice in result.choices
        ],
        "measurements": list(map(response_json, result.recordings, result.measurements)),
        "through": result.through,
        "transfer_function": plain(result.transfer_function),
        **(selection_json(result.selection) if result.selection else {"explains": False}),
    }
