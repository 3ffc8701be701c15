"""The causes of misfit that are tried: each file yields terms of a kind that a model may lack.

Begin with `included`. A cause is a function of the `TestedRecord` that yields `RecordTerm`s; one of
your own joins them by ``gb.misfit(fit, causes=[*gb.CAUSES, mine])``.

| file | contents |
| --- | --- |
| `included` | the causes that every fit is tried for |
| `delays` | inputs that act later or earlier |
| `lags` | inputs behind a lag |
| `flexible_modes` | lightly damped modes that an input moves |
| `actuator_limits` | rate limits and backlash |
| `saturations` | saturations and dead zones, on both sides or on one |
| `sensors` | late sensors, and couplings of outputs |
| `nonlinear_terms` | products, powers and signs in equations, stops, feedback |
| `functions` | functions of any shape |
| `constants` | offsets, wrong initial states, constants, loads |
| `parameters` | values that change, are fixed, at a bound, or differ between parts |
| `logged_signals` | signals that the model does not use |
| `repeated_tests` | residuals that repeat with the inputs |
| `response_terms` | zeros, delays, poles, modes and steps of responses |
"""
