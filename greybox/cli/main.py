"""The command line."""

import argparse
import contextlib
import json
import math
import re
import sys
import traceback
from collections.abc import Sequence
from dataclasses import fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

from greybox.cli.catalog import find_model, find_problem, shipped
from greybox.cli.command import BAD_INPUT, FAILED, USABLE, Answer, known
from greybox.cli.data_file import read_data
from greybox.cli.list_command import list_shelf
from greybox.cli.log_commands import add_inspect_options, add_response_options, inspect, response
from greybox.compiled.compiled_problem import AnyProblem
from greybox.data.record import Record
from greybox.data.response_file import HDF5, write_response
from greybox.data.safe_files import replacing
from greybox.estimate.fit import fit
from greybox.estimate.result import Fit, FittedRecord
from greybox.formulation.frequency_criteria import CRITERIA, Criterion
from greybox.formulation.problem import Problem, Sum
from greybox.formulation.time_criteria import TIME_CRITERIA, TimeCriterion

FIGURES = (".png", ".pdf", ".svg")


class UsageError(Exception):
    """A mistake on the command line, in one sentence."""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help.")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status: 0 a usable answer, 1 a run that failed, 2 bad input."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in arguments
    try:
        options = _parser().parse_args(arguments)
    except UsageError as error:
        return _complain(str(error), BAD_INPUT, as_json)
    try:
        # With --json, whatever a user's own file prints must not reach standard output.
        with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
            result, text, status = options.command(options)
    except SystemExit:
        return _complain("a file of your own called sys.exit: remove that call.", BAD_INPUT, as_json)
    except KeyboardInterrupt:
        return _complain("interrupted.", FAILED, as_json)
    except Exception as error:
        if "--debug" in arguments:
            traceback.print_exc()
        return _complain(*_explain(error, arguments), as_json=as_json)
    with contextlib.suppress(BrokenPipeError):  # `greybox list | head`
        print(json.dumps(result, allow_nan=False, ensure_ascii=False) if as_json else text, flush=True)
        return status
    sys.stdout = None  # type: ignore[assignment]
    return status


def _complain(sentence: str, status: int, as_json: bool) -> int:
    print(f"greybox: {sentence}", file=sys.stderr)
    if as_json:
        print(json.dumps({"error": sentence}, ensure_ascii=False))
    return status


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="greybox", description="Grey-box estimation of models from flight data.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"greybox {version('greybox-id')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_list(commands)
    _add_inspect(commands)
    _add_response(commands)
    _add_fit(commands)
    return parser


def _add_list(commands: Any) -> None:
    parser = commands.add_parser("list", help="the shipped models and problems, with their equation and source")
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="show one whole: a problem, or a model such as tilt:Tilt"
    )
    _add_common(parser)
    parser.set_defaults(command=list_shelf)


def _add_inspect(commands: Any) -> None:
    parser = commands.add_parser("inspect", help="what a log holds, which tests it has, what is wrong with it")
    add_inspect_options(parser)
    _add_common(parser, "setpoints, angles and tests")
    parser.set_defaults(command=_inspect)


def _add_response(commands: Any) -> None:
    parser = commands.add_parser("response", help="a log to a measured frequency response", allow_abbrev=False)
    add_response_options(parser)
    parser.add_argument("--out", type=Path, metavar="FILE", help="save the response to this .csv or .h5 file")
    parser.add_argument(
        "--traces", type=Path, metavar="FILE", help="draw control, output and setpoint of the first test"
    )
    _add_common(parser, "Bode and coherence")
    parser.set_defaults(command=_response)


