"""From a problem to its minimum and the errors there.

| folder | contents |
| --- | --- |
| `compiled/` | a problem as functions of the solver's variables; transcriptions, condensing |
| `regression/` | estimates by linear least squares: they need no compiled problem, and no start |
| `solve/` | from starts to minima: IPOPT, Gauss-Newton, multistart |
| `covariance/` | the accuracy of a minimum |
"""
