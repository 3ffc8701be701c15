"""The checks of a fit: each file asks one question, and each answer is a sentence or nothing.

Begin with `included`. A check is a function of the `Evidence` that yields `Finding`s; one of your
own joins them by ``gb.fit(problem, checks=[*gb.CHECKS, mine])``.

| file | contents |
| --- | --- |
| `evidence` | What the checks of a fit may look at |
| `finding` | What a check found, and one sentence in place of many alike |
| `included` | The checks that every fit stands, unless you say otherwise |
| `not_finite` | Whether most runs failed because the model had no finite value |
| `wrapped_outputs` | Whether outputs jump by a full turn where the fitted ones do not |
| `data_findings` | What the reader of a log found: restarts, lost lines, misspelled units |
| `faulty_samples` | What a logger did to the samples: repeated, interpolated, clipped ones |
| `repeated_data` | Whether data are fitted twice, such as a file that was given twice |
| `coarse_integration` | Whether the integration is accurate enough for the noise |
| `unexplained` | Whether the model explains the data |
| `slow_errors` | Whether errors stay correlated where few frequencies show the parameters |
| `unexplained_outputs` | Which outputs the model hardly reproduces |
| `feedback` | Whether feedback responds to correlated errors, which biases output error |
| `colored_predictions` | Whether prediction errors are correlated in time |
| `gain_at_limit` | Whether a Kalman gain has reached the stability limit |
| `flattened_inputs` | Whether lines between the samples of an input attenuate it |
| `carried_over` | Whether missing samples of an output were filled with the previous one |
| `gusts` | Whether residuals are process noise, such as gusts, or noise of sensors |
| `not_determined` | Which parameters the data do not determine, or only in combination |
| `held_without_error` | Whether values that an earlier fit holds have an error |
| `no_degrees_of_freedom` | Whether there are more numbers than unknowns |
| `prior_conflicts` | Whether the data contradict a prior |
| `at_bounds` | Which parameters ended at a bound, and which constraints hold with equality |
| `few_agreeing_starts` | Whether enough starts agree on the best minimum |
| `unfinished_runs` | Whether a run that did not converge was lower than the answer |
| `minimum_at_kink` | Whether the cost has a kink at the minimum |
| `rival_minima` | Whether another minimum is nearly as likely |
| `several_estimates` | Whether clearly different parameters give the same response |
| `coarse_pade` | Whether the Padé approximation of a delay is accurate enough |
| `delays_within_a_sample` | Whether a held response can show a delay |
| `unstated_holds` | Whether a delay may contain half a sample of a hold that nobody states |
| `unlikely_noise` | Whether the residuals are as large as the noise that was given with the data |
| `narrow_modes` | Whether a mode is too narrow for the spectra |
| `manoeuvre_errors` | Whether the errors of a manoeuvre look like turbulence |
| `correlated_frequencies` | Whether the errors of a response are correlated along frequency |
| `discontinuous_cost` | Whether the cost jumps at whole samples of a delay |
| `outlying_points` | Whether a point of a response is an outlier |
| `unequal_errors` | Whether errors are larger in a part of the band than assumed |
| `outlying_samples` | Whether samples of a record are outliers |
| `unused_noise` | Whether the criterion uses the variances or the coherence of a response |
| `better_weights` | Whether other weights of the parts would give clearly smaller errors |
| `resting_inputs` | Which inputs never change in any record |
| `rounded_outputs` | Whether the noise of an output is smaller than half of its resolution |
| `determined_together` | Which combinations are determined although none of their members is |
| `failure` | What came closest where no run converged, what blocks it, and what to try |
| `records` | What several checks of records ask of them |
"""
