"""The command `greybox simulate`: a saved model driven by the inputs of a log."""

import argparse

from greybox.assessment.simulation.simulate import simulate
from greybox.cli.output import Answer, require_writable
from greybox.cli.predict_command import LOG_OPTIONS, flown_record
from greybox.cli.saved_fits import saved_fit
from greybox.workflows.experiment.scripts import write_excitation

EXAMPLES = (
    "cart.h5 other.csv --initial x=0.2 --out motion.csv",
    "pitch_fit.h5 other_flight.BIN --between 20 30 --out motion.csv",
)
# The options as their help shows them: see `declare` of `greybox.cli.options`.
OPTIONS = f"""{LOG_OPTIONS}
--initial NAME=VALUE...
    initial states; others begin at zero
--out FILE
    write outputs and states to this CSV file (required)
--force
"""


def run(options: argparse.Namespace) -> Answer:
    """Simulate from the beginning to the end, without a look at the measured outputs."""
    require_writable(options.out, options.force, (".csv",), "table")
    fit = saved_fit(options.result, options)
    motion = simulate(fit, record=flown_record(fit, options), initial=options.initial)
    write_excitation(motion, options.out)
    return {"file": options.out}, motion.name, f"wrote {options.out}"
