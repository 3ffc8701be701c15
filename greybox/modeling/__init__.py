"""Declaring models and reading their formulas.

Begin with `model` (`TransferFunction`, `StateSpace`) and `parameter`. One formula has several readings: `functions`
serves numbers and CasADi expressions alike, `symbolic_reading` traces it, `linearization` gives the response of a model
at its operating point (`trim`), with the exact or the Padé delay, by `elimination` of the states; `realization` turns a
model into differential equations and `integrators` step them. `harmonic_balance` answers a `sine` of finite amplitude.
`model_reference` names a model in a stored result.
"""

from greybox.modeling.harmonic_balance import harmonic_response as harmonic_response
from greybox.modeling.integrators import Integrator as Integrator
from greybox.modeling.integrators import Rosenbrock as Rosenbrock
from greybox.modeling.integrators import RungeKutta as RungeKutta
from greybox.modeling.linearization import LinearSystem as LinearSystem
from greybox.modeling.linearization import frequency_response as frequency_response
from greybox.modeling.linearization import linearize as linearize
from greybox.modeling.linearization import rational as rational
from greybox.modeling.model import Model as Model
from greybox.modeling.model import StateSpace as StateSpace
from greybox.modeling.model import TransferFunction as TransferFunction
from greybox.modeling.model import feedback as feedback
from greybox.modeling.parameter import Parameter as Parameter
from greybox.modeling.sine import Sine as Sine
