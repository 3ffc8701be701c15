"""The command `greybox tune`: gains that meet requirements and are better than today's."""

import argparse
from datetime import date
from pathlib import Path

from greybox.cli.margins_command import CONTROLLER_OPTIONS, stated_controllers
from greybox.cli.output import Answer, require_figure, require_writable, save_figure
from greybox.cli.saved_fits import flight_log, saved_fit
from greybox.data.files.named_values import attributes
from greybox.data.files.version import __version__
from greybox.data.files.wording import capitalized
from greybox.data.record import Recording
from greybox.workflows.experiment.gain_file import write_gains
from greybox.workflows.experiment.gain_objectives import RejectionBandwidth
from greybox.workflows.experiment.gain_search import STEPS
from greybox.workflows.experiment.safe_gains import PROMISE, SafeGains, safe_gains
from greybox.workflows.study.catalog import shipped_module

EXAMPLES = (
    "pitch.h5 --controller controller:AttitudeController --signals q=theta_dot "
    "--gains K_P=0.02:0.5 K_D=0.001:0.02",
    "pitch.h5 --log flight.BIN --phase-margin 45 --gain-margin 6 --parameters pitch.param",
    "pitch.h5 --log flight.BIN --gains ATC_RAT_PIT_P=0.05:0.3 ATC_RAT_PIT_D ATC_ANG_PIT_P",
    "light.h5 heavy.h5 --controller my.py:Loop --gains K_P=0.05:0.5 "
    "--names K_P=ATC_RAT_PIT_P --parameters pitch.param",
)
# The options that people use; the help shows the others below them.
USED = "--log --axis --gains --range --phase-margin --gain-margin --parameters --plot --report"
OPTIONS = f"""
fits RESULT...
    saved fits, one for each flight
--model
{CONTROLLER_OPTIONS}
--log LOG
    a log of the controllers; the gains then have the names of its firmware (without --controller:
    the log of the fit, if it is in the folder of RESULT)
--axis AXIS
    roll, pitch or yaw of the log (default: that of the control of the fit, or pitch)
--gains NAME[=LOW:HIGH]...
    one to three gains, and where to look for safe ones: by default as far as --range allows;
    without the option, P and D of the rate controller of the log
--range FACTOR
    largest factor by which a proposed gain may differ from today's (default: 2)
--objective {{moment,bandwidth}}
    what the gains should improve: the response to a step moment (moment, the default), or the
    disturbance rejection bandwidth
--noise-factor FACTOR
    how many times today's noise at the actuator is accepted (default: 1.5)
--phase-margin DEGREES
    required phase margin in degrees (default: 45)
--gain-margin DB
    required gain margin in dB (default: 6)
--delay SECONDS
    additional delay with which the requirements must hold, too (default: 0)
--level
--broken-at SIGNAL
    where to break the loop
--at NAME=VALUE...
    operating point of an ODE
--names GAIN=PARAMETER...
    names of the gains in the firmware, for --parameters
--parameters FILE
    write the proposed gains to a file for a ground station: .param for ArduPilot, .params for PX4,
    .txt for the command line of Betaflight; with _step1 and _step2 in their names, files for a
    third and two thirds of the way; no file is written where today's gains are to be kept
--plot FILE
    draw the allowed gains, and both loops, into this png, pdf or svg file
--report FILE
    write a page about the fits with both loops, as greybox report does
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the fits, try sets of gains, and propose one of them or to keep today's gains."""
    endings = (".param", ".parm", ".params", ".txt")
    files = _step_files(options.parameters) if options.parameters else []
    for path in files:
        require_writable(path, options.force, endings, "parameter file")
    require_figure(options.plot, options.force)
    require_writable(options.report, options.force, (".html", ".htm"), "page")
    fits = [saved_fit(path, options) for path in options.fits]
    required = attributes(
        options, "phase_margin", "gain_margin", "delay", "level", "broken_at", "at", "noise_factor"
    )
    required["change"] = options.range
    if options.objective == "bandwidth":
        required["objective"] = RejectionBandwidth(options.broken_at)
    log = flight_log(fits[0], options.fits[0], options)
    if log:
        safe = shipped_module("models", "firmware").safe_gains_of_log(
            fits,
            log,
            options.gains,
            options.axis,
            signals=options.signals,
            **required,
        )
    else:
        safe = safe_gains(fits, stated_controllers(options), options.gains, **required)

    answer = safe.to_dict()
    lines = save_figure(options.plot, "gains", safe)
    if options.report:
        from greybox.reporting.html_report.report import report  # noqa: PLC0415  (slow import)

        report(fits, options.report, gains=safe)
        lines.append(f"wrote {options.report}")
    if not safe.is_usable:
        answer["error"] = safe.verdict
    elif files and not safe.best:
        lines.append(f"{options.parameters} was not written.")
    elif files:
        about = _comments(safe, options, log)
        for number, (path, gains) in enumerate(zip(files, safe.steps, strict=True), 1):
            firmware_gains = {options.names.get(name, name): value for name, value in gains.items()}
            title = f"Step {number} of {len(files)} from today's gains."
            write_gains(firmware_gains, path, [title, *about])
        first, second, last = files
        lines.insert(0, f"The proposed gains are in {last}; fly {first} and {second} before.")
    return answer, str(safe), *lines


def _step_files(path: Path) -> list[Path]:
    """Return the files of the steps to the proposed gains; the last one is the stated file."""
    before = [path.with_stem(f"{path.stem}_step{k}") for k in range(1, STEPS)]
    return [*before, path]


def _comments(safe: SafeGains, options: argparse.Namespace, log: Recording | None) -> list[str]:
    """Return comments of a parameter file: the sources, today's gains, and the verdict."""
    sources = [str(path) for path in options.fits]
    if log:
        sources.append(f"{log.source}, sha256 {log.checksum}")
    today = ", ".join(f"{name} {value:.7g}" for name, value in safe.today.items())
    return [
        f"greybox {__version__}, {date.today()}, from {', '.join(sources)}",
        f"Today's gains: {today}",
        capitalized(safe.verdict),
        str(safe.comparison),
        PROMISE,
    ]
