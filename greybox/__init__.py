"""Grey-box estimation: declare a model structure once, fit it to flight data, know how far to believe the answer."""

from importlib import import_module as _import_module
from pathlib import Path as _Path

from greybox.answer import Fit as Fit
from greybox.compare import compare as compare
from greybox.compare import nested_test as nested_test
from greybox.comparison import Comparison as Comparison
from greybox.comparison import NestedTest as NestedTest
from greybox.controller import Controller as Controller
from greybox.cost import cost as cost
from greybox.criterion import MagnitudePhase as MagnitudePhase
from greybox.criterion import MaximumLikelihood as MaximumLikelihood
from greybox.criterion import RelativeError as RelativeError
from greybox.criterion import SquaredRelativeError as SquaredRelativeError
from greybox.equation_error import EquationError as EquationError
from greybox.equation_error import equation_error as equation_error
from greybox.excitation import Excitation as Excitation
from greybox.excitation import ardupilot_script as ardupilot_script
from greybox.excitation import sine_schedule as sine_schedule
from greybox.excitation import sweep as sweep
from greybox.excitation import systemid_parameters as systemid_parameters
from greybox.excitation import write_excitation as write_excitation
from greybox.fit import fit as fit
from greybox.fourier import demodulate as demodulate
from greybox.fourier import finite_frequency as finite_frequency
from greybox.frequency_response import FrequencyResponse as FrequencyResponse
from greybox.harmonic import harmonic_response as harmonic_response
from greybox.integrator import Rosenbrock as Rosenbrock
from greybox.integrator import RungeKutta as RungeKutta
from greybox.levy import levy as levy
from greybox.levy import order_path as order_path
from greybox.linear import LinearSystem as LinearSystem
from greybox.linear import frequency_response as frequency_response
from greybox.linear import linearize as linearize
from greybox.linear import rational as rational
from greybox.model import Model as Model
from greybox.model import StateSpace as StateSpace
from greybox.model import TransferFunction as TransferFunction
from greybox.model import feedback as feedback
from greybox.multisine import multisine as multisine
from greybox.output_error import OutputError as OutputError
from greybox.output_error import PredictionError as PredictionError
from greybox.parameter import Parameter as Parameter
from greybox.prediction import Prediction as Prediction
from greybox.problem import Problem as Problem
from greybox.quality import check as check
from greybox.readers import read as read
from greybox.record import Record as Record
from greybox.record import Recording as Recording
from greybox.response_file import read_response as read_response
from greybox.response_file import write_response as write_response
from greybox.segment import Segment as Segment
from greybox.segment import segment_table as segment_table
from greybox.segments import find_segments as find_segments
from greybox.several import several as several
from greybox.signals import horizontal_velocity as horizontal_velocity
from greybox.signals import negative as negative
from greybox.signals import prepare as prepare
from greybox.simulate import predict as predict
from greybox.simulate import simulate as simulate
from greybox.sine import Sine as Sine
from greybox.spectra import periodic_response as periodic_response
from greybox.spectra import spectral_response as spectral_response
from greybox.starts import LatinHypercube as LatinHypercube
from greybox.starts import Listed as Listed
from greybox.starts import Sobol as Sobol
from greybox.starts import Uniform as Uniform
from greybox.symbolic import arccos as arccos
from greybox.symbolic import arcsin as arcsin
from greybox.symbolic import arctan as arctan
from greybox.symbolic import arctan2 as arctan2
from greybox.symbolic import cos as cos
from greybox.symbolic import exp as exp
from greybox.symbolic import g as g
from greybox.symbolic import log as log
from greybox.symbolic import maximum as maximum
from greybox.symbolic import minimum as minimum
from greybox.symbolic import sign as sign
from greybox.symbolic import sin as sin
from greybox.symbolic import sqrt as sqrt
from greybox.symbolic import tan as tan
from greybox.symbolic import tanh as tanh
from greybox.symbolic import where as where
from greybox.transcription.collocation import Collocation as Collocation
from greybox.transcription.multiple_shooting import MultipleShooting as MultipleShooting
from greybox.transcription.single_shooting import SingleShooting as SingleShooting
from greybox.virtual_flight import virtual_flight as virtual_flight

__version__ = "0.1.0"

# These need h5py or matplotlib, which take longer to import than everything else together.
_ON_FIRST_USE = {
    "load": "store",
    "save": "store",
    "plot": "plotting",
    "plot_bode": "plotting",
    "plot_history": "histories",
    "plot_nyquist": "plotting",
    "plot_recording": "traces",
    "plot_starts": "plotting",
    "plot_traces": "traces",
}


def __getattr__(name: str) -> object:
    """Import what needs a heavy library when it is first asked for."""
    if name not in _ON_FIRST_USE:
        raise AttributeError(f"module 'greybox' has no attribute {name!r}")
    value = getattr(_import_module(f"greybox.{_ON_FIRST_USE[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, those on first use included."""
    return sorted({*globals(), *_ON_FIRST_USE})


# In a clone, models/ and problems/ stand beside this package; in a wheel they are inside it.
if not (_Path(__file__).parent / "models").is_dir():
    __path__.append(str(_Path(__file__).parents[1]))
