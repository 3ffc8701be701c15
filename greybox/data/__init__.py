"""What was measured: frozen values in numpy, and the files that hold them.

Begin with `record` (named signals on one time base) and `frequency_response` (one input-output pair over frequency,
which `magnitude_phase` makes of decibels and degrees); `transient_spectrum` has the transforms of one manoeuvre;
`test_segment` is one test within a record, and the table of several; `units` converts those of logs to SI;
`intersample` is how a signal runs between its samples, `numerical_range` how large a number may be.

Files: `record_file` (HDF5), `response_file` and `transient_file` (CSV, HDF5) write and read them; `delimited_text`
finds out how a table of numbers was written (separator, decimal mark, comments), `heading` has name and unit of a
column, `response_columns` says which columns of a foreign table are a response, `text_table` formats those that are
printed; `json_numbers` has them as JSON does, `html_text` as notebooks do, `pandas_frames` as data frames; `progress`
shows how far long work is, `optional_package` imports what greybox works without; `safe_files` writes atomically and
says what can be read, `sealed_files` adds a checksum. Libraries that a damaged or crafted file can lead astray run in a
subprocess: `subprocess_reader` starts it, and its script `subprocess_main` is the only place where an HDF5 file is
read.
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
