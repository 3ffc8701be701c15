r"""The Gauss-Newton method for records: direct multiple shooting with condensing.

Begin with `iteration`.

| file | contents |
| --- | --- |
| `driver` | the solver of one problem: runs, polishing, the best states at given parameters |
| `iteration` | the iteration from a start to a minimum |
| `all_parts` | all parts of a problem at one iterate: trajectories, cost, where a step leads |
| `iterate` | an iterate, a step, damping, and the stages in which continuity is tightened |
| `normal_equations` | the step: a quadratic program in the parameters |
| `line_search` | the merit function, and the share of a step that does not increase it |
| `kinks` | minima where no side has a gradient of zero |
| `stability` | Kalman gains to begin with, and predictors that must be stable |
| `polishing` | steps beyond the tolerance, and in directions that the Hessian lost in rounding |
| `screening` | the promising ones among many starts |

**The problem.** Parameters z and the states at the beginning of short segments, the *nodes*,
minimize the negative log-likelihood of the residuals of all records (and the cost of frequency
responses), subject to *continuity*: each segment, simulated from its node, ends at the next node.
The nodes follow the data, so an unstable plant does not diverge, whatever the parameters. (Bock
1983; Bock, Kostina and Schlöder 2007, GAMM-Mitteilungen 30.)

**One iteration**:

1. *Linearize* all parts along the iterate (`greybox.engine.compiled.segments`): sensitivities of
every
   segment by its node and the parameters, and the Gauss-Newton Hessian of the residuals. The
   inverse residual covariance, re-estimated from the last residuals, weighs them.
2. *Condense* (`greybox.engine.compiled.condensing`): one sparse factorization, linear in the number
of
   segments, eliminates nodes and multipliers of continuity. A small quadratic model in z is left
   for each part; they add up.
3. *Step*: a quadratic program in z with bounds, linearized constraints, Levenberg-Marquardt
   damping, and the stability limit of Kalman gains.
4. *Line search* on a merit function: the cost and exact l1 penalties of the gaps and of violated
   constraints. A trial that fails is tried again with its gaps closed (second-order correction
   against the Maratos effect; Nocedal and Wright, Numerical Optimization, 2nd ed., section 15.5).
5. *Converged* when gaps are rounding and the predicted decrease is negligible, with a step that is
   small in standard errors; or when a negligible step finds no decrease.

**Far from the minimum** continuity is a penalty on the gaps instead, with a standard deviation that
shrinks in stages to zero; the first iterations move the nodes alone. Records of more than 160 000
samples go through these stages on excerpts, if these lead to better predictions of the whole.

**Many starts.** Of the default starts only the promising ones are run: short segments, evaluated
for all starts at once, give their order. Starts whose number the user chose are all run. A run
begins at its start, or, if predictions over whole segments are worse there than the means of the
outputs, where short segments lead from it.

**Where Newton steps fail**, delays at which the cost jumps are held. A run that no step decreases
has converged if some combination of the linearizations beside it has a gradient of zero: the
minimum lies at a kink. At whole samples of delays, all other unknowns settle first. A run without
Kalman gains that fails begins once more at its start, with simulated nodes; one that ends above the
cost of its start begins there again, with the best nodes and exact continuity. `settings` has the
limits of a run.
`greybox.engine.solve.multistart` has the search over the runs.

**Kalman gains** (`PredictionError`) begin with those of steady Kalman filters once continuity is
exact. Stable predictors forget their initial state and are simulated over whole stretches
(`greybox.engine.compiled.kalman_gain`). Where the likelihood grows toward the limit of stable
predictors, steps go along this limit.
"""
