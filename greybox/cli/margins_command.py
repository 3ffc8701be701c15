"""The command `greybox margins`: stability margins of a saved fit in the loop of a controller."""

import argparse
from typing import Any

from greybox.cli.catalog import find_controller, shipped_module
from greybox.cli.options import (
    UsageError,
    add_common_options,
    add_level_option,
    add_words,
    assignments,
    texts,
)
from greybox.cli.output import FAILED, USABLE, Answer, require_figure, save_figure
from greybox.cli.saved_fits import add_fit_argument, stated_fit
from greybox.experiment.controller import Controller
from greybox.experiment.margins import margins
from greybox.logs.readers import read

EXAMPLES = (
    "pitch.h5 --log flight.BIN --axis pitch",
    "pitch.h5 --controller controller:AttitudeController --signals q=theta_dot",
    "rate.h5 --controller my.py:RateLoop --set K_P=0.12 K_I=0.1 --rate 400 --broken-at u q",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_fit_argument(parser)
    add_controller_options(parser)
    about = "a log, whose controllers are checked; margins are also measured from it"
    parser.add_argument("--log", help=about)
    parser.add_argument("--axis", default="pitch", help="roll, pitch (default) or yaw of the log")
    parser.add_argument(
        "--broken-at",
        nargs="+",
        default=[""],
        metavar="SIGNAL",
        help="where to break the loop: an input of the plant (default: the first) or a measured "
        "signal",
    )
    parser.add_argument(
        "--tracking",
        nargs=2,
        metavar=("SETPOINT", "SIGNAL"),
        help="of which setpoint and response to give bandwidth and step (default: the first ones)",
    )
    add_words(parser, "--at", "NAME=VALUE", "operating point of an ODE")
    add_level_option(parser)
    add_common_options(parser, "the loop, broken at the first signal,")


def add_controller_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that state the controllers of a loop."""
    parser.add_argument(
        "--controller",
        nargs="+",
        default=(),
        metavar="CLASS",
        help="controller:AttitudeController or my.py:Class; several in the order in which they run",
    )
    add_words(parser, "--set", "NAME=VALUE", "gains in place of the declared ones")
    parser.add_argument("--rate", type=float, metavar="HZ", help="sampling rate of the controllers")
    about = "a signal of a controller and its name in the plant, e.g. q=theta_dot"
    add_words(parser, "--signals", "OWN=PLANT", about)


def run(options: argparse.Namespace) -> Answer:
    """Read the fit, close the loop, and return the margins wherever it is broken."""
    fit, _ = stated_fit(options)
    # A log has the controller that flew, with its gains and its rate.
    if options.log:
        signals = texts(options.signals, "--signals", "OWN=PLANT, e.g. q=theta_dot")
        firmware = shipped_module("models", "firmware")
        loop = firmware.loop_of_log(
            read(options.log), fit, options.axis, signals=signals, level=options.level
        )
        return loop.to_dict(), str(loop), USABLE if loop.is_safe else FAILED
    controllers = stated_controllers(options)
    require_figure(options.plot, options.force)
    at = assignments(options.at, "--at") or None
    answers = [
        margins(
            fit,
            controllers,
            broken_at=signal,
            tracking=tuple(options.tracking) if options.tracking else None,
            at=at,
            level=options.level,
        )
        for signal in options.broken_at
    ]
    summary: dict[str, Any] = {"loops": [answer.to_dict() for answer in answers]}
    # A loop may be safe where it is broken at one signal, and not at another.
    usable = all(answer.is_safe for answer in answers)
    lines = save_figure(options.plot, "loop", answers[0])
    return summary, "\n\n".join([*map(str, answers), *lines]), USABLE if usable else FAILED


def stated_controllers(options: argparse.Namespace) -> list[Controller]:
    """Return the controllers with the gains and names of signals that the options state."""
    values = assignments(options.set, "--set")
    signals = texts(options.signals, "--signals", "OWN=PLANT, e.g. q=theta_dot")
    if not options.controller:
        raise UsageError("no controller is stated: give --controller or --log.")
    kinds = [find_controller(text) for text in options.controller]
    names = {name for kind in kinds for name in kind.parameters}
    if unknown := sorted(values.keys() - names):
        raise UsageError(
            f"--set {unknown[0]}: no controller has it; there are {', '.join(sorted(names))}."
        )

    # In a cascade, every controller takes the gains and signals that it has.
    return [
        kind(
            {name: value for name, value in values.items() if name in kind.parameters},
            rate=options.rate,
            signals={
                own: outside
                for own, outside in signals.items()
                if own in (*kind.inputs, *kind.setpoints, *kind.outputs)
            },
        )
        for kind in kinds
    ]
