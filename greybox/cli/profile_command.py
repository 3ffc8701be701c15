"""The command `greybox profile`: intervals of a saved fit that need not be symmetric, and regions of two parameters."""

import argparse
from typing import Any

from greybox.cli.options import UsageError, add_common_options, nonnegative
from greybox.cli.output import USABLE, Answer, require_figure, save_figure
from greybox.cli.saved_fits import add_fit_argument, stated_fit
from greybox.cli.workers import add_worker_options, stated_executor
from greybox.estimate.profile import contour, profile
from greybox.estimate.profiles import Contour, Profiles
from greybox.files.json_numbers import finite

EXAMPLES = (
    "pitch.h5",
    "pitch.h5 a1 a2 --level 0.9 --plot profiles.png",
    "pitch.h5 --contour a1 a2 --plot contour.png",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_fit_argument(parser)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="parameters and derived quantities; all by default"
    )
    parser.add_argument(
        "--contour",
        nargs=2,
        metavar="NAME",
        help="instead of intervals the region of two parameters together",
    )
    parser.add_argument(
        "--level", type=float, default=0.95, help="of the intervals, 0.95 by default"
    )
    parser.add_argument(
        "--fresh-starts",
        type=nonnegative,
        metavar="N",
        help="of every point, beside its neighbors; 2 by default, 0 of records",
    )
    add_worker_options(parser)
    add_common_options(parser, figure="the profiles")


def run(options: argparse.Namespace) -> Answer:
    """Read the fit and profile it."""
    require_figure(options.plot, options.force)
    fit, problem = stated_fit(options)
    if options.contour:
        if options.names or options.workers or options.scheduler:
            raise UsageError(
                "--contour takes two parameters, in this process: leave out other names and workers."
            )
        found = contour(fit, *options.contour, problem=problem, level=options.level)
        answer = _region(found)
    else:
        settings = {"level": options.level, "fresh_starts": options.fresh_starts}
        with stated_executor(options) as executor:
            found = profile(
                fit, options.names or None, problem=problem, executor=executor, **settings
            )
        answer = found.summary()
    lines = save_figure(options.plot, lambda: _figure(found))
    return answer, "\n".join([str(found), *lines]), USABLE


def _region(found: Contour) -> dict[str, Any]:
    return {
        "names": list(found.names),
        "units": list(found.units),
        "level": found.level,
        "limit": finite(found.limit),
        "estimate": found.estimate.tolist(),
        "points": [[finite(value) for value in point] for point in found.points.tolist()],
        "ends": list(found.ends),
        "text": str(found),
    }


def _figure(found: Profiles | Contour) -> Any:
    from greybox.plotting import profile as drawn  # noqa: PLC0415  (matplotlib takes long to import)

    return (
        drawn.contour(found).figure
        if isinstance(found, Contour)
        else drawn.profiles(found)[0].figure
    )
