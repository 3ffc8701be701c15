"""The answer and how far it can be believed.

Begin with `fit`, then `result`, which holds `Fit` and what it prints. `quantities` makes the lines of the answer,
`fitted_record` the plain values that it keeps of a record, `harmonic_numbers` chooses the harmonics of sine tests.
`covariance` holds the standard errors of every criterion: bread and meat of the sandwich are the `spread` of each
criterion in `greybox.formulation.frequency_criteria`, and for records `greybox.compiled.record_information`. The folder
`diagnostics` holds the warnings, and `storage` writes and reads fits.
"""
