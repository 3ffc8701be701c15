"""The public names are a short explicit list, and each says what it is."""

import dataclasses
import importlib
import inspect
import json
import subprocess
import sys
from concurrent.futures import Executor

import pytest

import greybox as gb

NAMES = """
Bootstrap CAUSES CHECKS Collocation Controller Criterion Draws EquationError Evidence Finding Fit FrequencyResponse
Integrator MagnitudePhase MaximumLikelihood MultipleShooting Objective OutputError Parameter PredictionError Problem
Profiles Radau Record RecordTerm RelativeError RelativeLikelihood RungeKutta SingleShooting Solution Solver
SquaredRelativeError Starts StateSpace TimeCriterion Transcription TransferFunction Wording batch bootstrap compare
cost draws feedback fit frequency_response identify load margins misfit objective plot predict prepare profile read
read_response report safe_gains save several simulate stepwise
structural_identifiability virtual_flight
""".split()

FORMULAS = """
arccos arcsin arctan arctan2 cos exp g log maximum minimum sign sin sqrt tan tanh where
""".split()

NAMESPACES = {
    "data": "FrequencyResponse Record Recording Segment Stretch TransientSpectrum read_response read_responses "
    "segment_table write_response write_responses",
    "experiment": "ControlCheck Controller Excitation ExpectedErrors GainComparison Margins RejectionBandwidth SafeGains SinePlan ardupilot_script broken_loop check_controller "
    "expected_errors margin_table margins measured_margins multisine plan_sines safe_gains sine_schedule sweep systemid_parameters virtual_flight write_excitation write_gains",
    "formulation": "Criterion Disturbance EquationError ErrorCovariance ErrorDistribution MagnitudePhase MaximumLikelihood OutputError PredictionError Problem "
    "RelativeError RelativeLikelihood SquaredRelativeError Starts Sum TimeCriterion several",
    "identification": "Identification MatrixMeasurement Measurement Selection Settings "
    "identify measure measure_matrix select_orders",
    "interop": "from_control to_casadi to_control",
    "logs": "find_manoeuvres find_segments horizontal_velocity prepare read",
    "modeling": "ImplicitIntegrator Integrator LinearSystem Model Parameter Radau RungeKutta StateSpace "
    "TransferFunction feedback frequency_response linearize rational",
    "plotting": "bode estimates gains loop nyquist pairs plot profiles recording residuals "
    "spectrum starts structures time_history traces trend",
    "regression": "EquationErrorEstimate equation_error levy order_path",
    "simulation": "Prediction predict simulate",
    "solve": "Listed Sobol Starts WorkerPool",
    "spectral": "FiniteFrequency Quality check finite_frequency periodic_response response_matrix "
    "spectral_response transient_spectrum",
    "study": "Bootstrap Member Study StudyMember batch bootstrap grid read_study",
    "validation": "Comparison Differences JointTest NestedTest StepwiseSelection compare differences joint_test nested_test "
    "stepwise",
}
EVERYTHING = [(gb, name) for name in (*NAMES, *FORMULAS)]
EVERYTHING += [
    (getattr(gb, space), name) for space, names in NAMESPACES.items() for name in names.split()
]


@pytest.fixture(scope="module")
def listed():
    """The names that a fresh import of greybox, and then of each of its namespaces, shows, without modules."""
    code = (
        "import importlib, inspect, json, sys\n"
        "def names(module):\n"
        "    m = importlib.import_module(module)\n"
        "    return [n for n in dir(m) if not n.startswith('_') and not inspect.ismodule(vars(m).get(n))]\n"
        "print(json.dumps({module: names(module) for module in sys.argv[1:]}))"
    )
    modules = ["greybox", *(f"greybox.{space}" for space in NAMESPACES)]
    done = subprocess.run(
        [sys.executable, "-c", code, *modules], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def test_the_list_is_complete(listed):
    assert dir(gb) == sorted((*NAMESPACES, *NAMES, *FORMULAS, "__version__"))
    assert sorted(set(listed["greybox"]) - set(NAMESPACES)) == sorted((*NAMES, *FORMULAS))


@pytest.mark.parametrize("space", NAMESPACES)
def test_the_names_of_a_namespace_are_complete(space, listed):
    assert sorted(listed[f"greybox.{space}"]) == sorted(NAMESPACES[space].split())


def test_every_public_name_has_a_docstring():
    for module, name in EVERYTHING:
        assert name == "g" or (getattr(module, name).__doc__ or "").strip(), name


def test_public_values_are_frozen_or_abstract():
    for module, name in EVERYTHING:
        thing = getattr(module, name)
        if isinstance(thing, type):
            frozen = dataclasses.is_dataclass(thing) and thing.__dataclass_params__.frozen
            assert frozen or inspect.isabstract(thing) or issubclass(thing, Executor), name


def test_a_model_comes_before_its_values_and_these_before_what_it_is_evaluated_at():
    functions = {
        name: thing
        for module, name in EVERYTHING
        if inspect.isfunction(thing := getattr(module, name))
    }
    for name, function in functions.items():
        arguments = [*inspect.signature(function).parameters]
        if "model" in arguments and "values" in arguments:
            assert arguments[:2] == ["model", "values"], name


def _made_of_arguments():
    """Return the public functions, and the classes that a user makes of arguments."""
    things = {}
    for module, name in EVERYTHING:
        thing = getattr(module, name)
        if (inspect.isfunction(thing) and name not in FORMULAS) or (
            dataclasses.is_dataclass(thing) and not inspect.isabstract(thing)
        ):
            things[name] = thing
    return things


def test_an_unknown_argument_is_answered_with_the_closest_one():
    for call, wrong, right in (
        (gb.Problem, "fix", "fixed"),
        (gb.fit, "start", "starts"),
        (gb.Record, "unit", "units"),
        (gb.spectral.spectral_response, "bands", "band"),
        (gb.OutputError, "error", "errors"),
    ):
        with pytest.raises(TypeError, match=f"no argument '{wrong}'.* did you mean '{right}'"):
            call(**{wrong: 1})
    for name, call in _made_of_arguments().items():
        kinds = {p.kind for p in inspect.signature(call).parameters.values()}
        if inspect.Parameter.VAR_KEYWORD not in kinds:
            with pytest.raises(TypeError, match=f"{name} has no argument 'qqq'"):
                call(qqq=1)


def test_signatures_are_short():
    for name, call in _made_of_arguments().items():
        text = str(inspect.signature(call))
        assert "greybox." not in text, name
        assert "object at" not in text, name
        assert len(text) < 420, name


def test_documented_names_lead_to_folders_wherever_they_stand():
    import greybox.logs
    from greybox.spectral import check

    assert check is gb.spectral.check
    assert greybox.logs is gb.logs
    assert gb.logs.__spec__.name == gb.logs.__name__ == "greybox.data.logs"
    with pytest.raises(ModuleNotFoundError, match=r"is greybox\.workflows\.experiment\.margins"):
        importlib.import_module("greybox.experiment.margins")
    assert callable(gb.margins)
