"""One record of a problem, compiled."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, IntArray, positive_or_one
from greybox.data.files.grouping import grouped
from greybox.engine.compiled.information import Information
from greybox.engine.compiled.initial_states import at_samples
from greybox.engine.compiled.part import Trajectory
from greybox.engine.compiled.record_information import record_information
from greybox.engine.compiled.record_model import RecordModel, longest_delay, record_model
from greybox.engine.compiled.residual_covariance import ResidualCovariance, residual_covariance_of
from greybox.engine.compiled.riccati import NoiseModel, noise_model
from greybox.engine.compiled.sampled_data import SampledData, joined, sampled_data
from greybox.engine.compiled.segmented_part import Placed, SegmentedPart
from greybox.engine.compiled.segments import Segments
from greybox.engine.compiled.step_size import drawn_parameters, substeps_and_segment
from greybox.engine.compiled.transcription.method import Transcription
from greybox.modeling.cached_property import cached_property
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.step_size import MOST_SUBSTEPS


class RecordPart(SegmentedPart):
    """One record: a model, the data cut into segments, and the step from sample to sample."""

    def __init__(
        self,
        model: RecordModel,
        data: SampledData,
        substeps: int,
        *,
        covariance: ResidualCovariance | None = None,
        samples_in_mean: int = 1,
    ) -> None:
        """Build the functions, or take those that the model has compiled before.

        A `covariance` is that of a part with other data, since a worker has no criterion. Where the
        outputs are means of some samples, their residuals correct the states as often as those of
        the samples would.
        """
        scheme = model.method.scheme
        step = model.step(scheme, substeps)
        # From free states, stiff models begin with fast transients in every segment. Whole implicit
        # steps damp them; accurate ones took minutes for chains of enzymes.
        self.whole_step = model.step(replace(scheme, substeps=1), 1) if scheme.implicit else step
        super().__init__(
            model,
            data,
            Segments(step, data.segments, data.segment_length, model.active),
            # The spread only scales, and stays that of the original outputs.
            replace(covariance, counts=np.isfinite(data.measured).sum(axis=1))
            if covariance
            else residual_covariance_of(model.criterion, model.outputs, data.measured),
        )
        self.gains = model.gains
        self.samples_in_mean = samples_in_mean
        # Outputs depend only on the inputs of the same sample.
        self.is_static = not self.states and not self.system.delayed
        self.is_logarithm = self.covariance.known is None and not model.driven
        self.has_bounded_errors = model.has_bounded_errors

    # --- parts made of this one

    def with_data(self, data: SampledData) -> "RecordPart":
        """Return the part with other samples."""
        return RecordPart(self.model, data, self.substeps, covariance=self.covariance)

    def of_means(self, data: SampledData, samples: int) -> "RecordPart":
        """Return the part with data whose outputs are means of so many samples."""
        part = RecordPart(
            self.model, data, self.substeps, covariance=self.covariance, samples_in_mean=samples
        )
        part.noise_model = self.noise_model  # its gains are those of the samples
        return part

    def excerpt(self, samples: int) -> "RecordPart":
        """Return the part on evenly spaced excerpts with about this total number of samples."""
        return self.with_data(self.data.excerpts(samples))

    def with_outputs(self, outputs: Sequence[Array]) -> "RecordPart":
        """Return the part with other measured outputs (k, n) of every stretch, NaN for gaps."""
        pairs = zip(self.data.stretches, outputs, strict=True)
        stretches = tuple(replace(stretch, outputs=values) for stretch, values in pairs)
        return self.with_data(replace(self.data, stretches=stretches))

    def with_bounded_errors(self, trajectory: Trajectory) -> "RecordPart":
        """Return the part with pseudo-values as outputs, if its errors are not normal."""
        if not self.has_bounded_errors:
            return self
        model = self.data.unpadded(self.simulated_outputs(trajectory))
        stretches = zip(self.data.stretches, model, strict=True)
        distribution = self.model.criterion.error_distribution
        errors = distribution.pseudo_errors([stretch.outputs - y for stretch, y in stretches])
        return self.with_outputs([y + e for y, e in zip(model, errors, strict=True)])

    @one_thread_at_a_time
    def refined(self, factor: int) -> "RecordPart":
        """Return the part with `factor` times the substeps."""
        part = RecordPart(self.model, self.data, factor * self.substeps, covariance=self.covariance)
        part._placed_data = self._placed_data  # of a long record, it takes a tenth of the memory
        return part

    # --- facts

    @property
    def noise_sizes(self) -> tuple[str, ...]:
        """Names of the intensities of process noise."""
        return tuple(self.problem.outside(f"w_{state}") for state in self.model.driven)

    @property
    def operations(self) -> int:
        """Instructions of one simulation."""
        return self.samples * self.substeps * self.step.substep.n_instructions()

    def has_stable_steps(self, z: Array, nodes: Array) -> bool:
        """Return whether explicit steps are stable at z (p,) and nodes (s, n).

        A number of steps that was chosen is, and so is one that cannot be doubled.
        """
        scheme = self.model.method.scheme
        if scheme.substeps or self.substeps > MOST_SUBSTEPS // 2:
            return True
        p = self.model.locate(z[:, None])[0].ravel()[: len(self.system.parameters)]
        every = len(nodes) // 100 + 1
        inputs = self.at_nodes[1][:, ::every]
        poles = self.model.initial_states.poles(nodes[::every].T, inputs, p)
        # Half of the nodes decide: a switch of friction may be fast for moments.
        fastest = np.median(np.abs(poles).max(axis=1, initial=0.0)) if poles.size else 0.0
        return bool(fastest * self.data.steps.max() <= scheme.reach * self.substeps)

    @property
    def group(self) -> Any:
        """Equal for records that can be evaluated together."""
        if self.gains:  # each must be stable by itself
            return None
        # Records in a group share the step and its derivatives; one weight multiplies them all.
        active = tuple(self.model.active.tolist())
        return id(self.step), self.data.segment_length, active, self.weight, self.model.has_time

    @cached_property
    @one_thread_at_a_time
    def delays(self) -> Mapping[str, tuple[str, str]]:
        """Parameters of the delays, see `Part.delays`."""
        system = self.system
        result = dict[str, tuple[str, str]]()
        x, u, p = system.symbols
        outputs = [*zip(system.outputs, ca.vertsplit(system.output(x, u, p)), strict=True)]
        delay = system.delay(p)
        for i, j in itertools.product(range(u.numel()), range(p.numel())):
            if not ca.depends_on(delay[i], p[j]):
                continue
            # Through states, and with interpolated inputs, the outputs are continuous in the delay.
            is_held = self.model.between[i].held
            reached = [name for name, output in outputs if is_held and ca.depends_on(output, u[i])]
            name = self.model.outside_names[self.model.parameters.index(system.parameters[j])]
            if reached or name not in result:
                result[name] = system.inputs[i], "".join(reached[:1])

        return result

    # --- placement

    def place(self, z: Array) -> Placed:
        """Return the parameters and the data at z (p,)."""
        return self.places(z[None])[0]

    def places(self, z: Array) -> list[Placed]:
        """Return the parameters and the data at each of the points z (r, p)."""
        placed = []
        rows = (values.T for values in self.model.locate(z.T))
        for q, by_z, delay, initial, by_active in zip(*rows, strict=True):
            slope = by_z.reshape(-1, z.shape[1])
            steady = None
            if self.noise_model is not None:
                steady = self.noise_model.at(q)
                # The filter gives the gains and their slopes, which fill the last places of q.
                count = len(self.gains)
                estimated = len(slope) - count
                q[len(q) - count :] = steady.gain.ravel()
                slope[estimated:] = steady.gain_slope.reshape(count, estimated) @ slope[:estimated]
            if self.samples_in_mean > 1:
                q[self._gain_places] *= self.samples_in_mean
                slope[np.isin(self.model.active, self._gain_places)] *= self.samples_in_mean

            data, initial_slope = self.data_at(delay), by_active.reshape(self.states, len(slope))
            placed.append(Placed(q, slope, data, initial, initial_slope, steady))
        return placed

    @cached_property
    def _gain_places(self) -> IntArray:
        """Return the places of the gains among the declared parameters."""
        names = [f"K_{state}_{output}" for state, output in self.gains]
        return np.flatnonzero(np.isin(self.model.parameters, names))

    @cached_property
    def noise_model(self) -> NoiseModel | None:
        """Return the linear model from which the gains follow, about the means of the record.

        None without process noise.
        """
        model, data = self.model, self.data
        if not model.driven:
            return None
        complete = sum(np.isfinite(s.outputs).all(axis=0).sum() for s in data.stretches)
        # Gaps of a tenth of the samples leave a filter steady nearly everywhere.
        if complete < 0.9 * sum(len(s) - s.masked for s in data.stretches):
            raise ValueError(
                f"{self.name!r} has {', '.join(self.outputs)} together at too few samples for "
                "process_noise, whose filter is steady: resample the outputs to one rate, or leave "
                "process_noise out."
            )

        # A steady filter belongs to one linear model: the one about the mean state.
        outputs, inputs = self.at_nodes
        unknown = np.full(self.states, np.nan)
        nodes = model.initial_states.at(outputs, inputs, model.begin, unknown)
        rows = data.rows(np.zeros(len(self.system.inputs)))
        reference = nodes.mean(axis=1), rows.mean(axis=1)
        step = max(data.stretches, key=len).step

        return noise_model(model, self.step, step, reference)

    @cached_property
    def at_nodes(self) -> tuple[Array, Array]:
        """Measured outputs and inputs at the nodes."""
        return at_samples(self.data, self.data.segment_length)

    def initial_nodes(self, q: Array, known: Array) -> Array:
        """Return nodes (s, n) from the data."""
        p = q[: len(self.system.parameters)]
        outputs, inputs = self.at_nodes
        return self.model.initial_states.at(outputs, inputs, p, known).T

    # --- for the covariance of the estimate

    def information(
        self,
        names: tuple[str, ...],
        values: Array,
        uncertain: tuple[int, ...],
        trajectory: Trajectory | None,
        dz_dx: Array,
    ) -> Information:
        """Return the information on the values (k,), the initial states fitted too."""
        assert trajectory is not None
        places = tuple(range(trajectory.z.size))
        part = self
        if uncertain:
            # Constants with a covariance are treated as unknowns, all of them without scaling.
            places = (*places, *uncertain)
            point = ca.SX.sym("x", len(places))
            named: dict[str, Any] = dict(zip(names, values.tolist(), strict=True))
            named |= {names[place]: point[i] for i, place in enumerate(places)}
            model = record_model(self.problem, named, point, self.model.method, [])
            part = RecordPart(model, self.data, self.substeps)
            trajectory = part.trajectory(
                values[list(places)], trajectory.nodes, simulated=trajectory.simulated
            )
            dz_dx = np.ones(len(places))

        by_values = np.zeros((len(places), len(values)))
        by_values[range(len(places)), places] = dz_dx
        return record_information(part, trajectory, by_values)


def compile_records(
    problems: Sequence[Problem], expressions: Mapping[str, Any], z: ca.SX, method: Transcription
) -> list[RecordPart]:
    """Compile records for the point z.

    `expressions` are the parameters of a problem by outside name.

    Records of one model have one compiled sample, and one choice of substeps and segments where
    they are sampled alike. If one of them is stiff, all have implicit steps.
    """
    models = list[RecordModel]()
    shared = list[Any]()
    for problem in problems:
        model = record_model(problem, expressions, z, method, shared)
        models.append(model)
    data = [
        sampled_data(
            model.record,
            model.system.inputs,
            model.outputs,
            lead=longest_delay(model.problem, model.system),
            complete=model.criterion.error_covariance.is_correlated or bool(model.driven),
            held=[between.held for between in model.between],
            static=model.problem.model.is_static,
            states=len((model.system.undelayed or model.system).states),
            known_states=int(model.known_states.sum()),
        )
        for model in models
    ]
    for model, sampled in zip(models, data, strict=True):
        if model.criterion.corrects_states and not sampled.is_uniform:
            raise ValueError(
                f"{model.name!r} corrects its states by a constant gain, and its record is not "
                "uniformly sampled: prepare the record with rate=..., which resamples it."
            )

    longest = [float(sampled.steps.max()) for sampled in data]
    drawn = [drawn_parameters(problem) for problem in problems]

    def kind(k: int) -> tuple[Any, ...]:
        # Steps of a log are known to a thousandth, see `sampled_data`.
        return id(models[k].steps), f"{longest[k]:.3g}", drawn[k].tobytes()

    covariances = _assumed_covariances(models, data)
    parts: dict[int, RecordPart] = {}
    for lot in grouped(range(len(models)), kind):
        first = lot[0]
        every = joined([data[k] for k in lot])
        substeps, segment_length = substeps_and_segment(
            models[first], drawn[first], every, longest[first]
        )
        is_stiff = method.scheme.substeps is None and substeps > MOST_SUBSTEPS
        if is_stiff and method.for_stiff_models() != method:
            return compile_records(problems, expressions, z, method.for_stiff_models())
        for k in lot:
            cut = replace(data[k], segment_length=segment_length)
            steps = MOST_SUBSTEPS if is_stiff else substeps
            parts[k] = RecordPart(models[k], cut, steps, covariance=covariances[k])

    return [parts[k] for k in range(len(models))]


def _assumed_covariances(
    models: Sequence[RecordModel], data: Sequence[SampledData]
) -> list[ResidualCovariance]:
    """Return the residual covariances of records; those of one model share their spread.

    With a spread of its own, a record whose outputs are small would decide where searches begin:
    one of three flights, with a payload, drew every start away from the minimum of the other two.
    """
    pairs = zip(models, data, strict=True)
    own = [residual_covariance_of(m.criterion, m.outputs, sampled.measured) for m, sampled in pairs]
    result = [*own]
    for lot in grouped(range(len(own)), lambda k: id(models[k].steps)):
        counts = np.array([own[k].counts for k in lot])
        squares = np.sum([own[k].counts * own[k].spread ** 2 for k in lot], axis=0)
        spread = positive_or_one(np.sqrt(squares / np.maximum(counts.sum(axis=0), 1)))
        for k in lot if len(lot) > 1 else ():
            result[k] = replace(own[k], spread=spread)
    return result


class RecordProgram:
    """A record transcribed for IPOPT: continuity and known initial states are equations.

    Its parameters w are relaxed quantities, which follow from the last solution: the square root
    of the inverse residual covariance (k, k), then the data (width, samples), both column by
    column.

    Attributes
    ----------
    part : SegmentedPart
    unknowns, parameters : casadi.MX
        The hidden unknowns, and w.
    error : casadi.MX
        Residuals; half the sum of their squares is the cost.
    equations : casadi.MX
        What must be zero.
    products : casadi.Function
        (z, unknowns, w) -> the products (k, k) of the residuals.
    """

    def __init__(self, part: SegmentedPart, z: ca.MX) -> None:
        """Transcribe the record at the solver's point z (p,)."""
        self.part = part
        if part.model.driven:
            raise ValueError(
                f"{part.name!r} has process_noise, whose gains the program of IPOPT does "
                "not follow: use method=MultipleShooting() and search='batched', the defaults."
            )

        q = part.model.locate.function(z)[0]
        weight = ca.MX.sym("W", len(part.outputs), len(part.outputs))
        data = ca.MX.sym("data", part.step.width, part.data.samples)
        self._transcribed = part.model.method.transcribe(part.step, part.data, q, data)
        residuals = self._transcribed.residuals
        self.unknowns = self._transcribed.unknowns
        self.parameters = ca.vertcat(ca.vec(weight), ca.vec(data))
        self.error = ca.vec(weight @ residuals)
        self.equations = ca.vertcat(self._transcribed.equations, self._known_states(q))
        # Without weights: the covariance that follows must not depend on those in use.
        self.products = ca.Function(
            "products", [z, self.unknowns, self.parameters], [residuals @ residuals.T]
        )

    def _known_states(self, q: ca.MX) -> ca.MX:
        """Return the equations of known states where stretches begin, zero if they hold."""
        part = self.part
        begins = part.data.begins_stretch
        places = np.flatnonzero(part.known_states[begins]).tolist()
        if not places:
            return ca.MX(0, 1)  # CasADi reads an empty column as an empty row
        values = ca.repmat(part.model.initial(q), int(begins.sum()), 1)
        values += part.delays_at_rest[begins].ravel()
        return ca.vec(self._transcribed.initial)[places] - values[places]

    def initial_unknowns(self, trajectory: Trajectory) -> Array:
        """Return the unknowns for the states along a trajectory."""
        return self._transcribed.start(self.part.segments.in_order(trajectory.states))

    def initial_parameters(self, z: Array) -> Array:
        """Return the parameters w of the program at z (p,): the first weights, and the data."""
        return self._joined(self.part.initial_weight(), self.part.place(z).data)

    def outcome(self, z: Array, products: Array, w: Array) -> tuple[float, Array, bool]:
        """Return the cost, the weights and data that follow, and whether the data stayed."""
        covariance = self.part.covariance
        following = self._joined(covariance.weight(products), self.part.place(z).data)
        # The weights come first; what follows them changes only where a delay passes a sample.
        size = len(self.part.outputs) ** 2
        return covariance.cost(products), following, np.array_equal(following[size:], w[size:])

    def _joined(self, weight: Array, data: Array) -> Array:
        return np.concatenate(
            [weight.ravel(order="F"), self.part.segments.in_order(data).ravel(order="F")]
        )
