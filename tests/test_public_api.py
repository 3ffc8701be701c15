"""The public names are a short explicit list, and each says what it is."""

import dataclasses
import inspect
import subprocess
import sys

import greybox as gb

PUBLIC = """
Collocation Comparison Controller EquationError Excitation Fit FrequencyResponse LatinHypercube LinearSystem Listed
MagnitudePhase MaximumLikelihood Model MultipleShooting NestedTest OutputError Parameter Prediction PredictionError
Problem Record Recording RelativeError Rosenbrock RungeKutta Segment Sine SingleShooting Sobol SquaredRelativeError
StateSpace TransferFunction Uniform arccos arcsin arctan arctan2 ardupilot_script check compare cos cost demodulate
equation_error exp feedback find_segments finite_frequency fit frequency_response g harmonic_response
horizontal_velocity levy linearize load log maximum minimum multisine negative nested_test order_path
periodic_response plot plot_bode plot_history plot_nyquist plot_recording plot_starts plot_traces predict prepare
rational read read_response save segment_table several sign simulate sin sine_schedule spectral_response sqrt sweep
systemid_parameters tan tanh virtual_flight where write_excitation write_response
""".split()


def test_the_list_is_complete():
    code = "import greybox, inspect; print(*(n for n in dir(greybox) if not inspect.ismodule(vars(greybox).get(n))))"
    names = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert sorted(name for name in names if not name.startswith("_")) == sorted(PUBLIC)


def test_every_public_name_has_a_docstring():
    for name in PUBLIC:
        thing = getattr(gb, name)
        assert name == "g" or (thing.__doc__ or "").strip(), name


def test_public_values_are_frozen_or_abstract():
    for name in PUBLIC:
        thing = getattr(gb, name)
        if isinstance(thing, type):
            frozen = dataclasses.is_dataclass(thing) and thing.__dataclass_params__.frozen
            assert frozen or inspect.isabstract(thing), name
