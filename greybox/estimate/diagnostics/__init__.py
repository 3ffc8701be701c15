"""What a fit warns of: one question a function, each a sentence or none.

Begin with `general`: starts that agree, bounds, parameters that the data do not determine, noise. `records` looks at
residuals in time, `discretization` at the integration, `harmonics` at the number of harmonics of a sine test, and
`not_finite` says where and why a model gives no finite value.
"""
