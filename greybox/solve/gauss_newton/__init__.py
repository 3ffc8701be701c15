r"""The Gauss-Newton method for problems that have records: direct multiple shooting with condensing.

**The problem.** Parameters z and the states at the beginning of short segments, the *nodes*,
minimize the negative log-likelihood of the residuals of all records (and the cost of frequency
responses), subject to *continuity*: each segment, simulated from its node, ends at the next node.
The nodes follow the data, so an unstable plant does not diverge, whatever the parameters. (Bock
1983; Bock, Kostina and Schlöder 2007, GAMM-Mitteilungen 30.)

**One iteration** (`driver`), top to bottom:

1. *Linearize* all parts along the iterate (`all_parts`; `greybox.compiled.segments`): sensitivities
of every segment
   by its node and the parameters, and the Gauss-Newton Hessian of the residuals. Their weights are
   the inverse residual covariance, re-estimated from the last residuals; near the end its change
   with the parameters enters the Hessian (`greybox.compiled.residual_covariance`), so that
   convergence is quadratic.
2. *Condense* (`greybox.compiled.condensing`): nodes and multipliers of continuity are eliminated by
one sparse
   factorization, linear in the number of segments. A small quadratic model in z is left for each
   part; they add up.
3. *Step* (`normal_equations`): a quadratic program in z with bounds, linearized constraints,
Levenberg-Marquardt
   damping (`damping`), and the stability limit of Kalman gains (`stability`).
4. *Line search* (`line_search`) on a merit function (`merit`): the cost and exact l1 penalties of
the gaps and of
   violated constraints. A trial that fails is tried again with its gaps closed (second-order
   correction against the Maratos effect; Nocedal and Wright, Numerical Optimization, 2nd ed.,
   section 15.5).
5. *Converged* when gaps are rounding and the predicted decrease is negligible, with a step that is
small in standard
   errors; when the last two decreases show that the next one will be; or when a negligible step
   finds no decrease. Where the Hessian has lost the digits of a direction that the data determine,
   steps by a factor of the Jacobian follow (`sharpening`).

**Far from the minimum** continuity is a penalty on the gaps instead, with a standard deviation that
shrinks in stages to zero (`homotopy`); the first iterations move the nodes alone. Long records are
first solved on excerpts.

**Of many starts** that nobody has asked for by their number, the promising ones are run alone, and
begin where short segments, evaluated for all starts at once, have led (`screening`). Those that
were asked for are all run, on excerpts first; what is left of the way from there is gone once for
all that meet (`shared_runs`).

**Where Newton steps fail**: where gaps do not close, the records are simulated from their first
nodes from then on; delays at which the cost jumps are held; a stalled run begins once more near the
data. Each is a strategy that can be switched off, see `greybox.compiled.strategies`, which also
says what each buys by `benchmarks/ablation.py`. What a whole search tries besides its starts is in
`greybox.solve.local_search` and `greybox.solve.multistart`.

**Kalman gains** (`PredictionError`) begin with those of steady Kalman filters once continuity is
exact; stable predictors forget their initial state and are simulated over whole stretches
(`stability`, `greybox.compiled.kalman_gain`).

`iterate` holds where an iteration stands and the step that it takes.
"""
