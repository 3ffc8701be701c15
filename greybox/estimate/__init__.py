"""The answer and how far it can be believed.

Begin with `fit`, then `result`, which holds `Fit` and what it prints, and `fitted_part`, what it
keeps of each part. `quantities` makes the lines of the answer, `fitted_record` and
`fitted_spectrum` the parts of records and manoeuvres, `harmonic_numbers` chooses the harmonics of
sine tests. `covariance` computes the standard errors from the sandwich. Its bread and meat differ
from criterion to criterion: for responses they are the `spread` of each one in
`greybox.formulation.frequency_criteria`, for records they come from
`greybox.compiled.record_information`. `identifiability` says how well each parameter is determined,
and which combinations are although their members are not. `equivalent_minima` finds the parameter
vectors of one response, `response_band` has the confidence band of a fitted response,
`structural_identifiability` asks the same before any data, `sensitivity` which frequencies or times
tell of each parameter. `profile` follows the lowest cost along one quantity, for intervals that
need not be symmetric, which are `profiles`, of records by `held_records`; `fitted_problem` is the
problem again from its answer. The folder `diagnostics` holds the warnings, `storage` writes and
reads fits, `verdict` judges them in three sentences, and `summary` gives their numbers as plain
values.
"""
