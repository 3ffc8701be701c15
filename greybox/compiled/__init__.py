"""The problem as functions of the solver's variables.

Begin with `compiled_problem` (what a solver is given) and `part` (what every part of it answers, be it a frequency
response, `response_part` with `response_map` for large ones, or a record, `record_part`); `scaling` is between
parameters and the solver's variables.

A record is cut into segments (`sampled_data`), as many steps per sample as it needs (`step_size`). Every sample is one
CasADi function (`sample_step`), which `segments` evaluates and linearizes for all segments at once; `condensing`
eliminates the states at their beginnings, that is, continuity. `initial_states` gives the first ones,
`residual_covariance` the weights, `kalman_gain` the gain of a predictor, `record_information` the numbers that
correlated residuals are worth. `transcription/` holds the alternatives to this, one method a file, and `strategies` all
settings. `vectorized` evaluates CasADi functions in numpy over many columns, `code_generation` compiles them to C,
`library_cache` keeps the libraries.
"""
