"""Test signals, controllers, margins of loops, virtual flights, and plans of flight tests.

Begin with `excitation` (what a test signal is) or `expected_errors` (the information in a planned
test).

| file | contents |
| --- | --- |
| `excitation` | test signals and their maneuvers |
| `sine_schedules`, `sweeps`, `multisines` | the signals that are flown |
| `scripts` | files that fly them on a vehicle |
| `controller` | sampled control laws |
| `sampled_loop` | the loop of a plant and its controllers, as linear equations |
| `drawn_loops` | that loop at an estimate and at draws from its distribution |
| `crossings` | where curves of many plants change their sign |
| `loop_numbers`, `closed_loop` | margins of such loops; numbers of the closed ones |
| `margins`, `margin_values` | these numbers with their errors, and how they are printed |
| `measured_loop_margins` | margins of measured loops, with their errors |
| `control_check` | whether a controller computes the control of a log |
| `measured_loop` | broken loops from measured responses |
| `simulated_flights` | many short flights, and how many of them saturate or ring |
| `gain_comparison` | gains against today's, number by number |
| `gain_objectives` | what gains should make small |
| `todays_loop` | the loop with today's gains, and how other gains change it |
| `required_margins` | whether the loops of a flight have the required margins |
| `gain_search` | which of the gains that have them are proposed |
| `safe_gains` | gains that meet requirements on margins, and are better than today's |
| `gain_file` | files of gains for ground stations |
| `virtual_flight` | flights in simulation |
| `expected_errors` | the standard errors that a planned test would give |
| `sine_plan`, `shortest_flight` | sines that reach the wanted errors in the shortest flight |
| `optimal_design` | shares of time for the frequencies of a plan |
"""

from greybox.workflows.experiment.control_check import (
    ControlCheck as ControlCheck,
    check_controller as check_controller,
)
from greybox.workflows.experiment.controller import Controller as Controller
from greybox.workflows.experiment.excitation import Excitation as Excitation
from greybox.workflows.experiment.expected_errors import (
    ExpectedErrors as ExpectedErrors,
    expected_errors as expected_errors,
)
from greybox.workflows.experiment.gain_comparison import GainComparison as GainComparison
from greybox.workflows.experiment.gain_file import write_gains as write_gains
from greybox.workflows.experiment.gain_objectives import RejectionBandwidth as RejectionBandwidth
from greybox.workflows.experiment.margin_values import (
    Margins as Margins,
    margin_table as margin_table,
)
from greybox.workflows.experiment.margins import margins as margins
from greybox.workflows.experiment.measured_loop import broken_loop as broken_loop
from greybox.workflows.experiment.measured_loop_margins import measured_margins as measured_margins
from greybox.workflows.experiment.multisines import multisine as multisine
from greybox.workflows.experiment.safe_gains import SafeGains as SafeGains, safe_gains as safe_gains
from greybox.workflows.experiment.scripts import (
    ardupilot_script as ardupilot_script,
    systemid_parameters as systemid_parameters,
    write_excitation as write_excitation,
)
from greybox.workflows.experiment.sine_plan import SinePlan as SinePlan, plan_sines as plan_sines
from greybox.workflows.experiment.sine_schedules import sine_schedule as sine_schedule
from greybox.workflows.experiment.sweeps import sweep as sweep
from greybox.workflows.experiment.virtual_flight import virtual_flight as virtual_flight