def _add_fit(commands: Any) -> None:
    parser = commands.add_parser("fit", help="fit a problem from many starts", allow_abbrev=False)
    add = parser.add_argument
    add("problem", nargs="?", metavar="PROBLEM", help="a shipped problem, or my.py, or my.py:name")
    add("--model", help="instead of PROBLEM: tilt:Tilt, 'polynomial:Polynomial(4, 1)' or my.py:Class")
    add(
        "--data",
        metavar="FILE",
        help="with --model: a frequency response (columns omega_rad_s, alpha, beta [, coherence, variance, dof]), or a "
        "record (columns time and, in SI units, the model's inputs and outputs); for logs write a problem file",
    )
    add("--input", default="", metavar="NAME", help="of a frequency response: its input, if the model has several")
    add("--output", default="", metavar="NAME", help="of a frequency response: its output, if the model has several")
    add("--at", nargs="+", default=[], metavar="NAME=VALUE", help="with --model: operating point of an ODE")
    add("--fix", nargs="+", default=[], metavar="NAME=VALUE", help="hold parameters at these values")
    add("--free", nargs="+", default=[], metavar="NAME", help="free parameters that the model declares fixed")
    add("--starts", type=_positive, help="number of starts (default: the problem's, or 200, 20 with records)")
    add("--seed", type=_whole, help="seed of the starts (default: the problem's, or 0)")
    add("--delay", help="exact or pade:n (default: the problem's)")
    add("--criterion", help=f"{', '.join(_criteria())} (default: the problem's)")
    add("--out", type=Path, metavar="FILE", help="save the result to this HDF5 file")
    _add_common(parser, "responses, time histories and starts")
    parser.set_defaults(command=_fit)


def _add_common(parser: argparse.ArgumentParser, picture: str = "") -> None:
    """Add what every command has, and `--plot` and `--force` where there is a picture to draw."""
    if picture:
        parser.add_argument("--plot", type=Path, metavar="FILE", help=f"draw {picture} into this png, pdf or svg")
        parser.add_argument("--force", action="store_true", help="overwrite files that exist")
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output and nothing else")
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")


