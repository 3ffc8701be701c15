"""What was measured: frozen values in numpy, and the files that hold them.

Begin with `record` (named signals on one time base) and `frequency_response` (one input-output pair
over frequency, which `magnitude_phase` makes of decibels and degrees); `transient_spectrum` has the
transforms of one manoeuvre; `test_segment` is one test within a record, and the table of several;
`units` converts those of logs to SI; `intersample` is how a signal runs between its samples,
`numerical_range` how large a number may be.

Files: `record_file` (HDF5), `response_file` and `transient_file` (CSV, HDF5) write and read them;
`response_columns` says which columns of a foreign table are a response; `pandas_frames` converts to
data frames.
"""

from greybox.data.frequency_response import FrequencyResponse as FrequencyResponse
from greybox.data.frequency_response import Stretch as Stretch
from greybox.data.record import Record as Record
from greybox.data.record import Recording as Recording
from greybox.data.response_file import read_response as read_response
from greybox.data.response_file import write_response as write_response
from greybox.data.response_file import write_responses as write_responses
from greybox.data.test_segment import Segment as Segment
from greybox.data.test_segment import segment_table as segment_table
from greybox.data.transient_file import read_spectrum as read_spectrum
from greybox.data.transient_file import write_spectrum as write_spectrum
from greybox.data.transient_spectrum import TransientSpectrum as TransientSpectrum
