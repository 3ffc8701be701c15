"""Transcriptions: how the states of a record become unknowns, one method a file.

`method` says what a transcription is; `multiple_shooting` is the default, `single_shooting` and
`collocation` are solved by IPOPT. The integrator that a method's equations amount to is its
`scheme`; `greybox.modeling.integrators` has the base classes of new ones. A trapezoidal method,
written as a user would write it, is in `tests/support/recipes.py`.
"""

from greybox.engine.compiled.transcription.collocation import Collocation as Collocation
from greybox.engine.compiled.transcription.method import Transcription as Transcription
from greybox.engine.compiled.transcription.multiple_shooting import (
    MultipleShooting as MultipleShooting,
)
from greybox.engine.compiled.transcription.single_shooting import SingleShooting as SingleShooting
