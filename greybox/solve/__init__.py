"""From starts to minima.

Begin with `multistart`.

| file | contents |
| --- | --- |
| `multistart` | which solver a problem gets, and its runs from many starts |
| `waves` | in which order starts are tried, and when there were enough |
| `local_solver` | what every solver answers |
| `ipopt` | IPOPT on frequency responses |
| `batched_solver` | the default for frequency responses: many starts improved at once, minima confirmed by IPOPT |
| `batched_newton`, `newton_iteration` | Newton's method from many points, and its iteration |
| `gauss_newton/` | Gauss-Newton steps on records |
| `transcribed_program` | records as one sparse program for IPOPT |
| `global_search` | the scatter search of MATLAB's GlobalSearch |
| `local_search`, `discretization_error` | further starts near an end; finer integration steps |
| `outcome`, `runs`, `minima` | what one run leaves; all runs in columns; distinct minima |
| `executors`, `worker_pool`, `kept_runs` | runs in other processes; processes on this machine; stored runs |
| `interruption`, `time_limits` | Ctrl-C; how long a search may take |
| `constraints`, `quadratic_program` | bounds and constraints of a Gauss-Newton step |
| `cost` | the cost at given parameters |
"""

from greybox.compiled.strategies import Strategies as Strategies
from greybox.formulation.starts import LatinHypercube as LatinHypercube
from greybox.formulation.starts import Listed as Listed
from greybox.formulation.starts import Sobol as Sobol
from greybox.formulation.starts import Starts as Starts
from greybox.formulation.starts import UntilFoundAgain as UntilFoundAgain
from greybox.solve.worker_pool import WorkerPool as WorkerPool
