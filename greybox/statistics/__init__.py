"""Statistics of residuals and signals, independent of any model.

Begin with `metrics` for measures of fit, or `colored_information` for errors that are correlated in
time.

| file | contents |
| --- | --- |
| `metrics` | measures of fit |
| `correlation_statistics` | whether residuals are white, or follow an input |
| `error_growth` | whether errors are larger in a part of the band |
| `error_distribution` | how errors are distributed, and how much large ones count |
| `included_errors` | the included distributions of errors by name |
| `huber` | large errors bounded, for robust estimates |
| `noise_ratio` | whether a signal is smooth or noise |
| `residual_autocorrelation` | autoregressions of one series |
| `error_spectrum` | a spectrum of errors: residuals made white, errors drawn |
| `frequency_grid` | transforms, and the bands in which spectra are compared |
| `score_statistics` | whether residuals follow terms that a fitted model does not have |
| `restricted_likelihoods` | the same for errors of several kinds, each as likely as the data say |
| `beta_share` | the probability that terms explain so much of noise |
| `autoregressive_likelihood` | whether records lack a term, if errors are autoregressive |
| `variance_components` | the variances of sensors and process noise in residuals |
| `colored_information` | covariance of an estimate whose errors are correlated in time |
| `residual_spectrum` | the spectra that such errors may have |
| `averaged_spectrum` | averages of spectra by their evidence |
| `neighbor_correlation` | covariance of an estimate whose errors are correlated along frequency |
| `neighbor_spectra` | the correlations that such errors may have |
| `student_average` | Student's t distribution in place of an average of several |
| `uneven_errors` | the same for errors that are larger at some frequencies than at others |
| `shared_errors` | the same for errors that several responses share |
| `disturbed_errors` | whether errors of a manoeuvre are those of a gust, or louder at times |
| `column_space` | what fitted parameters can take from residuals |
"""
