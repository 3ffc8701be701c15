"""From a log to a measured response and on to a model, with every choice explained.

Begin with `identify`.

| file | contents |
| --- | --- |
| `identify` | the whole chain, from logs to a fitted model |
| `choices` | tests, axis and signals of a log |
| `orders` | rational transfer functions of rising order |
| `stages` | fits of one structure to records, each with the values of those before it |
| `structure_fit` | the fit of one structure, within bounds that do not decide |
| `selection` | the structures side by side, the chosen one, the verdict |
| `measurement` | tests to a frequency response, in open or closed loop |
| `matrix` | multisines on several inputs to a matrix of responses |
| `loop` | whether a log was flown in closed loop, and the error of a direct estimate |
| `logged_faults` | what a logger did to the signals of a test |
| `systematic_errors` | errors that the scatter does not show |
"""

from greybox.workflows.identification.identify import (
    Identification as Identification,
    identify as identify,
)
from greybox.workflows.identification.matrix import (
    MatrixMeasurement as MatrixMeasurement,
    measure_matrix as measure_matrix,
)
from greybox.workflows.identification.measurement import (
    Measurement as Measurement,
    Settings as Settings,
    measure as measure,
)
from greybox.workflows.identification.orders import select_orders as select_orders
from greybox.workflows.identification.selection import Selection as Selection
