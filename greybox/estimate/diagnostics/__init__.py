"""What a fit warns of: one question a file, each answer a sentence or none.

Begin with `general`, which asks what concerns every fit, most serious first: `identifiability`
(which parameters do the data determine?), `global_minimum` (is it the global minimum, and the only
one?), `delay_approximation` (is the Padé delay close enough?), `noise_level` (is the noise as large
as assumed?) and `frequency_correlation` (are the errors of neighboring frequencies independent?).
`outlying_points` names the point that lies farthest off and gives the answer without it,
`unused_noise` what the data say about their errors in vain. `records` looks at residuals in time,
`intersample` at what was assumed of the inputs between samples, `discretization` at the
integration, `harmonics` at the number of harmonics of a sine test, and `not_finite` says where and
why a model gives no finite value. `determined_together` says what is determined although its
members are not. `repeated` says once what holds for many records, and `failure` what came closest
where no run converged.
"""