def _positive(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def _whole(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def _inspect(options: argparse.Namespace) -> Answer:
    _require_figure(options.plot, options.force)
    (answer, text, status), draw = inspect(options)
    return answer, "\n".join([text, *_drawn(draw, options.plot)]), status


def _response(options: argparse.Namespace) -> Answer:
    _require_figure(options.plot, options.force)
    _require_writable(options.out, options.force)
    if options.out is not None and options.out.suffix.lower() not in (".csv", *HDF5):
        raise UsageError(f"--out {options.out} is no known kind of file: end it in .csv or .h5.")
    _require_figure(options.traces, options.force)
    (answer, text, status), measured, (draw, traces) = response(options)
    notes = []
    if measured is None:
        print(f"greybox: {answer['error']}", file=sys.stderr)
        return answer, text, status
    if options.out is not None:
        write_response(measured, options.out)
        notes.append(f"saved {options.out}")
    return answer, "\n".join([text, *notes, *_drawn(draw, options.plot), *_drawn(traces, options.traces)]), status


def _require_figure(path: Path | None, force: bool) -> None:
    _require_writable(path, force)
    if path is not None and path.suffix.lower() not in FIGURES:
        raise UsageError(f"{path} is no known kind of figure: end it in {', '.join(FIGURES)}.")


def _drawn(draw: Any, path: Path | None) -> list[str]:
    if path is None:
        return []
    with replacing(path) as temporary:
        draw().savefig(temporary, format=path.suffix[1:].lower(), dpi=150)
    return [f"drew {path}"]


def _fit(options: argparse.Namespace) -> Answer:
    _require_writable(options.out, options.force)
    _require_figure(options.plot, options.force)
    problem, settings = _stated_problem(options)
    for name in ("starts", "seed"):
        if getattr(options, name) is not None:
            settings[name] = getattr(options, name)
    result = fit(problem, **settings)
    # Only what needs them imports HDF5 and matplotlib.
    notes = []
    if options.out is not None:
        from greybox.estimate.storage import save  # noqa: PLC0415

        save(result, options.out)
        notes.append(f"saved {options.out}")

    def draw() -> Any:
        from greybox.plotting import plot  # noqa: PLC0415

        return plot(result)

    notes += _drawn(draw, options.plot)
    answer = _as_json(result)
    if not result.converged:
        answer["error"] = ": ".join([result.status, *result.warnings[:1]]).rstrip(".") + "."
        print(f"greybox: {answer['error']}", file=sys.stderr)
    return answer, "\n".join([str(result), *notes]), USABLE if result.converged else FAILED


def _require_writable(path: Path | None, force: bool) -> None:
    if path is None:
        return
    if path.is_dir() or not path.name:
        raise UsageError(f"{path} is a folder: give the name of a file.")
    if path.exists() and not force:
        raise UsageError(f"{path} exists: give another name, or --force to overwrite it.")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"the folder of {path} does not exist: make it first.")


def _stated_problem(options: argparse.Namespace) -> tuple[AnyProblem, dict[str, Any]]:
    if (options.problem is None) == (options.model is None):
        raise UsageError("give either a PROBLEM or --model with --data; `greybox list` shows the shipped problems.")
    settings: dict[str, Any] = {}
    if options.problem is not None:
        for name in ("data", "input", "output", "at"):
            if getattr(options, name):
                raise UsageError(f"--{name} goes with --model, not with a PROBLEM.")
        _require_problem(options.problem)
        problem, settings = find_problem(options.problem)
    else:
        problem = _problem_of_model(options)
    if options.delay is not None:
        problem = problem.with_(delay=options.delay)
    if options.criterion is not None:
        problem = _with_criterion(problem, _criterion(options.criterion))
    return _restated(problem, _assignments(options.fix, "--fix"), options.free), settings


def _problem_of_model(options: argparse.Namespace) -> Problem:
    if options.data is None:
        raise UsageError("--model needs --data FILE, a frequency response or a record.")
    model = find_model(options.model)
    data = read_data(options.data, model, options.input, options.output)
    for name in ("input", "output", "at"):
        if isinstance(data, Record) and getattr(options, name):
            raise UsageError(f"--{name} is for a frequency response, and {options.data} is a record: leave it out.")
    return Problem(model, data, at=_assignments(options.at, "--at"))


def _require_problem(name: str) -> None:
    """Say what to write where the name is that of data or of a model."""
    if not name.endswith(".py") and Path(name).is_file():
        raise UsageError(
            f"{name} is a file of data, not a problem: give it a model, --model tilt:Tilt --data {name}, or a problem "
            "file, my.py with a function problem()."
        )
    place = name.partition(":")[0]
    if place in shipped("models") and place not in shipped("problems"):
        cure = name if ":" in name else f"{name}:CLASS"
        raise UsageError(f"{name} names a model, not a problem: write --model {cure} --data FILE.")


def _restated(problem: AnyProblem, fix: dict[str, float], free: Sequence[str]) -> AnyProblem:
    """Fix and free parameters by their outside names in every part that has them."""
    for name in (*fix, *free):
        if name not in problem.parameters:
            raise ValueError(f"{problem.name} has no parameter {name!r}; it has {', '.join(problem.parameters)}.")
    if not fix and not free:
        return problem
    parts = [_restated_part(part, fix, free) for part in problem.parts]
    return parts[0] if isinstance(problem, Problem) else Sum(tuple(parts), problem.name)


def _restated_part(part: Problem, fix: dict[str, float], free: Sequence[str]) -> Problem:
    inside = {part.rename.get(name, name): name for name in part.declared if name not in part.tied}
    new = {inside[name]: value for name, value in fix.items() if name in inside}
    freed = [inside[name] for name in free if name in inside]
    held = {name: value for name, value in part.given.items() if name not in freed}
    kept = [name for name in part.free if name not in new]
    return replace(part, fixed={**held, **new}, free=tuple(dict.fromkeys([*kept, *freed])))


def _assignments(words: Sequence[str], flag: str) -> dict[str, float]:
    result = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            result[name] = float(value)
        except ValueError:
            raise UsageError(f"{flag} {word!r} is not understood: write NAME=VALUE, e.g. a5=0.16.") from None
    return result


def _criteria() -> dict[str, Criterion | TimeCriterion]:
    """Return the included criteria by name."""
    return {criterion.name: criterion for criterion in (*CRITERIA, *TIME_CRITERIA)}


def _criterion(text: str) -> Criterion | TimeCriterion:
    known = _criteria()
    if text not in known:
        raise UsageError(f"criterion {text!r} is not known; use {', '.join(known)}.")
    return known[text]


def _with_criterion(problem: AnyProblem, criterion: Criterion | TimeCriterion) -> AnyProblem:
    """Give a criterion to the parts of a problem whose data are of its kind; of records, biases and the like remain."""
    in_time = isinstance(criterion, TimeCriterion)
    if not any(isinstance(part.data, Record) == in_time for part in problem.parts):
        raise UsageError(
            f"--criterion {criterion.name} is for {'records' if in_time else 'frequency responses'} and {problem.name} "
            f"has none: use {', '.join(c.name for c in (CRITERIA if in_time else TIME_CRITERIA))}, or leave it out."
        )
    parts = []
    for part in problem.parts:
        if isinstance(criterion, TimeCriterion) and isinstance(part.criterion, TimeCriterion):
            shared = {field.name: getattr(part.criterion, field.name) for field in fields(TimeCriterion)}
            parts.append(part.with_(criterion=replace(criterion, **shared)))
        else:
            parts.append(part if isinstance(part.data, Record) or in_time else part.with_(criterion=criterion))
    return parts[0] if isinstance(problem, Problem) else Sum(tuple(parts), problem.name)


def _as_json(result: Fit) -> dict[str, Any]:
    return {
        "problem": result.name,
        "criterion": result.criterion,
        "delay": result.delay,
        "starts": len(result.runs),
        "seed": result.seed,
        "converged": sum(run.converged for run in result.runs),
        "agreeing": result.agreeing,
        "minima": len(result.minima),
        "cost": known(result.cost),
        "costs": _all_known(result.costs),
        "status": result.status,
        "estimate": _all_known(result.estimate),
        "standard_error": _all_known(result.standard_error),
        "derived": _all_known(result.derived),
        "outputs": [_output(part, name) for part in result.records for name in part.outputs],
        "at_bound": [q.name for q in result.quantities if q.at_bound],
        "warnings": list(result.warnings),
        "checksum": result.checksum,
        "seconds": result.seconds,
        "versions": dict(result.versions),
    }


def _output(part: FittedRecord, name: str) -> dict[str, Any]:
    """Say how a record's output is fitted; the noise is the standard deviation of its residuals, given or estimated."""
    noise = float(part.noise[part.outputs.index(name), part.outputs.index(name)])
    answer = {"part": part.name, "output": name, "unit": part.data.units.get(name, "")}
    return answer | {"fit_percent": known(part.fit_percent(name)), "noise": known(math.sqrt(noise))}


def _all_known(values: Any) -> dict[str, float | None]:
    return {name: known(value) for name, value in values.items()}


def _explain(error: Exception, arguments: Sequence[str]) -> tuple[str, int]:
    """Turn an exception into one sentence and an exit status; an error in a user's own file names file and line."""
    said = error.args[0] if isinstance(error, KeyError) and error.args else error  # str() of it would add quotes
    sentence = " ".join(str(said).split()) or type(error).__name__
    if isinstance(error, UsageError):
        return sentence, BAD_INPUT
    own = {str(Path(m[1]).resolve()): m[1] for word in arguments if (m := re.match(r"(.+\.py)(?:$|[:(])", word))}
    if isinstance(error, SyntaxError) and error.filename and str(Path(error.filename).resolve()) in own:
        return f"{own[str(Path(error.filename).resolve())]}, line {error.lineno}: {error.msg}.", BAD_INPUT
    causes = [error, *([error.__cause__] if error.__cause__ else [])]
    frames = [
        f for e in causes for f in traceback.extract_tb(e.__traceback__) if str(Path(f.filename).resolve()) in own
    ]
    if frames:
        place = f"{own[str(Path(frames[-1].filename).resolve())]}, line {frames[-1].lineno}"
        return f"{place}: {type(error).__name__}: {sentence}", BAD_INPUT
    if isinstance(error, (ValueError, TypeError, LookupError, OSError)):
        return sentence, BAD_INPUT
    return f"internal error, {type(error).__name__}: {sentence}; run again with --debug and report it.", FAILED
