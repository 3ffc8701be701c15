"""Statistics of residuals and signals that know nothing of models.

`residual_autocorrelation` is what standard errors in time take from correlated residuals, `noise_ratio` tells a smooth
signal from noise, `metrics` holds fit percent, variance accounted for, Theil's coefficient and tests of whiteness.
"""
