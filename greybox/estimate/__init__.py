"""The answer and how far it can be believed.

Begin with `fit`. `result` holds `Fit`, `covariance` the standard errors of every criterion, `diagnostics` the warnings,
one question a file, and `storage` writes and reads fits.
"""
