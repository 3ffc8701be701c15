"""Declare models; read their formulas as numbers, CasADi expressions, rational functions and ODEs.

Begin with `model`.

| file | contents |
| --- | --- |
| `model`, `transfer_function`, `state_space` | what every model declares, and its two kinds |
| `declaration` | checks of what the class of a model declares |
| `parameter`, `functions` | what formulas are written with |
| `formula_arguments` | the arguments of a formula, values by name |
| `merged_parameters` | parameters of the same name as one unknown |
| `symbolic_reading`, `traced_once` | a formula traced with CasADi, once for an unchanged model |
| `one_thread`, `cached_property` | the lock for derivatives and solvers, and values without it |
| `fingerprint` | keys of values, equal in every process |
| `complex_arithmetic` | real and imaginary part of a function of s |
| `rational`, `factored_form` | numerator, denominator and delay, and their print |
| `function_of_s` | what these two readings of s share |
| `formula_structure` | a formula operation by operation |
| `pade_delay` | a delay as a rational function or as states |
| `linear_response` | the frequency response of a model |
| `trim`, `linearization` | the operating point, and the linear system there |
| `elimination` | the response of a linear system of expressions |
| `realization` | every model as an ODE with delayed inputs |
| `integrators`, `implicit_integrators`, `step_size` | explicit and implicit steps, and how many |
| `held_inputs` | the exact step of a linear system with held inputs |
| `known_systems` | linear models with known numbers, such as a filter |
| `added_terms` | an ODE with further terms in its derivatives |
| `disturbance` | what white noise drives and adds to a derivative, such as a gust |
| `colored_disturbance` | an ODE with such disturbances |
| `formulation/` | what is estimated from what: problems, criteria, starts |
| `model_reference`, `model_file` | a model by name in a stored result, or in a file of your own |
"""

from greybox.modeling.implicit_integrators import (
    ImplicitIntegrator as ImplicitIntegrator,
    Radau as Radau,
)
from greybox.modeling.integrators import Integrator as Integrator, RungeKutta as RungeKutta
from greybox.modeling.linear_response import frequency_response as frequency_response
from greybox.modeling.linearization import LinearSystem as LinearSystem, linearize as linearize
from greybox.modeling.model import Model as Model
from greybox.modeling.parameter import Parameter as Parameter
from greybox.modeling.rational import rational as rational
from greybox.modeling.state_space import StateSpace as StateSpace
from greybox.modeling.transfer_function import (
    TransferFunction as TransferFunction,
    feedback as feedback,
)
