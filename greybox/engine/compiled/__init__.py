"""The problem as functions of the solver's variables.

Begin with `compiled_problem`.

| file | contents |
| --- | --- |
| `compiled_problem` | what a solver is given: parts, constraints, scaling |
| `part` | the interface of every part of a problem |
| `response_part` | a frequency response |
| `data_input` | the data of responses as an input of their functions |
| `response_programs` | all frequency responses as programs for a solver |
| `shared_response` | many responses of one state space, with one solution for all of them |
| `transient_part` | the spectrum of a manoeuvre |
| `record_model` | a record with its model, whatever the cut into segments |
| `segmented_part` | records cut into segments: placement, trajectories, cost, linearization |
| `information` | what every part says of the values, for the covariance of an estimate |
| `response_information` | that of a frequency response |
| `record_information` | that of a record |
| `record_part` | a record with its information, and as expressions for IPOPT |
| `steep_bounds` | bounds at which a root is infinitely steep |
| `step_size` | substeps of a sample and samples of a segment |
| `initial_states` | initial states at the nodes |
| `record_group` | several records evaluated together |
| `sampled_data` | a record as gapless stretches of samples, cut into segments |
| `sample_step` | one sample as a CasADi function |
| `segments` | all segments simulated and linearized at once |
| `condensing` | elimination of nodes and multipliers of continuity |
| `residual_covariance` | the weights of the residuals |
| `kalman_gain`, `riccati` | the gain of a predictor; the one that follows from process noise |
| `disturbances` | how the outputs of a record would follow terms that its model does not have |
| `record_sensitivity` | derivatives of the residuals |
| `colored_errors` | residuals that are correlated in time |
| `transcription` | the methods by which the states of a record become unknowns |
| `vectorized` | CasADi functions over many columns |
"""
