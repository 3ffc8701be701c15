"""From starts to minima.

Begin with `multistart`. `ipopt` solves problems of frequency responses, `gauss_newton` those with records,
`transcribed_program` hands records to IPOPT as one sparse program; `minima` groups the runs.
"""

from greybox.formulation.starts import LatinHypercube as LatinHypercube
from greybox.formulation.starts import Listed as Listed
from greybox.formulation.starts import Sobol as Sobol
from greybox.formulation.starts import Starts as Starts
from greybox.formulation.starts import Uniform as Uniform
