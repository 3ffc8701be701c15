"""Whether feedback responds to errors that are correlated in time: output error is then biased."""

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.records import (
    FALSE_ALARMS,
    by_piece,
    gust_criterion,
    in_time,
    place_of,
)
from greybox.data.files.wording import some
from greybox.statistics.correlation_statistics import cross_correlation, whiteness
from greybox.statistics.metrics import is_resolved


def feedback(evidence: Evidence) -> Findings:
    """Warn where feedback responds to errors correlated in time: output error is then biased.

    Output error needs errors that are independent of past inputs. Feedback makes later inputs
    depend on the errors, which does no harm as long as they are white: then no error depends on an
    earlier one, nor on the inputs that responded to it. So two tests must reject: residuals against
    past outputs (are they white?), and inputs against past residuals (is there feedback?). The
    level of each keeps the share of fits with a false alarm below `FALSE_ALARMS` for any number of
    outputs and inputs, since without a bias one of the two hypotheses is true. The states of an
    unstable model stay within the record only by feedback, which then needs no test: past errors
    reach the inputs through many samples, and the second test misses them. They follow from later
    inputs, too, in which white errors are answered where these are large, or where the model does
    not explain the data: that may be all that is wrong.
    """
    if not evidence.is_noisy:
        return

    pairs, misfit = evidence.records, evidence.fit.misfit
    unstable = bool(misfit and misfit.is_unstable)
    # Noise that feedback returns to an unstable model biases output error: with 10 to 14 % of the
    # variance by 0.6 to 1.5 standard errors, with 1 to 4 % by less than the intervals leave.
    answered = bool(misfit and unstable and (misfit.left > 0.1 or not evidence.is_explained))
    tested, outputs = in_time(pairs, corrected=False)
    responding = []

    for part, fitted in tested:
        inputs = {name: by_piece(fitted, fitted.data[name]) for name in part.system.inputs}
        place = place_of(fitted, pairs)
        for output in fitted.outputs:
            e = fitted.residual(output)
            residuals = by_piece(fitted, e)
            is_white = not whiteness(residuals).p_value < FALSE_ALARMS / outputs
            # Rounding follows the inputs in advance, if these repeat.
            if (is_white and not answered) or not is_resolved(e, fitted.data[output]):
                continue
            responding += [
                f"{name} to {output}{place}"
                for name, u in inputs.items()
                if unstable
                or cross_correlation(u, residuals).p_value < FALSE_ALARMS / outputs / len(inputs)
            ]

    if responding:
        places = some(responding)
        moving = [part for part, _ in tested if not part.is_static]
        yield Finding(
            (
                f"feedback answers the errors of an unstable model, noise or gusts ({places}), "
                "which may also look like a missing term. The estimate of OutputError is then "
                "biased, which its standard errors do not show; "
                if answered
                else f"feedback responds to errors that are correlated in time ({places}), as "
                "where a controller acts on process noise such as gusts. The estimate of "
                "OutputError is then biased, which its standard errors do not show (a false alarm "
                f"in at most {100 * FALSE_ALARMS:g} % of fits); "
            )
            + (
                "use data without feedback."
                if not moving
                # Free gains suffice for white disturbances, and leave slow ones in the errors.
                else "compare with criterion=PredictionError(), and if its errors are not white, "
                f"with {gust_criterion(evidence, moving[0])}."
            )
        )
