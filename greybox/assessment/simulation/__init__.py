"""Simulation and prediction of records at given parameter values.

Begin with `simulate`.

| file | contents |
| --- | --- |
| `simulate` | `simulate` and `predict` |
| `prediction` | the value that `predict` returns, and the windows of a record |
| `model_at_estimate` | a model with its values, covariance, and assumptions of the fit |
| `simulator` | simulation with as many steps as accuracy needs, and its standard errors |
| `state_estimation` | the state at the beginning of each window |
| `own_values` | biases and trims of a record to which the model was not fitted |
"""

from greybox.assessment.simulation.prediction import Prediction as Prediction
from greybox.assessment.simulation.simulate import predict as predict, simulate as simulate
