"""To and from other libraries and languages; each library is imported when it is first used.

Begin with `python_control`.

| file | contents |
| --- | --- |
| `python_control` | responses and linear systems of python-control |
| `linear_systems` | a model and its values as polynomials, matrices or an ODE |
| `casadi_function` | a model at its estimate as a CasADi function |

Records and responses have `to_pandas()`, fits `Fit.to_json`.
"""

from greybox.reporting.interop.casadi_function import to_casadi as to_casadi
from greybox.reporting.interop.python_control import (
    from_control as from_control,
    to_control as to_control,
)
