"""From starts to minima.

Begin with `multistart`, which chooses the solver, and `local_solver`, what every solver answers.
`ipopt` solves problems of frequency responses, `screened_ipopt` compares the starts before; from
many starts `batched_solver` brings them to minima together, by `batched_newton`, whose steps are in
`newton_iteration`, and, under constraints, `augmented_lagrangian`, and has IPOPT confirm each.
`gauss_newton/` solves problems with records, and `transcribed_program` hands records to IPOPT as
one sparse program. `waves` says in which order starts are tried and when there were enough;
`global_search` is the scatter search of MATLAB's GlobalSearch; an `outcome` is what one run leaves,
`runs` has those of a search in columns, `minima` groups them. `executors` has the runs made by
other processes, `worker_pool` has such on this machine, `kept_runs` says what keeps them.
`local_search` tries more than the starts, `discretization_error` refines the integration, `cost`
evaluates a problem at given parameters. `constraints` and `quadratic_program` serve the
Gauss-Newton steps. `interruption` says what becomes of Ctrl-C, `time_limits` how long a search may
take.
"""

from greybox.compiled.strategies import Strategies as Strategies
from greybox.formulation.starts import LatinHypercube as LatinHypercube
from greybox.formulation.starts import Listed as Listed
from greybox.formulation.starts import Sobol as Sobol
from greybox.formulation.starts import Starts as Starts
from greybox.formulation.starts import Uniform as Uniform
from greybox.formulation.starts import UntilFoundAgain as UntilFoundAgain
from greybox.solve.worker_pool import WorkerPool as WorkerPool
