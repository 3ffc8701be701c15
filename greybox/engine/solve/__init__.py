"""From starts to minima.

Begin with `search`.

| file | contents |
| --- | --- |
| `search` | the first step of a fit: runs from all starts, finer steps, polished minima |
| `multistart` | the order of the starts, the runs from them, and their minima |
| `search_method` | the solver of a problem, by a word or an object |
| `own_solver` | a user's own solver, and its runs |
| `promising` | which of many starts are run first, and when the others are not needed |
| `local_solver` | what every solver answers |
| `response_solver` | frequency responses: many starts improved at once, minima confirmed by IPOPT |
| `shared_solver` | many responses that share one solve: starts with process noise, no IPOPT |
| `batched_newton` | Newton's method from many points |
| `newton_iteration` | one iteration as two CasADi functions |
| `barrier_levels` | the levels through which a search passes |
| `process_noise_start` | starts of state spaces by output error with process noise |
| `gauss_newton/` | Gauss-Newton steps on records |
| `transcribed_program` | records as one sparse program for IPOPT |
| `ipopt` | IPOPT on one program |
| `not_finite` | where and why a model has no finite value |
| `stationarity` | whether the end of a run is a minimum |
| `discretization_error` | finer integration steps |
| `robust_fit` | fits in which large errors are bounded |
| `runs`, `minima` | the results of runs; distinct minima |
| `run_storage` | storage for runs as they finish |
| `other_minima` | minima beside one that all runs reach |
| `executors` | runs in this process, or in those of an executor |
| `worker_pool`, `worker_task`, `worker_payload` | processes here, what each does and receives |
| `lost_workers`, `blas_threads` | errors of lost workers; one thread for matrix products |
| `interruption` | Ctrl-C, and how long a search may take |
| `constraints`, `quadratic_program` | bounds and constraints of a Gauss-Newton step |
| `objective` | the cost with its derivatives, for any solver or sampler |
| `point_costs`, `response_costs`, `record_costs` | what it asks of a compiled problem at a point |
| `response_residuals` | residuals of a frequency response |
| `cost` | the cost at given parameters |
"""

from greybox.engine.solve.worker_pool import WorkerPool as WorkerPool
from greybox.modeling.formulation.starts import Listed as Listed, Sobol as Sobol, Starts as Starts
