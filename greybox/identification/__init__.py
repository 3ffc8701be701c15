"""From a log to a measured response and on to a model, with every choice said.

Begin with `identify`, the whole chain. `choices` finds the tests, the axis and its signals;
`measurement` makes a response of them: which samples, which instrument, open or closed loop;
`manoeuvre` makes a spectrum of a 2-1-1 or the like, `matrix` the responses of multisines on several
inputs; `loop` tells whether a log was flown in closed loop, and by how much a direct estimate would
differ; `systematic_errors` are those that the scatter does not show. `orders` chooses those of a
rational transfer function.
"""

from greybox.identification.identify import Identification as Identification
from greybox.identification.identify import identify as identify
from greybox.identification.manoeuvre import ManoeuvreMeasurement as ManoeuvreMeasurement
from greybox.identification.manoeuvre import measure_manoeuvre as measure_manoeuvre
from greybox.identification.matrix import MatrixMeasurement as MatrixMeasurement
from greybox.identification.matrix import measure_matrix as measure_matrix
from greybox.identification.measurement import Measurement as Measurement
from greybox.identification.measurement import Settings as Settings
from greybox.identification.measurement import measure as measure
from greybox.identification.orders import OrderSelection as OrderSelection
from greybox.identification.orders import select_orders as select_orders
