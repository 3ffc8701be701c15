"""To and from other libraries and languages; each is imported when it is first asked for.

`python_control` and `scipy_signal` convert responses and linear systems, and models as ODEs for
python-control; both go through `linear_systems`, which brings a model and its values into matrices
and polynomials. `casadi_function` gives a model at its estimate as a CasADi function, `c_code` as C
source, `matlab_file` writes what MATLAB reads; names that these accept are made by `source_names`.
Records and responses become pandas data frames by `to_pandas()` of their own, fits JSON by
`Fit.to_json`.
"""

from greybox.interop.c_code import write_c as write_c
from greybox.interop.casadi_function import to_casadi as to_casadi
from greybox.interop.matlab_file import write_mat as write_mat
from greybox.interop.python_control import from_control as from_control
from greybox.interop.python_control import to_control as to_control
from greybox.interop.scipy_signal import from_scipy as from_scipy
from greybox.interop.scipy_signal import to_scipy as to_scipy
