"""Declaring models and reading their formulas.

Begin with `transfer_function` and `state_space`, which are the two kinds of `model`, and with
`parameter`. Formulas are written with `functions`. One formula has several readings:

- `symbolic_reading` traces it with CasADi; `complex_arithmetic` gives real and imaginary part of a
  function of s, and `rational` numerator, denominator and delay (`function_of_s` is what these two
  share).
- `expression_tree` has it as sums, products and functions, to be shown.
- `pade_delay` approximates a delay by a rational function or by states.
- `linear_response` is the frequency response, with `linearization` of an ODE at its operating point
  (`trim`) and `elimination` of the states.
- `harmonic_balance` is the response to a `sine` of finite amplitude, with `formula_structure` for
  what is linear and where a formula switches; `periodic_motions` tells which motion is meant where
  there are several.
- `realization` turns a model into differential equations, `integrators` and `implicit_integrators`
  step them, and `step_size` is the rule for the number of their steps.

`known_systems` are linear models whose numbers are known, such as a filter; `limit` is a transfer
function with a parameter at zero or infinity, `late_sensors` an ODE with outputs that are measured
late; `one_thread` has the lock under which CasADi takes derivatives; `model_reference` names a model in a stored result, `model_file` finds the models in a file of
one's own.
"""

from greybox.modeling.implicit_integrators import ImplicitIntegrator as ImplicitIntegrator
from greybox.modeling.integrators import Integrator as Integrator
from greybox.modeling.integrators import Rosenbrock as Rosenbrock
from greybox.modeling.integrators import RungeKutta as RungeKutta
from greybox.modeling.late_sensors import late_sensors as late_sensors
from greybox.modeling.linear_response import frequency_response as frequency_response
from greybox.modeling.linearization import LinearSystem as LinearSystem
from greybox.modeling.linearization import linearize as linearize
from greybox.modeling.model import Model as Model
from greybox.modeling.parameter import Parameter as Parameter
from greybox.modeling.periodic_motions import harmonic_response as harmonic_response
from greybox.modeling.rational import rational as rational
from greybox.modeling.sine import Sine as Sine
from greybox.modeling.state_space import StateSpace as StateSpace
from greybox.modeling.transfer_function import TransferFunction as TransferFunction
from greybox.modeling.transfer_function import feedback as feedback
