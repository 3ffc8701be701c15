"""The warnings of a fit: each file asks one question, and each answer is a sentence or nothing.

Begin with `general`.

| file | question |
| --- | --- |
| `general` | all warnings of a fit, the most serious first |
| `identifiability` | Which parameters do the data determine? Do they contradict what is known? |
| `global_minimum` | Is this the global minimum, and the only one? What came closest to it? |
| `noise_level` | Is the noise as large as stated, and independent? Are there gusts? |
| `outlying_points` | Which points of a response or samples of a record are outliers? |
| `records` | Do the residuals in time look like noise, and were all samples compared? |
| `discretization` | Are the integration and the Padé delay accurate enough? |
| `not_finite` | Where and why does the model have no finite value? |
| `repeated` | one sentence in place of many alike |
"""
