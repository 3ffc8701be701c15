"""The accuracy of a minimum: standard errors from the sandwich, for all criteria.

Begin with `covariance`.

| file | contents |
| --- | --- |
| `covariance` | the covariance of an estimate, from the information of all parts |
| `accuracy` | the covariance and what it leaves open, as a value |
| `part_accuracy` | the information of one part, with its noise enlarged for its share |
| `active_limits` | which bounds and constraints hold, and which directions they leave |
| `known_directions` | what the data determine, also where they leave directions open |
| `combinations` | combinations of parameters that the data do not determine |
| `prior_shares` | the share of priors in the information |
"""
