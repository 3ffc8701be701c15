"""From a `Record` to a `FrequencyResponse`.

`single_sine` is the finite-frequency estimate of the paper, (3.15)-(3.16); `welch` estimates responses from sweeps and
multisines; `test_quality` says before the fit whether a test is worth one.
"""

from greybox.spectral.composite_windows import spectral_response as spectral_response
from greybox.spectral.multisine_lines import periodic_response as periodic_response
from greybox.spectral.single_sine import FiniteFrequency as FiniteFrequency
from greybox.spectral.single_sine import demodulate as demodulate
from greybox.spectral.single_sine import finite_frequency as finite_frequency
from greybox.spectral.test_quality import Quality as Quality
from greybox.spectral.test_quality import check as check
