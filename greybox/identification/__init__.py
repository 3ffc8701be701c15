"""From a log to a measured response and on to a model, with every choice said.

`measurement` makes a response of the tests of a log: which samples, which instrument, open or closed loop; `loop` tells
whether a log was flown in closed loop, and by how much a direct estimate would differ.
"""

from greybox.identification.measurement import Measurement as Measurement
from greybox.identification.measurement import measure as measure
