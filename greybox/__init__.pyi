"""The public names: `greybox/__init__.py` reads them here and imports each at its first use."""

from greybox import (
    data as data,
    experiment as experiment,
    formulation as formulation,
    identification as identification,
    interop as interop,
    logs as logs,
    modeling as modeling,
    plotting as plotting,
    regression as regression,
    simulation as simulation,
    solve as solve,
    spectral as spectral,
    study as study,
    validation as validation,
)
from greybox.compiled.transcription import (
    Collocation as Collocation,
    MultipleShooting as MultipleShooting,
    SingleShooting as SingleShooting,
    Transcription as Transcription,
)
from greybox.data import (
    FrequencyResponse as FrequencyResponse,
    Record as Record,
    read_response as read_response,
)
from greybox.estimate.checks.evidence import Evidence as Evidence
from greybox.estimate.checks.finding import Finding as Finding
from greybox.estimate.checks.included import CHECKS as CHECKS
from greybox.estimate.draws import Draws as Draws, draws as draws
from greybox.estimate.fit import fit as fit
from greybox.estimate.misfit_test import misfit as misfit
from greybox.estimate.profile import profile as profile
from greybox.estimate.profile_result import Profiles as Profiles
from greybox.estimate.result import Fit as Fit
from greybox.estimate.storage import load as load, save as save
from greybox.estimate.structural_identifiability import (
    structural_identifiability as structural_identifiability,
)
from greybox.experiment import (
    Controller as Controller,
    margins as margins,
    safe_gains as safe_gains,
    virtual_flight as virtual_flight,
)
from greybox.formulation import (
    Criterion as Criterion,
    EquationError as EquationError,
    MagnitudePhase as MagnitudePhase,
    MaximumLikelihood as MaximumLikelihood,
    OutputError as OutputError,
    PredictionError as PredictionError,
    Problem as Problem,
    RelativeError as RelativeError,
    RelativeLikelihood as RelativeLikelihood,
    SquaredRelativeError as SquaredRelativeError,
    Starts as Starts,
    TimeCriterion as TimeCriterion,
    several as several,
)
from greybox.html_report import report as report
from greybox.identification import identify as identify
from greybox.logs import prepare as prepare, read as read
from greybox.modeling import (
    Integrator as Integrator,
    Parameter as Parameter,
    Radau as Radau,
    RungeKutta as RungeKutta,
    StateSpace as StateSpace,
    TransferFunction as TransferFunction,
    feedback as feedback,
    frequency_response as frequency_response,
)

# The functions that formulas are written with: each serves numbers, CasADi expressions and rational
# functions of s.
from greybox.modeling.functions import (
    arccos as arccos,
    arcsin as arcsin,
    arctan as arctan,
    arctan2 as arctan2,
    cos as cos,
    exp as exp,
    g as g,
    log as log,
    maximum as maximum,
    minimum as minimum,
    sign as sign,
    sin as sin,
    sqrt as sqrt,
    tan as tan,
    tanh as tanh,
    where as where,
)
from greybox.plotting import plot as plot
from greybox.simulation import predict as predict, simulate as simulate
from greybox.solve.cost import cost as cost
from greybox.study import Bootstrap as Bootstrap, batch as batch, bootstrap as bootstrap
from greybox.validation import compare as compare, stepwise as stepwise

__version__: str
