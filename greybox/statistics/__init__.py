"""Statistics of residuals and signals, independent of any model.

`residual_spectrum` is what standard errors in time use where residuals are correlated,
`variance_components` has the variances of sensors and process noise in it, and `error_spectrum`
draws such errors; `residual_autocorrelation` makes a series white; `neighbor_correlation` is what
those of frequency responses use, and `column_space` what fitted parameters can take from residuals;
`noise_ratio` tells a smooth signal from noise; `metrics` holds fit percent, variance accounted for,
Theil's coefficient and tests of whiteness, of correlation with the input, and of feedback.
"""
