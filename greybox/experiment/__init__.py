"""Test signals, controllers and virtual flights.

Begin with `excitation` (sines and sweeps, and the files that bring them to a vehicle) and `multisine`; `controller` and
`virtual_flight` fly them in simulation.
"""

from greybox.experiment.controller import Controller as Controller
from greybox.experiment.excitation import Excitation as Excitation
from greybox.experiment.excitation import ardupilot_script as ardupilot_script
from greybox.experiment.excitation import sine_schedule as sine_schedule
from greybox.experiment.excitation import sweep as sweep
from greybox.experiment.excitation import systemid_parameters as systemid_parameters
from greybox.experiment.excitation import write_excitation as write_excitation
from greybox.experiment.multisine import multisine as multisine
from greybox.experiment.virtual_flight import virtual_flight as virtual_flight
