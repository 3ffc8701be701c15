"""From a `Record` to a `FrequencyResponse`, or to the `TransientSpectrum` of a manoeuvre.

Sines, one after another
    Begin with `single_sine`: the finite-frequency estimate of the paper, (3.15)-(3.16).
    `demodulation` gives the complex amplitudes it is made of; `frequency_points` holds what each
    test gave, with warnings and tables; `harmonic_distortion` finds the harmonics that a linear
    plant does not explain; `pooled_noise` has the noise that several tests have in common.
Sweeps, noise and multisines
    Begin with `sweeps_and_noise`, which uses `local_polynomials` in bands of the transform of the
    whole record. `multisine_lines` uses whole periods, and `orthogonal_multisines` has the matrix
    of responses of several inputs at once; `uniform_stretches` cuts records at gaps, and
    `estimated_points` collects the estimates.
Manoeuvres (doublet, 2-1-1, step, manual inputs)
    `transients` has their Fourier integrals, which are data of a `Problem`.
Before the fit
    `experiment_quality` judges whether a test is worth one.
"""

from greybox.data.spectral.experiment_quality import Quality as Quality, check as check
from greybox.data.spectral.frequency_points import FiniteFrequency as FiniteFrequency
from greybox.data.spectral.multisine_lines import periodic_response as periodic_response
from greybox.data.spectral.orthogonal_multisines import response_matrix as response_matrix
from greybox.data.spectral.single_sine import finite_frequency as finite_frequency
from greybox.data.spectral.sweeps_and_noise import spectral_response as spectral_response
from greybox.data.spectral.transients import transient_spectrum as transient_spectrum
