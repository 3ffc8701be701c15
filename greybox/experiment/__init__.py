"""Test signals, controllers and virtual flights.

Begin with `excitation` (what a test signal is). `sines`, `sweep` and `multisine` make one; `scripts` bring it to a
vehicle; `controller` (sampled control laws) and `virtual_flight` fly it in simulation.
"""

from greybox.experiment.controller import Controller as Controller
from greybox.experiment.excitation import Excitation as Excitation
from greybox.experiment.multisine import multisine as multisine
from greybox.experiment.scripts import ardupilot_script as ardupilot_script
from greybox.experiment.scripts import systemid_parameters as systemid_parameters
from greybox.experiment.scripts import write_excitation as write_excitation
from greybox.experiment.sines import sine_schedule as sine_schedule
from greybox.experiment.sweep import sweep as sweep
from greybox.experiment.virtual_flight import virtual_flight as virtual_flight
