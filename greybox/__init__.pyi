"""The public names: `greybox/__init__.py` reads them here and imports each at its first use."""

# The namespaces, wherever their folders stand: ``from greybox.spectral import check`` works, too.
from greybox import data as data, modeling as modeling
from greybox.assessment import simulation as simulation, validation as validation
from greybox.assessment.checks.evidence import Evidence as Evidence
from greybox.assessment.checks.finding import Finding as Finding
from greybox.assessment.checks.included import CHECKS as CHECKS
from greybox.assessment.draws import Draws as Draws, draws as draws
from greybox.assessment.fit import fit as fit
from greybox.assessment.misfit.causes.included import CAUSES as CAUSES
from greybox.assessment.misfit.of_fit import misfit as misfit
from greybox.assessment.misfit.term import RecordTerm as RecordTerm, Wording as Wording
from greybox.assessment.profile import profile as profile
from greybox.assessment.profile_result import Profiles as Profiles
from greybox.assessment.result import Fit as Fit
from greybox.assessment.simulation import predict as predict, simulate as simulate
from greybox.assessment.storage import load as load, save as save
from greybox.assessment.structural_identifiability import (
    structural_identifiability as structural_identifiability,
)
from greybox.assessment.validation import compare as compare, stepwise as stepwise
from greybox.data import (
    FrequencyResponse as FrequencyResponse,
    Record as Record,
    logs as logs,
    read_response as read_response,
    spectral as spectral,
)
from greybox.data.logs import prepare as prepare, read as read
from greybox.engine import regression as regression, solve as solve

# The names that most scripts need.
from greybox.engine.compiled.transcription import (
    Collocation as Collocation,
    MultipleShooting as MultipleShooting,
    SingleShooting as SingleShooting,
    Transcription as Transcription,
)
from greybox.engine.solve.cost import cost as cost
from greybox.engine.solve.objective import Objective as Objective, objective as objective
from greybox.engine.solve.own_solver import Solution as Solution, Solver as Solver
from greybox.modeling import (
    Integrator as Integrator,
    Parameter as Parameter,
    Radau as Radau,
    RungeKutta as RungeKutta,
    StateSpace as StateSpace,
    TransferFunction as TransferFunction,
    feedback as feedback,
    formulation as formulation,
    frequency_response as frequency_response,
)
from greybox.modeling.formulation import (
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
from greybox.reporting import interop as interop, plotting as plotting
from greybox.reporting.html_report import report as report
from greybox.reporting.plotting import plot as plot
from greybox.workflows import (
    experiment as experiment,
    identification as identification,
    study as study,
)
from greybox.workflows.experiment import (
    Controller as Controller,
    margins as margins,
    safe_gains as safe_gains,
    virtual_flight as virtual_flight,
)
from greybox.workflows.identification import identify as identify
from greybox.workflows.study import Bootstrap as Bootstrap, batch as batch, bootstrap as bootstrap

__version__: str
