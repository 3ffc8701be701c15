"""Statistics of residuals and signals, independent of any model.

Begin with `metrics` for measures of fit, or `residual_spectrum` for errors that are correlated in
time.

| file | contents |
| --- | --- |
| `metrics` | measures of fit; tests of whiteness, of correlation with the input, and of feedback |
| `error_distribution` | how errors are distributed, and how much large ones count |
| `huber` | large errors bounded, for robust estimates |
| `noise_ratio` | whether a signal is smooth or noise |
| `residual_autocorrelation` | autoregressions of one series |
| `error_spectrum` | a spectrum of errors: residuals made white, errors drawn |
| `frequency_grid` | transforms, and the bands in which spectra are compared |
| `score_test` | whether residuals follow terms that a fitted model does not have |
| `autoregressive_test` | whether records lack a term, if errors are autoregressive |
| `variance_components` | the variances of sensors and process noise in residuals |
| `residual_spectrum` | covariance of an estimate whose errors are correlated in time |
| `neighbor_correlation` | the same for errors that are correlated along frequency |
| `uneven_errors` | the same for errors that are larger at some frequencies than at others |
| `shared_errors` | the same for errors that several responses share |
| `disturbed_errors` | whether errors of a manoeuvre are those of a gust, or louder at times |
| `column_space` | what fitted parameters can take from residuals |
"""
