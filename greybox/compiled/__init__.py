"""The problem as functions of the solver's variables.

Begin with `compiled_problem` (what a solver is given) and `part` (what every part of it answers, be
it a frequency response, `response_part` with `response_map` for large ones, the spectrum of a
manoeuvre, `transient_part`, or a record, `record_part`); the first two are each a
`part_without_nodes`. `scaling` is between parameters and the solver's variables, `limits` has the
constraints. `explicit_program` states problems with trims that Newton's method finds.

A record is cut into segments (`sampled_data`), as many steps per sample as it needs (`step_size`).
Every sample is one CasADi function (`sample_step`), which `segments` evaluates and linearizes for
all segments at once, those of several records that share it together (`record_group`); `condensing`
eliminates the continuity of multiple shooting: the states at the nodes, where segments begin, and
its multipliers. `initial_states` gives the first ones, `residual_covariance` the weights,
`kalman_gain` the gain of a predictor, `riccati` the one that follows from process noise,
`record_information` the numbers that correlated residuals are worth. `transcription/` holds the
methods by which the states of a record become unknowns, one method a file (multiple shooting is the
above), and `strategies` all settings. `vectorized` evaluates CasADi functions in numpy over many
columns, `alike_terms` the derivatives of a cost whose terms differ in their constants alone.
"""
