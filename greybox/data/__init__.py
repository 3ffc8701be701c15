"""Measured data as frozen numpy values, and the files that store them.

Begin with `record` and `frequency_response`.

| file | contents |
| --- | --- |
| `record` | named signals on one time base, and all records of a log |
| `frequency_response` | the frequency response of one input-output pair |
| `transient_spectrum` | Fourier integrals of the signals of one manoeuvre |
| `excited_segment` | one excited segment of a record, and the table of several |
| `clock` | the steps of a record: uniform, in coarse stamps, a schedule; and where rows are lost |
| `intersample` | signals between their samples: held or continuous |
| `signal_faults`, `saturation` | what a logger did to samples; samples at a limit |
| `repetition` | the period of a signal that repeats itself |
| `clock_jump`, `sweep_jump` | where an output becomes later than its input, or changes its sign |
| `wrapped_angles` | angles that jump by a full turn |
| `units` | conversion of units to SI |
| `headings` | the grammar of headers: names, units, indices, holds |
| `time_column` | the grammar of clocks: which columns are the time, and their unit |
| `row_order` | rows of a table in the order of their times |
| `checked_array` | read-only arrays of numbers within the range of arithmetic |
| `frequency_band` | pairs of numbers, such as the ends of a band |
| `checksum` | checksums of arrays, by which equal data are recognized |
| `dates` | dates and times of day as seconds |
| `response_file` | frequency responses in CSV |
| `response_columns` | the columns of a table of a frequency response, also in dB and degrees |
| `pandas_frames` | pandas data frames from and to records and responses |
| `files/` | text tables, safe and sealed files, JSON numbers, progress, optional packages |
| `logs/` | from a log file to a record: readers, common time base, detection of tests |
| `spectral/` | from a record to a frequency response, or to the spectrum of a manoeuvre |
"""

from greybox.data.excited_segment import Segment as Segment, segment_table as segment_table
from greybox.data.frequency_response import (
    FrequencyResponse as FrequencyResponse,
    Stretch as Stretch,
)
from greybox.data.record import Record as Record, Recording as Recording
from greybox.data.response_file import (
    read_response as read_response,
    read_responses as read_responses,
    write_response as write_response,
    write_responses as write_responses,
)
from greybox.data.transient_spectrum import TransientSpectrum as TransientSpectrum
