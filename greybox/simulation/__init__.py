"""Models run at given values.

Begin with `simulate` (`simulate`, `predict`). `model_at_estimate` brings model and values together,
`simulator` runs the model with as many steps as accuracy needs, `windows` cuts a record,
`state_estimation` finds the state at the beginning of each window, `own_values` what else belongs
to a record that the model was not fitted to (biases, trims), and `prediction` is what `predict`
returns.
"""

from greybox.simulation.prediction import Prediction as Prediction
from greybox.simulation.simulate import predict as predict
from greybox.simulation.simulate import simulate as simulate
