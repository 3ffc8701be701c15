"""The answer and how far it can be believed.

Begin with `fit`, then `result`, which holds `Fit` and what it prints. `quantities` makes the lines of the answer,
`fitted_record` the plain values that it keeps of a record. `covariance` holds the standard errors of every criterion,
`record_information` what the samples of a record tell of the parameters where residuals are correlated in time. The
folder `diagnostics` holds the warnings, and `storage` writes and reads fits.
"""
