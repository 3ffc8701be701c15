"""The covariance of scores of errors of unequal size, against the scatter of simulated fits."""

import numpy as np
import pytest

from greybox.statistics.uneven_errors import uneven_errors

LINES = 40


WHITE = np.broadcast_to(np.eye(2), (LINES, 2, 2))


def fits(size, of_parameters, covariance=WHITE):
    """Return variances of two parameters (draws, 2), those of the estimates, and the dof.

    Errors of two outputs have a size (lines,), or are `size` (lines, 2, 2) times white ones. The
    parameters act over a share of the lines.
    """
    random = np.random.default_rng(1)
    band = np.arange(LINES) < of_parameters * LINES
    rows = random.normal(size=(2, 2, LINES, 2)) * band[:, None]
    taken = random.normal(size=(2, 2, LINES, 1))
    taken /= np.linalg.norm(taken)
    rows -= taken * np.tensordot(taken[..., 0], rows, 3)
    root = np.linalg.inv(np.linalg.qr(rows.reshape(-1, 2))[1])
    rows = rows @ root
    variances, estimates, dofs = [], [], []
    for _ in range(400):
        errors = random.normal(size=(2, 2, LINES))
        errors = size * errors if np.ndim(size) < 2 else np.einsum("lij,jcl->icl", size, errors)
        scores = np.tensordot(errors, rows, 3)
        estimates.append(root @ scores)
        errors -= taken[..., 0] * np.sum(taken[..., 0] * errors) + rows @ scores
        middle, dof = uneven_errors(errors, rows, root, taken, np.zeros((2, 2)), covariance)
        variances.append(np.diag(root @ middle @ root.T))
        dofs.append(dof)
    return np.array(variances), np.var(estimates, axis=0), dofs


@pytest.mark.parametrize("of_parameters", [1.0, 0.2])
def test_white_errors(of_parameters):
    """The variance has no bias, and scatters as one with these degrees of freedom does."""
    variances, wanted, dofs = fits(1.0, of_parameters)
    assert np.mean(variances, axis=0) == pytest.approx(wanted, rel=0.15)
    assert np.ptp(dofs) < 1e-9
    scatter = 2 * np.mean(variances, axis=0) ** 2 / np.var(variances, axis=0)
    assert dofs[0] == pytest.approx(1 / np.mean(1 / scatter), rel=0.25)
    # Few lines show little about their errors.
    assert (dofs[0] < 30) == (of_parameters < 1)


def test_errors_that_grow_along_the_band():
    """Parameters that act where errors are small have a small variance, and the other way round."""
    growing = np.geomspace(0.3, 3, LINES)
    for size in (growing, growing[::-1]):
        variances, wanted, _ = fits(size, 0.4)
        assert np.mean(variances, axis=0) == pytest.approx(wanted, rel=0.4)


def test_errors_of_a_disturbance():
    """Few lines have most of the errors, so that their variance is less certain than of white ones."""
    shape = np.array([1.0, -0.7]) * 12 * np.exp(-np.arange(LINES) / 4)[:, None]
    covariance = WHITE + shape[:, :, None] * shape[:, None]
    size = np.linalg.cholesky(covariance)
    variances, wanted, dofs = fits(size, 0.5, covariance)
    assert np.mean(variances, axis=0) == pytest.approx(wanted, rel=0.15)
    scatter = 2 * np.mean(variances, axis=0) ** 2 / np.var(variances, axis=0)
    assert dofs[0] == pytest.approx(1 / np.mean(1 / scatter), rel=0.35)
    assert dofs[0] < 0.3 * fits(size, 0.5)[2][0]


def test_certain_scores():
    """Scores that are no sums of these errors add their covariance, which nobody estimated."""
    rows, taken = np.full((1, 2, 2, 1), 1e-3), np.zeros((1, 2, 2, 0))
    covariance, dof = uneven_errors(
        np.ones((1, 2, 2)), rows, np.eye(1), taken, np.eye(1), np.ones((2, 1, 1))
    )
    assert covariance == pytest.approx(1, rel=1e-5)
    assert dof > 1e9


def test_the_order_of_the_outputs_does_not_matter():
    random = np.random.default_rng(2)
    basis = np.linalg.qr(random.normal(size=(3 * 2 * LINES, 3)))[0].reshape(3, 2, LINES, 3)
    errors = random.normal(size=(3, 2, LINES))
    shape = random.normal(size=(LINES, 3)) + 1j * random.normal(size=(LINES, 3))
    covariance = np.eye(3) + 30 * shape[:, :, None] * shape[:, None].conj()

    def judged(order):
        e, b, c = errors[order], basis[order], covariance[:, order][:, :, order]
        return uneven_errors(e, b[..., :2], np.eye(2), b[..., 2:], np.zeros((2, 2)), c)

    (wanted, dof), (scores, other) = judged([0, 1, 2]), judged([1, 2, 0])
    np.testing.assert_allclose(scores, wanted, rtol=1e-9)
    assert other == pytest.approx(dof)
