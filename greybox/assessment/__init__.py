"""The answer and how far it can be believed.

Begin with `fit`.

| file | contents |
| --- | --- |
| `fit` | from a problem to its answer in three steps: search, estimate, assess |
| `at_minimum` | the estimate at the best minimum, with its errors |
| `assess` | what its checks find, the misfit, and profiles |
| `checks/` | the checks, a file each |
| `result` | `Fit`, the answer as values |
| `verdict` | the answer in a few sentences |
| `printed` | the answer as text, as HTML for notebooks, and as plain values for JSON |
| `at_estimate` | the model at the estimate, to be run on records |
| `fitted_part` | the values that an answer keeps of each part of its problem |
| `fitted_values` | how these are made from the compiled part |
| `fitted_problem` | the problem again, from its answer |
| `quantities` | estimates, tied values and derived quantities with their standard errors |
| `identifiability` | how well each parameter is determined; combinations that are, or are not |
| `structural_identifiability` | the same for a model structure, before there are data |
| `transfer_function_numbers` | gain, poles, zeros and delay of a fit, with their errors |
| `response_band` | confidence band of a fitted response |
| `misfit/` | whether the model explains the data, and what it may lack |
| `draws` | parameter sets from the distribution of an estimate, and files of them for simulators |
| `profile` | likelihood profiles, by minima with a quantity held, and where they end |
| `held_minima` | minima with a quantity held, the points of a profile |
| `profile_result` | the profiles as values |
| `largest_deviation` | the point of a response that deviates most |
| `disturbed_state` | the state that gusts reach, by the residuals |
| `wrapped_outputs` | outputs that jump by a full turn |
| `pade_error` | how far a Padé approximation is from the delay |
| `simulation/` | models run at given values: simulation, prediction |
| `validation/` | comparison of fits on their own and on held-out data |
| `storage`, `stored_values` | fits in HDF5 files, and how their fields are stored |
"""
