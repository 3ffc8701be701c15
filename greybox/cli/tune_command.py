"""The command `greybox tune`: gains that meet requirements on stability."""

import argparse
from pathlib import Path
from typing import Any

from greybox.cli.margins_command import add_controller_options, stated_controllers
from greybox.cli.options import (
    UsageError,
    add_common_options,
    add_level_option,
    add_words,
    intervals,
    positive_number,
    texts,
)
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, require_writable, save_figure
from greybox.cli.saved_fits import add_model_option, saved_fit
from greybox.experiment.gain_file import write_gains
from greybox.experiment.safe_gains import safe_gains

EXAMPLES = (
    "pitch.h5 --controller controller:AttitudeController --signals q=theta_dot "
    "--gains K_P=0.02:0.5 K_D=0.001:0.02",
    "light.h5 heavy.h5 --controller my.py:Loop --gains K_P=0.05:0.5 "
    "--names K_P=ATC_RAT_PIT_P --parameters pitch.param",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "fits", nargs="+", type=Path, metavar="RESULT", help="saved fits, one for each flight"
    )
    add_model_option(parser)
    add_controller_options(parser)
    about = "one to three gains, and the range in which to look for safe ones"
    add_words(parser, "--gains", "NAME=LOW:HIGH", about)
    for name, value, unit in (("phase", 45.0, "degrees"), ("gain", 6.0, "dB")):
        parser.add_argument(
            f"--{name}-margin",
            type=positive_number,
            default=value,
            metavar=unit.upper(),
            help=f"required {name} margin in {unit} (default: {value:g})",
        )
    parser.add_argument(
        "--delay",
        type=positive_number,
        default=0.0,
        metavar="SECONDS",
        help="additional delay with which the requirements must hold, too",
    )
    add_level_option(parser)
    parser.add_argument("--broken-at", default="", metavar="SIGNAL", help="where to break the loop")
    about = "names of the gains in the firmware, for --parameters"
    add_words(parser, "--names", "GAIN=PARAMETER", about)
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="write the best gains to a file for a ground station: .param for ArduPilot, .params "
        "for PX4",
    )
    add_common_options(parser, "the allowed gains", writes=True)


def run(options: argparse.Namespace) -> Answer:
    """Read the fits, try the gains, and return which of them are safe."""
    controllers = stated_controllers(options)
    gains = intervals(options.gains, "--gains")
    if not gains:
        raise UsageError("no gains are stated: add --gains NAME=LOW:HIGH.")
    names = texts(options.names, "--names", "GAIN=PARAMETER, e.g. K_P=ATC_RAT_PIT_P")
    require_writable(
        options.parameters, options.force, (".param", ".parm", ".params"), "parameter file"
    )
    require_figure(options.plot, options.force)
    answer = safe_gains(
        [saved_fit(path, options) for path in options.fits],
        controllers,
        gains,
        phase_margin=options.phase_margin,
        gain_margin=options.gain_margin,
        delay=options.delay,
        level=options.level,
        broken_at=options.broken_at,
    )
    summary: dict[str, Any] = answer.to_dict()
    text = str(answer)
    if options.parameters and answer.best:
        write_gains({names.get(n, n): v for n, v in answer.best.items()}, options.parameters)
        text += f"\nThe best gains are in {options.parameters}."
    text = "\n".join([text, *save_figure(options.plot, "gains", answer)])
    return summary, text, USABLE if answer.best else FAILED
