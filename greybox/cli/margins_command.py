"""The command `greybox margins`: stability margins of saved fits in the loop of a controller."""

import argparse
from typing import Any

from greybox.assessment.result import Fit
from greybox.cli.options import UsageError
from greybox.cli.output import Answer, require_figure, require_writable, save_figure
from greybox.cli.saved_fits import flight_log, saved_fit
from greybox.data.files.named_values import attributes, selected
from greybox.data.response_file import read_response
from greybox.modeling.model import require_known
from greybox.workflows.experiment.controller import Controller
from greybox.workflows.experiment.margin_values import margin_table
from greybox.workflows.experiment.margins import margins
from greybox.workflows.study.catalog import find_controller, shipped_module
from greybox.workflows.study.study import read_study

EXAMPLES = (
    "pitch.h5 --log flight.BIN",
    "pitch.h5 --controller controller:AttitudeController --signals q=theta_dot",
    "hover.h5 forward.h5 --controller my.py:RateLoop --report margins.html",
    "rate.h5 --controller my.py:RateLoop --set K_P=0.12 K_I=0.1 --rate 400 --broken-at u q",
    "loop.csv",
)
# The options that state the controllers of a loop.
CONTROLLER_OPTIONS = """
--controller CLASS...
    controller:AttitudeController or my.py:Class; several in the order in which they run
--set NAME=VALUE...
    gains in place of the declared ones
--rate HZ
    sampling rate of the controllers
--signals OWN=PLANT...
    a signal of a controller and its name in the plant, e.g. q=theta_dot
"""
# The options that people use; the help shows the others below them.
USED = "--log --controller --set --rate --signals --axis --broken-at --plot --report --details"
OPTIONS = f"""
results RESULT...
    a fit that greybox fit --out wrote, or the folder of a study; several, such as operating
    points, are shown in one table; or a .csv file with the measured response of the broken loop,
    with negative feedback, which needs no controller
--model
{CONTROLLER_OPTIONS}
--log LOG
    a log, whose controllers are checked; margins are also measured from it (without --controller:
    the log of the fit, if it is in the folder of RESULT)
--columns NAME=COLUMN[:UNIT]...
    the columns of a .csv file with other names: frequency=f:Hz
--axis AXIS
    roll, pitch or yaw of the log (default: that of the control of the fit, or pitch)
--broken-at SIGNAL...
    where to break the loop: an input of the plant (default: the first one) or a measured signal
--tracking SETPOINT SIGNAL
    of which setpoint and response to give bandwidth and step (default: the first ones)
--boundary DELAY:BANDWIDTH...
    corners of a boundary between levels of handling qualities: the least ADS-33 bandwidth in rad/s
    at a phase delay in s
--at NAME=VALUE...
    operating point of an ODE
--level
--plot FILE
    draw the loop, broken at the first signal, into this png, pdf or svg file
--hz
--report FILE
    write a page about the fits or measured loops with their margins, as greybox report does
--details
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the fits, close their loops, and return the margins wherever these are broken."""
    fits = _fits(options)
    if not fits:
        raise UsageError(
            f"{options.results[0]} has no finished member: continue with greybox batch."
        )
    if options.log and len(fits) != 1:
        raise UsageError("--log is of one flight: give a single RESULT with it.")
    require_figure(options.plot, options.force)
    require_writable(options.report, options.force, (".html", ".htm"), "page")
    tables = [name for name, item in fits.items() if not isinstance(item, Fit)]
    others = len(fits) > len(tables)
    if tables and (others or options.log):
        raise UsageError(f"{tables[0]} is a measured loop: fits and --log do not go with it.")
    settings = attributes(options, "tracking", "at", "level", "boundary")
    first = next(iter(fits.values()))
    wrong = ""
    # A log has the controller that flew, with its gains and its rate.
    is_single = len(fits) == 1 and not tables
    log = flight_log(first, options.results[0], options) if is_single else None
    if log:
        flown = shipped_module("models", "firmware").loop_of_log(
            log,
            *fits.values(),
            options.axis,
            broken_at=options.broken_at,
            signals=options.signals,
            **settings,
        )
        loops = [flown.model, *flown.others]
        answer = flown.to_dict()
        text = [str(flown), *([flown.details] if options.details else [])]
        if not flown.check.reproduces:
            wrong = "the controllers of the log do not reproduce its control."
    else:
        controllers = stated_controllers(options) if options.controller or not tables else None
        labeled = [
            (label, margins(fit, controllers, broken_at=place, **settings))
            for label, fit in fits.items()
            for place in options.broken_at or [""]
        ]
        loops = [loop for _, loop in labeled]
        answer: dict[str, Any] = {"loops": [loop.to_dict() for loop in loops]}
        text = [margin_table(labeled)] if len(fits) > 1 else [*map(str, loops)]

    # A loop may be safe where it is broken at one signal, and not at another.
    unsafe = " ".join(loop.verdict for loop in loops if not loop.is_safe)
    if unsafe or wrong:
        answer["error"] = unsafe or wrong
    text += save_figure(options.plot, "loop", loops[0], hz=options.hz)
    if options.report:
        from greybox.reporting.html_report.report import report  # noqa: PLC0415  (slow import)

        report([] if tables else [*fits.values()], options.report, margins=loops)
        text.append(f"wrote {options.report}")
    return answer, "\n\n".join(text)


def _fits(options: argparse.Namespace) -> dict[str, Any]:
    """Return the fits, or measured loops, by their names."""
    fits: dict[str, Any] = {}
    for path in options.results:
        if path.is_dir():
            fits |= {member.name: member.fit for member in read_study(path).done}
        elif path.suffix.lower() == ".csv":
            fits[str(path)] = read_response(path, columns=options.columns)
        else:
            fits[str(path)] = saved_fit(path, options)
    return fits


def stated_controllers(options: argparse.Namespace) -> list[Controller]:
    """Return the controllers with the gains and names of signals that the options state."""
    if not options.controller:
        raise UsageError("no controller is stated: give --log with the flight, or --controller.")
    kinds = [find_controller(text) for text in options.controller]
    gains = [name for kind in kinds for name in kind.parameters]
    require_known(options.set, gains, "gain", "the list of controllers")

    # In a cascade, every controller takes the gains and signals that it has.
    return [
        kind(
            selected(options.set, kind.parameters),
            rate=options.rate,
            signals={
                own: outside
                for own, outside in options.signals.items()
                if own in (*kind.inputs, *kind.setpoints, *kind.outputs)
            },
        )
        for kind in kinds
    ]
