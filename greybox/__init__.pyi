"""The public names: `greybox/__init__.py` reads them here and imports each at its first use."""

from greybox import data as data
from greybox import experiment as experiment
from greybox import formulation as formulation
from greybox import identification as identification
from greybox import interop as interop
from greybox import logs as logs
from greybox import modeling as modeling
from greybox import plotting as plotting
from greybox import regression as regression
from greybox import simulation as simulation
from greybox import solve as solve
from greybox import spectral as spectral
from greybox import study as study
from greybox import validation as validation
from greybox.compiled.transcription import Collocation as Collocation
from greybox.compiled.transcription import MultipleShooting as MultipleShooting
from greybox.compiled.transcription import SingleShooting as SingleShooting
from greybox.compiled.transcription import Transcription as Transcription
from greybox.data import FrequencyResponse as FrequencyResponse
from greybox.data import Record as Record
from greybox.data import read_response as read_response
from greybox.estimate.draws import Draws as Draws
from greybox.estimate.draws import draws as draws
from greybox.estimate.fit import fit as fit
from greybox.estimate.misfit_test import misfit as misfit
from greybox.estimate.profile import profile as profile
from greybox.estimate.profiles import Profiles as Profiles
from greybox.estimate.result import Fit as Fit
from greybox.estimate.storage import load as load
from greybox.estimate.storage import save as save
from greybox.estimate.structural_identifiability import (
    structural_identifiability as structural_identifiability,
)
from greybox.experiment import Controller as Controller
from greybox.experiment import margins as margins
from greybox.experiment import safe_gains as safe_gains
from greybox.experiment import virtual_flight as virtual_flight
from greybox.formulation import Criterion as Criterion
from greybox.formulation import EquationError as EquationError
from greybox.formulation import MagnitudePhase as MagnitudePhase
from greybox.formulation import MaximumLikelihood as MaximumLikelihood
from greybox.formulation import OutputError as OutputError
from greybox.formulation import PredictionError as PredictionError
from greybox.formulation import Problem as Problem
from greybox.formulation import RelativeError as RelativeError
from greybox.formulation import RelativeLikelihood as RelativeLikelihood
from greybox.formulation import SquaredRelativeError as SquaredRelativeError
from greybox.formulation import Starts as Starts
from greybox.formulation import TimeCriterion as TimeCriterion
from greybox.formulation import several as several
from greybox.html_report import report as report
from greybox.identification import identify as identify
from greybox.logs import prepare as prepare
from greybox.logs import read as read
from greybox.modeling import Integrator as Integrator
from greybox.modeling import Parameter as Parameter
from greybox.modeling import Radau as Radau
from greybox.modeling import RungeKutta as RungeKutta
from greybox.modeling import StateSpace as StateSpace
from greybox.modeling import TransferFunction as TransferFunction
from greybox.modeling import feedback as feedback
from greybox.modeling import frequency_response as frequency_response

# The functions that formulas are written with: each serves numbers, CasADi expressions and rational
# functions of s.
from greybox.modeling.functions import arccos as arccos
from greybox.modeling.functions import arcsin as arcsin
from greybox.modeling.functions import arctan as arctan
from greybox.modeling.functions import arctan2 as arctan2
from greybox.modeling.functions import cos as cos
from greybox.modeling.functions import exp as exp
from greybox.modeling.functions import g as g
from greybox.modeling.functions import log as log
from greybox.modeling.functions import maximum as maximum
from greybox.modeling.functions import minimum as minimum
from greybox.modeling.functions import sign as sign
from greybox.modeling.functions import sin as sin
from greybox.modeling.functions import sqrt as sqrt
from greybox.modeling.functions import tan as tan
from greybox.modeling.functions import tanh as tanh
from greybox.modeling.functions import where as where
from greybox.plotting import plot as plot
from greybox.simulation import predict as predict
from greybox.simulation import simulate as simulate
from greybox.solve.cost import cost as cost
from greybox.study import Bootstrap as Bootstrap
from greybox.study import batch as batch
from greybox.study import bootstrap as bootstrap
from greybox.validation import compare as compare
from greybox.validation import stepwise as stepwise

__version__: str
