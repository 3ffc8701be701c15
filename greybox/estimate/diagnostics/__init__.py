"""The warnings of a fit: each file asks one question, and each answer is a sentence or nothing.

Begin with `general`.

| file | question |
| --- | --- |
| `general` | all warnings of a fit, the most serious first |
| `identifiability` | Which parameters do the data determine, alone or in combination? |
| `global_minimum` | Is this the global minimum, and the only one? |
| `noise_level` | Is the noise as large as stated, and does the criterion use that? |
| `prior_conflict` | Do the data contradict the a-priori knowledge? |
| `frequency_correlation` | Are the errors of neighboring frequencies independent? |
| `outlying_points` | Which points of a response or samples of a record are outliers? |
| `records` | Do the residuals in time look like noise, and were all samples compared? |
| `gusts` | Do the data show process noise, such as gusts? |
| `discretization` | Is the integration accurate enough? |
| `delay_approximation` | Is the Padé delay accurate enough? |
| `harmonics` | Does a sine test have enough harmonics? |
| `not_finite` | Where and why does the model have no finite value? |
| `failure` | What came closest where no run converged? |
| `repeated` | one sentence in place of many alike |
"""
