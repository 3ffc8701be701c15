"""The interface of every part of a compiled problem: a frequency response, record or spectrum.

A solver sees the unknowns of all parts as one vector z (p,), scaled. A record has hidden unknowns
besides: the states at the beginning of its segments, its *nodes*. They belong to the part, which
eliminates them from its linearization (condensing), so that a solver only adds up Hessians and
gradients in z, for any kind of data. A frequency response has none, and a spectrum eliminates its
hidden unknowns within its cost. For these, `Part` has the answers: arrays over nodes are empty, no
gap is closed, and residuals need no weights.

Callers: the Gauss-Newton driver (`trajectory` to `close_gaps`), the grouping of minima
(`signature`), the check of the discretization (`refined`), the covariance of the estimate
(`information`), the diagnostics (the properties at the end).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any, ClassVar

import numpy as np

from greybox.data.files.arrays import Array, IntArray, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.information import Information
from greybox.modeling.cached_property import cached_property
from greybox.modeling.formulation.problem import Problem

NO_NODES = np.zeros((0, 0))
# Assumed output error while continuity is a penalty, as a share of the standard deviation of a
# signal.
ASSUMED_ERROR = 0.1
# Added under the root of |e|² while a solver is at work, see `Criterion.cost`: it moves the cost by
# 6e-5 at most. With 1e-14 a solver takes about twice the time.
SMOOTHING = 1e-8


@frozen
class Trajectory:
    """A part at one point z of the solver, with what follows from its nodes.

    Attributes
    ----------
    z : (p,) array
    nodes : (s, n) array
        States at the beginning of every segment.
    ends : (s, n) array
        States at the end of every segment.
    gaps : (s, n) array
        Ends less the next nodes: zero where the trajectory is continuous.
    products : (k, k) array
        Sums over all samples of the products of the residuals of two outputs; of a frequency
        response its cost.
    simulated : bool
        True where the trajectory was simulated from the first node of every stretch: no other node
        counts.
    states : (n, columns) array
        States at all samples.
    detail : object
        What else the part needs to linearize here: of a record, where it is placed.
    """

    z: Array
    nodes: Array
    ends: Array
    gaps: Array
    products: Array
    simulated: bool
    states: Array = field(default_factory=lambda: NO_NODES)
    detail: Any = None

    @property
    def course(self) -> Any:
        """Where the functions of the segments of a record are evaluated, a `Course`."""
        return self.detail.along(self.states)

    @property
    def finite(self) -> bool:
        """True when nothing diverged."""
        return all_finite(self.gaps, self.products)


@frozen
class Condensed:
    """The Gauss-Newton system of a part with its nodes eliminated: a quadratic model in dz alone.

    Attributes
    ----------
    hessian, gradient : (p, p) and (p,) arrays
    node_step, node_sensitivity : (s, n) and (s, n, p) arrays
        The nodes move by node_step + node_sensitivity · dz.
    multiplier, multiplier_sensitivity : (s, n) and (s, n, p) arrays
        Lagrange multipliers of the continuity, likewise.
    damping : (s, n) array
        Levenberg-Marquardt terms of the nodes: half of them times the squares of their steps is
        added to the cost.
    held : (s, n, n) array, or a zero (1,)
        Penalty on weakly observable directions of the initial states.
    decrease : float
        Decrease of the merit that is predicted for the step of the nodes alone.
    """

    hessian: Array
    gradient: Array
    node_step: Array
    node_sensitivity: Array
    multiplier: Array
    multiplier_sensitivity: Array
    damping: Array
    held: Array
    decrease: float

    def change_of_nodes(self, dz: Array) -> Array:
        """Return the change (s, n) of the nodes by a step dz (p,)."""
        return self.node_step + self.node_sensitivity @ dz

    def largest_multiplier(self, dz: Array) -> Array:
        """Return the largest continuity multiplier (n,) of every state after a step dz (p,)."""
        return np.abs(self.multiplier + self.multiplier_sensitivity @ dz).max(axis=0, initial=0.0)

    def damping_penalty(self, dz: Array) -> float:
        """Return the damping term in the cost at a step dz (p,), less its value at dz = 0."""
        moved = self.change_of_nodes(dz)
        return 0.5 * float((self.damping * (moved**2 - self.node_step**2)).sum())


class Elsewhere:
    """Stands for a value of the user's in a process that does not have it."""

    def __getattr__(self, name: str) -> Any:
        """Refuse to be used; `pickle` and `copy` look for special methods."""
        if name.startswith("__"):
            raise AttributeError(name)
        raise RuntimeError(f"{name} is needed of a value that stayed where it was compiled.")


