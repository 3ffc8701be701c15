"""Models run at given values.

Begin with `simulate` (`simulate`, `predict`). `windows` cuts a record, `state_estimation` finds the state at the
beginning of each window, `simulator` runs the model with as many steps as accuracy needs.
"""

from greybox.simulation.prediction import Prediction as Prediction
from greybox.simulation.simulate import predict as predict
from greybox.simulation.simulate import simulate as simulate
