"""The command `greybox tune`: gains that meet requirements and are better than today's."""

import argparse

from greybox.cli.margins_command import CONTROLLER_OPTIONS, stated_controllers
from greybox.cli.output import Answer, require_figure, require_writable, save_figure
from greybox.cli.saved_fits import flight_log, saved_fit
from greybox.data.files.named_values import attributes
from greybox.workflows.experiment.gain_file import write_gains
from greybox.workflows.experiment.safe_gains import safe_gains
from greybox.workflows.study.catalog import shipped_module

EXAMPLES = (
    "pitch.h5 --controller controller:AttitudeController --signals q=theta_dot "
    "--gains K_P=0.02:0.5 K_D=0.001:0.02",
    "pitch.h5 --log flight.BIN --phase-margin 45 --gain-margin 6 --parameters pitch.param",
    "pitch.h5 --log flight.BIN --gains ATC_RAT_PIT_P=0.05:0.3 ATC_RAT_PIT_D ATC_ANG_PIT_P",
    "light.h5 heavy.h5 --controller my.py:Loop --gains K_P=0.05:0.5 "
    "--names K_P=ATC_RAT_PIT_P --parameters pitch.param",
)
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
    one to three gains, and the range in which to look for safe ones: without one, a quarter to four
    times today's gain; without the option, P and D of the rate controller of the log
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
    .txt for the command line of Betaflight; no file is written where today's gains are to be kept
--plot FILE
    draw the allowed gains into this png, pdf or svg file
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Read the fits, try the gains, and return the proposed ones, or to keep today's."""
    require_writable(
        options.parameters, options.force, (".param", ".parm", ".params", ".txt"), "parameter file"
    )
    require_figure(options.plot, options.force)
    fits = [saved_fit(path, options) for path in options.fits]
    required = attributes(
        options, "phase_margin", "gain_margin", "delay", "level", "broken_at", "at"
    )
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
    if not safe.is_usable:
        answer["error"] = safe.verdict
    elif options.parameters and not safe.best:
        lines.append(f"{options.parameters} was not written.")
    elif options.parameters:
        names = options.names
        write_gains({names.get(n, n): value for n, value in safe.best.items()}, options.parameters)
        lines.insert(0, f"The proposed gains are in {options.parameters}.")
    return answer, str(safe), *lines