class Portable:
    """A value that leaves the user's classes behind when it is pickled: solvers need none of them.

    `Elsewhere` stands for them then, so that such a value can still be copied with other fields.

    Attributes
    ----------
    local : tuple of str
        Names of the attributes that stay.
    """

    local: ClassVar[tuple[str, ...]] = ("problem",)

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels."""
        return vars(self) | {name: Elsewhere() for name in self.local if name in vars(self)}


class Part(Portable, ABC):
    """One problem of a sum, compiled.

    Solvers need no more than its functions and these facts, and only they travel when a part is
    pickled: `problem`, with the user's classes, stays where it was compiled.

    Attributes
    ----------
    problem : Problem
    name : str
    weight : float
        The factor on the cost of this part.
    is_likelihood : bool
        True when the cost is a negative log-likelihood.
    numbers : int
        Real numbers of the data that are compared.
    samples : int
        Samples that are simulated.
    substeps : int
        Steps of the integrator in a sample; 0 where nothing is integrated.
    has_states : bool
        True when there are hidden unknowns, which IPOPT sees only after transcription.
    has_nodes : bool
        True when segments begin at nodes, whose gaps a homotopy closes.
    is_static : bool
        Whether the outputs depend only on the inputs of the same moment.
    unknown_initial_states : int
        Initial states that are estimated with the parameters.
    gains : tuple of (str, str)
        State and output of every estimated entry of a Kalman gain.
    is_logarithm : bool
        Whether the cost is N/2 times the logarithm of a sum of squares, whose size is not known.
    few : (..., k) array of int
        Numbers of every output that are too few for a variance of their own, else zero.
    has_bounded_errors : bool
        Whether large errors count less than in least squares, see `with_bounded_errors`.
    """

    numbers: int
    samples: int = 0
    substeps: int = 0
    has_states: bool = False
    has_nodes: bool = False
    is_static: bool = False
    unknown_initial_states: int = 0
    gains: tuple[tuple[str, str], ...] = ()
    is_logarithm: bool = False
    few: IntArray = np.zeros(0, dtype=int)
    has_bounded_errors: bool = False

    def __init__(self, problem: Problem) -> None:
        """Store the problem, and the facts that are needed without it."""
        self.problem = problem
        self.name = problem.name
        self.weight = float(problem.weight)
        self.is_likelihood = problem.criterion.is_likelihood

    @property
    def noise_sizes(self) -> tuple[str, ...]:
        """Names, in the answer, of the parameters that are sizes of process noise."""
        return ()

    @property
    def operations(self) -> int:
        """Instructions of one simulation; 0 where nothing is integrated."""
        return 0

    # --- for the Gauss-Newton driver

    @property
    def group(self) -> Any:
        """Equal for parts that can be evaluated together; None for a part by itself."""
        return None

    @property
    def travels_whole(self) -> bool:
        """True when another process, without the user's classes, can compute `information`."""
        return True

    @abstractmethod
    def trajectory(
        self, z: Array, nodes: Array | None = None, *, simulated: bool = False
    ) -> Trajectory:
        """Return the trajectory at z (p,) from nodes (s, n), by default from those of the data.

        If it is `simulated`, the first node of every stretch determines all others.
        """

    @property
    def noise_group(self) -> Any:
        """Equal for parts that share a variance where each has too few numbers for its own."""
        return None

    def with_products(self, trajectory: Trajectory, products: Array) -> tuple[Trajectory, Array]:
        """Return a trajectory whose noise follows from `products` (k, k), and its own products."""
        return replace(trajectory, products=products), trajectory.products

    @abstractmethod
    def cost(self, trajectory: Trajectory, smoothing: float) -> float:
        """Return the cost along a trajectory, unweighted; `smoothing` rounds kinks off."""

    def squared_cost(self, trajectory: Trajectory, weight: Array) -> float:
        """Return the cost with a fixed residual weight (k, k).

        For a record, this is half the sum of the weighted squares.
        """
        return self.cost(trajectory, SMOOTHING)

    def residual_weight(self, trajectory: Trajectory) -> Array:
        """Return W (k, k) with WᵀW the inverse of the residual covariance along a trajectory."""
        return NO_NODES

    def initial_weight(self) -> Array:
        """Return W (k, k) for residuals of `ASSUMED_ERROR` of each signal's spread."""
        return NO_NODES

    @abstractmethod
    def linearize(self, trajectory: Trajectory, weight: Array) -> Any:
        """Linearize along a trajectory, the residuals multiplied by `weight` (k, k).

        Without nodes, return the gradient (p,) and a Hessian (p, p) without negative eigenvalues.
        """

    def continuity_variance(self, linearization: Any) -> Array:
        """Return the variances (n,) of the gaps in the first stage, where nodes follow the data.

        Their standard deviations are the jumps of a state that move a segment's outputs by three
        standard deviations of their signals, linearized with `initial_weight`.
        """
        return np.zeros(0)

    def condense(
        self,
        linearization: Any,
        trajectory: Trajectory,
        continuity_variance: Array | None = None,
        damping: float = 0.0,
        *,
        weight: Array | None = None,
    ) -> Condensed:
        """Eliminate the nodes; continuity is exact where its variances (n,) are zero, or None.

        With the `weight` of the residuals, weakly observable initial states get a penalty.
        """
        # Without nodes the linearization is the condensed system already.
        gradient, hessian = linearization
        nothing = np.zeros((0, 0, len(gradient)))
        return Condensed(
            hessian, gradient, NO_NODES, nothing, NO_NODES, nothing, NO_NODES, NO_NODES, 0.0
        )

    def close_gaps(self, linearization: Any, trajectory: Trajectory, held: Array) -> Array:
        """Return the nodes (s, n) that close the gaps with the least change of the outputs."""
        return NO_NODES

    def explains_data(self, trajectory: Trajectory) -> bool:
        """Return whether the residuals look like noise, with nothing left to explain."""
        return True

    @abstractmethod
    def signature(self, trajectory: Trajectory) -> Array:
        """Return numbers (m,) that distinguish runs: outputs in units of the measured ones.

        They are a record's simulated outputs over the signals' spread, or a response's P/|P̂|.
        """

    def has_stable_steps(self, z: Array, nodes: Array) -> bool:
        """Return whether explicit steps are stable at z (p,) and nodes (s, n)."""
        return True

    def refined(self, factor: int) -> "Part":
        """Return the part with `factor` times the steps per sample."""
        return self

    def excerpt(self, samples: int) -> "Part":
        """Return the part on evenly spaced excerpts with about this total number of samples."""
        return self

    def with_bounded_errors(self, trajectory: Trajectory) -> "Part":
        """Return the part with pseudo-values as data, if its errors are not normal."""
        return self

    # --- for the covariance of the estimate

    def information(
        self,
        names: tuple[str, ...],
        values: Array,
        uncertain: tuple[int, ...],
        trajectory: Trajectory | None,
        dz_dx: Array,
    ) -> Information:
        """Return the information of the data on all values.

        Parameters
        ----------
        names, values : tuple of str, (k,) array
            Free parameters, then constants, in their own units.
        uncertain : tuple of int
            Places of the constants that come from an earlier fit.
        trajectory : Trajectory or None
            The best one at these values; not needed by a part without nodes.
        dz_dx : (p,) array
            Derivatives of the solver's variables by the free parameters.
        """
        raise NotImplementedError

    # --- for the diagnostics

    @cached_property
    def delays(self) -> Mapping[str, tuple[str, str]]:
        """Parameters of the delays of a record, each with its input and an output.

        At whole samples the cost has a kink. It jumps if the input is held and reaches the output
        directly; otherwise the output is empty.
        """
        return {}
