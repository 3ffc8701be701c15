"""Known and estimated covariances of errors, against generalized least squares and densities."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from recipes import OneBoard
from scipy.stats import f, multivariate_normal

import greybox as gb
from greybox.modeling.formulation.error_covariance import EstimatedCovariance, KnownDeviations

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Board(gb.StateSpace):
    """Two sensors of one quantity: a + b x and a - b x."""

    inputs, outputs = ("x",), ("y", "z")
    a = gb.Parameter(0.0, bounds=(-10, 10))
    b = gb.Parameter(1.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return p.a + p.b * u.x, p.a - p.b * u.x


TRUTH = np.array([2.0, 0.5])
X = np.linspace(-1, 2, 60)
# Derivatives of both outputs by both parameters at every row.
SLOPES = np.array([[np.ones(60), X], [np.ones(60), -X]])


def rows(seed, covariance=None):
    """Rows of the board, with errors of this covariance."""
    covariance = OneBoard().known(("y", "z")) if covariance is None else covariance
    errors = np.random.default_rng(seed).multivariate_normal([0, 0], covariance, 60).T
    y, z = np.tensordot(SLOPES, TRUTH, (1, 0)) + errors
    return gb.Record(None, {"x": X, "y": y, "z": z})


def fitted(record, noise):
    return gb.fit(
        gb.Problem(Board(), record, gb.OutputError(noise=noise)), starts=[{}], progress=False
    )


def test_a_known_covariance_gives_generalized_least_squares():
    record = rows(1)
    measured = np.array([record["y"], record["z"]])
    inverse = np.linalg.inv(OneBoard().known(("y", "z")))
    normal = np.einsum("kpn,kl,lqn->pq", SLOPES, inverse, SLOPES)
    estimate = np.linalg.solve(normal, np.einsum("kpn,kl,ln->p", SLOPES, inverse, measured))

    problem = gb.Problem(Board(), record, gb.OutputError(noise=OneBoard()))
    fit = gb.fit(problem, starts=[{}], progress=False)
    assert [*fit.estimate.values()] == pytest.approx(estimate, rel=1e-6)
    assert "covariance of the board" in fit.parts[0].rule

    residuals = measured - np.tensordot(SLOPES, estimate, (1, 0))
    density = multivariate_normal(cov=OneBoard().known(("y", "z")))
    assert fit.cost == pytest.approx(-density.logpdf(residuals.T).sum(), rel=1e-9)
    assert gb.cost(problem, fit.estimate) == pytest.approx(fit.cost)

    # The residuals say how large errors are: M = Jᵀ R⁻¹ V R⁻¹ J with their covariance V, of which
    # the two parameters use up a share.
    scatter = residuals @ residuals.T / 60 * 120 / 118
    weighted = np.tensordot(inverse, SLOPES, 1)
    meat = np.einsum("kpn,kl,lqn->pq", weighted, scatter, weighted)
    errors = np.sqrt(np.diag(np.linalg.inv(normal) @ meat @ np.linalg.inv(normal)))
    assert [*fit.standard_error.values()] == pytest.approx(errors, rel=1e-5)


def test_of_few_rows_the_stated_covariance_is_the_error():
    """Two rows with residuals of nearly zero: (Jᵀ R⁻¹ J)⁻¹, whatever the residuals are."""
    few = rows(1).rows(slice(0, 60, 59))
    inverse = np.linalg.inv(OneBoard().known(("y", "z")))
    slopes = SLOPES[:, :, ::59]
    normal = np.einsum("kpn,kl,lqn->pq", slopes, inverse, slopes)
    errors = np.sqrt(np.diag(np.linalg.inv(normal)))
    fit = fitted(few, OneBoard())
    assert np.all(np.array([*fit.standard_error.values()]) > 0.85 * errors)


def test_a_covariance_that_is_known_is_worth_more_than_independent_errors():
    """The difference of the outputs has only their own noise, which independent errors ignore."""
    records = [rows(seed) for seed in range(20)]
    known = [fitted(record, OneBoard()) for record in records]
    independent = [fitted(record, "diagonal") for record in records]
    errors = np.array([fit.estimate["b"] - 0.5 for fit in known])
    assert np.std(errors) < np.std([fit.estimate["b"] for fit in independent]) * 1.01
    assert 0.6 < np.std(errors / [fit.standard_error["b"] for fit in known]) < 1.5


@dataclass(frozen=True)
class Datasheet(gb.formulation.ErrorCovariance):
    """Independent sensors, as deviations by name state them."""

    deviation: float
    description: ClassVar[str] = "deviations of a data sheet"

    def known(self, outputs):
        return self.deviation**2 * np.eye(len(outputs))


def test_a_test_of_nested_models_knows_that_variances_are_given():
    """With stated deviations three times too large, F is still that of least squares."""
    record = rows(5, 0.2**2 * np.eye(2))

    def tested(noise):
        criterion = gb.OutputError(noise=noise)
        fits = [
            gb.fit(gb.Problem(Board(), record, criterion, fixed=held), starts=[{}], progress=False)
            for held in ({"b": 0.52}, {})
        ]
        return gb.validation.nested_test(*fits)

    measured = np.array([record["y"], record["z"]])
    slopes = SLOPES.transpose(1, 0, 2).reshape(2, -1).T
    squares = [
        np.sum((measured.ravel() - slopes @ values) ** 2)
        for values in (
            (np.mean(measured - 0.52 * SLOPES[:, 1]), 0.52),
            np.linalg.lstsq(slopes, measured.ravel(), rcond=None)[0],
        )
    ]
    statistic = (squares[0] - squares[1]) / squares[1] * 118
    own, named = tested(Datasheet(0.6)), tested({"y": 0.6, "z": 0.6})
    assert own.statistic == pytest.approx(named.statistic)
    assert own.statistic == pytest.approx(statistic, rel=0.1)
    assert own.p_value == pytest.approx(f.sf(statistic, 1, 118), rel=0.1)


def test_a_study_on_a_worker_gives_the_same_estimate_and_errors(tmp_path):
    problem = gb.Problem(Board(), rows(1), gb.OutputError(noise=OneBoard()))
    alone = gb.fit(problem, starts=[{}], progress=False)
    with gb.solve.WorkerPool(1) as worker:
        member = gb.study.Member(problem, [{}], name="board")
        study = gb.batch([member], tmp_path, executor=worker, progress=False)
    stored = study["board"].fit
    assert stored.estimate == pytest.approx(alone.estimate)
    assert stored.standard_error == pytest.approx(alone.standard_error)
    assert stored.cost == pytest.approx(alone.cost)


def test_rows_without_one_of_correlated_outputs_do_not_count():
    record = rows(3)
    z = np.where(np.arange(60) % 4 == 0, np.nan, record["z"])
    holed = record.with_signals(z=z)
    complete = record.rows(np.flatnonzero(np.isfinite(z)))
    estimates = [fitted(data, OneBoard()).estimate for data in (holed, complete)]
    assert [*estimates[0].values()] == pytest.approx([*estimates[1].values()])


def test_included_covariances_are_equal_to_their_statements():
    """Equal statements are equal criteria, and are stored as what a user writes."""
    assert gb.OutputError(noise=EstimatedCovariance()) == gb.OutputError(noise="full")
    deviations = {"y": 0.1, "z": 0.2}
    assert gb.OutputError(noise=KnownDeviations(deviations)) == gb.OutputError(noise=deviations)
    assert gb.OutputError(noise=OneBoard()) != gb.OutputError(noise=OneBoard(own=1.0))


@dataclass(frozen=True)
class Wrong(gb.formulation.ErrorCovariance):
    """What is no covariance."""

    matrix: tuple = ()
    description: ClassVar[str] = "wrong"

    def known(self, outputs):
        return self.matrix


@pytest.mark.parametrize("matrix", [((1, 0),), ((1, 2), (2, 1)), ((1, 0.5), (0, 1)), 3.0])
def test_what_is_no_covariance_is_refused(matrix):
    with pytest.raises(ValueError, match="give a symmetric covariance matrix"):
        gb.Problem(Board(), rows(1), gb.OutputError(noise=Wrong(matrix)))


def test_covariances_of_errors_that_are_called_independent_are_refused():
    with pytest.raises(ValueError, match="set is_correlated = True"):
        gb.Problem(Board(), rows(1), gb.OutputError(noise=Wrong(((1, 0.5), (0.5, 1)))))


def test_what_a_fit_does_not_store_is_refused_where_it_is_needed():
    with pytest.raises(ValueError, match="has errors of your own, which it does not store"):
        gb.profile(fitted(rows(1), OneBoard()), "b")
