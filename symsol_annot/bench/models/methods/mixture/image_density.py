"""What a mixture says of one image: its density anywhere, what it claims, and a few hypotheses."""

import copy
from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.method import BALANCED, COVERING, SUREST
from symsol_annot.bench.models.methods.mixture.body import Body
from symsol_annot.bench.models.methods.mixture.cells import Grid
from symsol_annot.bench.models.methods.mixture.claims import Calibration, best_threshold
from symsol_annot.bench.models.methods.mixture.marking_views import MarkingViews
from symsol_annot.bench.models.methods.mixture.recipe import CIRCLE, GROUP, MARKED_CIRCLE
from symsol_annot.bench.models.networks.mixture_network import MixtureNetwork, Told
from symsol_annot.bench.models.networks.mixtures import AxisMixture, PoseMixture
from symsol_annot.rotations.grid import grid_size

HYPOTHESES = 30
MANY_HYPOTHESES = 180
LEAST_CELL = 1e-9  # of a cell's probability: less is not told apart, and a file of 5,000 images stays small
_NEGLIGIBLE = 5.0  # what all components' shares are less by, in logarithms, where they may be left out: under 0.7%
_SAMPLES = 1024
_AXIS_SAMPLES = 192  # by which the threshold of a marking that shows is found
_AXES_OF_SAMPLES = 24  # about which hypotheses are drawn, several about each
_LEAST_WEIGHT = 0.01  # of a component that is a hypothesis
_SAME = 6  # decimals to which axes are compared

Indices = npt.NDArray[np.int64]


class ImageDensity(ABC):
    """The density of one image's rotations."""

    @abstractmethod
    def log_density(self, R: Tensor) -> Tensor:
        """Return ln p (n,), relative to uniform, at rotations (n, 3, 3)."""

    @abstractmethod
    def log_claim(self, R: Tensor) -> Tensor:
        """Return ln p - ln t (n,): above 0 for rotations (n, 3, 3) that are claimed."""

    @abstractmethod
    def claimed_on(self, grid: Grid) -> tuple[Indices, Tensor]:
        """Return grid indices, all that are claimed among them, and ln p - ln t there."""

    @abstractmethod
    def on_cells(self, grid: Grid) -> Tensor:
        """Return ln p (N,) averaged over the grid's cells, nearly."""

    @abstractmethod
    def hypotheses(self) -> npt.NDArray[np.float64]:
        """Return hypotheses (m, 3, 3), few of them wrong, that leave little out."""

    def listed(self, which: str) -> npt.NDArray[np.float64]:
        """Return hypotheses (m, 3, 3) of the kind that is asked for."""
        return {BALANCED: self.hypotheses, COVERING: self.covering, SUREST: self.surest}[which]()

    @abstractmethod
    def surest(self) -> npt.NDArray[np.float64]:
        """Return the one rotation (1, 3, 3) that is expected to be nearest to the set."""

    @abstractmethod
    def samples(self, count: int) -> npt.NDArray[np.float64]:
        """Return rotations (count, 3, 3) drawn from the density."""

    def covering(self) -> npt.NDArray[np.float64]:
        """Return 180 hypotheses (180, 3, 3) that leave less out: those of `hypotheses`, and samples."""
        few = self.hypotheses()[:MANY_HYPOTHESES]
        more = MANY_HYPOTHESES - len(few)
        return np.concatenate([few, self.samples(more)]) if more else few


class PoseDensity(ImageDensity):
    """The density of components on SO(3)."""

    def __init__(
        self,
        told: PoseMixture,
        members: float,
        calibration: Calibration,
        rng: torch.Generator,
        *,
        has_volume: bool = False,
    ) -> None:
        self._told, self._members, self._rng = told, members, rng
        self._calibration, self._has_volume = calibration, has_volume

    @cached_property
    def mixture(self) -> PoseMixture:
        """With the calibrated precisions."""
        return self._told.with_precision(self._calibration.precision)

    @cached_property
    def log_t(self) -> float:
        """The logarithm of the threshold."""
        drawn = self.mixture.samples(_SAMPLES, self._rng)
        at_samples = self.mixture.of_image(drawn[0]).numpy()
        log_t, _ = best_threshold(at_samples, self._members, grid_size(4), has_volume=self._has_volume)
        return log_t + float(np.log(self._calibration.threshold))

    def log_density(self, R: Tensor) -> Tensor:
        """Return ln p (n,)."""
        return self.mixture.of_image(R)

    def log_claim(self, R: Tensor) -> Tensor:
        """Return ln p - ln t (n,)."""
        return self.log_density(R) - self.log_t

    def claimed_on(self, grid: Grid) -> tuple[Indices, Tensor]:
        """Return grid indices, and ln p - ln t there."""
        p = grid.density(self.mixture, _negligible(self.mixture, self.log_t - CLAIMED_FROM))
        near = np.flatnonzero(p > np.exp(self.log_t - CLAIMED_FROM))
        return near, torch.from_numpy(np.log(p[near]) - self.log_t).float()

    def on_cells(self, grid: Grid) -> Tensor:
        """Return ln p (N,) averaged over cells, nearly."""
        blurred = self.mixture.blurred(grid.blur_rad)
        p = grid.density(blurred, _negligible(blurred, float(np.log(LEAST_CELL * len(grid)))))
        return torch.from_numpy(np.log(p)).float()

    def hypotheses(self) -> npt.NDArray[np.float64]:
        """Return the centres of the components that weigh more than 0.01, or half of the heaviest, heaviest first."""
        weights = self._told.log_weights[0, :-1].exp()
        order = torch.argsort(weights, descending=True)
        kept = order[weights[order] > min(_LEAST_WEIGHT, float(weights.max()) / 2.0)]
        return self._told.centres[0, kept].double().numpy()

    def surest(self) -> npt.NDArray[np.float64]:
        """Return the centre of a component at which the density is highest."""
        centres = self._told.centres[0]
        return centres[self.log_density(centres).argmax()][None].double().numpy()

    def samples(self, count: int) -> npt.NDArray[np.float64]:
        """Return rotations (count, 3, 3) drawn from the density."""
        return self.mixture.samples(count, self._rng)[0].double().numpy()


def _negligible(mixture: PoseMixture, log_p: float) -> float:
    """Return ln of the share of one component that does not count where p is at least so large."""
    return log_p - float(np.log(max(1, mixture.components))) - _NEGLIGIBLE


CLAIMED_FROM = float(np.log(4.0) + np.log(9.0))  # below, a claim is under the floor of 0.1 of what a file lists


class CircleDensity(ImageDensity):
    """The density of a body's axis: rotations about it are all as likely."""

    def __init__(self, told: AxisMixture, body: Body, calibration: Calibration, rng: torch.Generator) -> None:
        self._told, self._body, self._rng = told, body, rng
        self._calibration = calibration
        self._axis = tuple(body.axis.tolist())

    @cached_property
    def mixture(self) -> AxisMixture:
        """With the calibrated precisions."""
        return self._told.with_precision(self._calibration.axis_precision)

    @cached_property
    def log_t(self) -> float:
        """The logarithm of the threshold."""
        at_samples = self.mixture.of_image(self.mixture.samples(_SAMPLES, self._rng)[0]).numpy()
        log_t, _ = best_threshold(at_samples, len(self._body.group), grid_size(4))
        return log_t + float(np.log(self._calibration.threshold))

    def log_density(self, R: Tensor) -> Tensor:
        """Return ln p (n,)."""
        return self.mixture.of_image(R @ self._body.axis)

    def log_claim(self, R: Tensor) -> Tensor:
        """Return ln p - ln t (n,)."""
        return self.log_density(R) - self.log_t

    def claimed_on(self, grid: Grid) -> tuple[Indices, Tensor]:
        """Return grid indices, and ln p - ln t there."""
        axes, which = grid.axes(self._axis)
        log_claim = self.mixture.of_image(axes) - self.log_t
        near = torch.nonzero((log_claim > -CLAIMED_FROM)[which])[:, 0]
        return near.numpy(), log_claim[which[near]]

    def on_cells(self, grid: Grid) -> Tensor:
        """Return ln p (N,) averaged over cells, nearly."""
        axes, which = grid.axes(self._axis)
        return self.mixture.blurred(grid.blur_rad).log_density(axes)[0][which]

    def hypotheses(self) -> npt.NDArray[np.float64]:
        """Return 30 rotations that are spread evenly over the circles of the likeliest axis."""
        group = self._body.group
        chosen = (np.arange(HYPOTHESES) + 0.5) * len(group) / HYPOTHESES
        return (_frame(self._told, self._body) @ group[chosen.astype(int)]).double().numpy()

    def surest(self) -> npt.NDArray[np.float64]:
        """Return a rotation whose axis is the likeliest."""
        return _frame(self._told, self._body)[None].double().numpy()

    def samples(self, count: int) -> npt.NDArray[np.float64]:
        """Return rotations (count, 3, 3) drawn from the density."""
        frames = _frames_of(self.mixture.samples(count, self._rng)[0], self._body)
        turns = torch.randint(len(self._body.group), (count,), generator=self._rng)
        return (frames @ self._body.group[turns]).double().numpy()


class MarkedCircleDensity(ImageDensity):
    """The density of the poses of a body with a circle in its group, and a marking that breaks it.

    With p_a of the axis, q of the pose, and h(v) that the marking is hidden from the direction v, the last row of R:

        shown     p(R) = p_a(R a) q(R) / mean over g of q(R g)
        hidden    p(R) = p_a(R a) h(R) / mean over g of h(R g)

    The image claims the one that promises the higher F-measure, given how likely it is that the marking shows.
    """

    def __init__(
        self, told: Told, views: MarkingViews, body: Body, calibration: Calibration, rng: torch.Generator
    ) -> None:
        self._told, self._body, self._rng, self._calibration = told, body, rng, calibration
        self._views = views
        self._axis_key = tuple(body.axis.tolist())

    @cached_property
    def axis(self) -> AxisMixture:
        """The axis's density with the calibrated precisions."""
        return self._told.axis.with_precision(self._calibration.axis_precision)

    @cached_property
    def pose(self) -> PoseMixture:
        """The pose's density with the calibrated precisions."""
        return self._told.pose.with_precision(self._calibration.precision)

    @cached_property
    def probability_shown(self) -> float:
        """How likely it is that the marking shows."""
        return float(torch.sigmoid(self._told.is_shown[0] + self._calibration.shown_logit))

    @cached_property
    def hidden_threshold(self) -> tuple[float, float]:
        """The logarithm of t of the axis's density where the marking is hidden, and the F-measure it promises."""
        at_samples = self.axis.of_image(self.axis.samples(_SAMPLES, self._rng)[0]).numpy()
        log_t, f = best_threshold(at_samples, len(self._body.group), grid_size(4))
        return log_t + float(np.log(self._calibration.hidden_threshold)), f

    @cached_property
    def shown_threshold(self) -> tuple[float, float]:
        """The logarithm of t of the density where the marking shows, and the F-measure it promises."""
        at_samples = self._shown_at_samples().numpy()
        log_t, f = best_threshold(at_samples, 1, grid_size(4))
        return log_t + float(np.log(self._calibration.threshold)), f

    @cached_property
    def takes_it_for_shown(self) -> bool:
        """Whether the image claims what fits a marking that shows; may be set to what is known."""
        shown, hidden = self.shown_threshold[1], self.hidden_threshold[1]
        return self.probability_shown * shown > (1.0 - self.probability_shown) * hidden

    def _shown_at_samples(self) -> Tensor:
        """Return ln p of the shown density at samples of it."""
        axes = self.axis.samples(_AXIS_SAMPLES, self._rng)[0]
        _, log_conditional = self._turns_of(axes)
        return self.axis.of_image(axes) + log_conditional[:, 0] + float(np.log(len(self._body.group)))

    def _turns_of(self, axes: Tensor, each: int = 1) -> tuple[Tensor, Tensor]:
        """Draw turns of a marking that shows about axes (n, 3): (n, each) indices of the group, ln of their share."""
        log_q = self.pose.of_image((_frames_of(axes, self._body)[:, None] @ self._body.group).flatten(0, 1))
        log_conditional = torch.log_softmax(log_q.reshape(len(axes), len(self._body.group)), 1)
        turns = torch.multinomial(log_conditional.exp(), each, replacement=True, generator=self._rng)
        return turns, torch.gather(log_conditional, 1, turns)

    def _hidden_turns_of(self, axes: Tensor, each: int) -> Tensor:
        """Draw turns about axes (n, 3) of a marking that is hidden: (n, each) indices of the group."""
        every = (_frames_of(axes, self._body)[:, None] @ self._body.group).flatten(0, 1)
        hides = torch.sigmoid(self._views.logit(every)).reshape(len(axes), len(self._body.group))
        return torch.multinomial(hides, each, replacement=True, generator=self._rng)

    def _log_mean_pose(self, R: Tensor) -> Tensor:
        """Return ln of the mean over g of q(R g) (n,): of the axes R a, of which there are few."""
        rounded = (R @ self._body.axis).numpy().round(_SAME) + 0.0
        _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        every = (R[first][:, None] @ self._body.group).flatten(0, 1)
        log_q = self.pose.of_image(every).reshape(len(first), len(self._body.group))
        return (torch.logsumexp(log_q, 1) - float(np.log(log_q.shape[1])))[which.reshape(-1)]

    def _log_shown(self, R: Tensor) -> Tensor:
        conditional = self.pose.of_image(R) - self._log_mean_pose(R)
        return self.axis.of_image(R @ self._body.axis) + conditional

    def _log_hidden(self, R: Tensor) -> Tensor:
        return self.axis.of_image(R @ self._body.axis) + self._views.log_relative(R)

    def log_density(self, R: Tensor) -> Tensor:
        """Return ln p (n,)."""
        shown = float(np.log(self.probability_shown))
        hidden = float(np.log1p(-min(self.probability_shown, 1.0 - 1e-6)))
        return torch.logaddexp(shown + self._log_shown(R), hidden + self._log_hidden(R))

    def log_claim(self, R: Tensor) -> Tensor:
        """Return ln p - ln t (n,); where the marking is taken to be hidden, or a view's logit that it is, if lower."""
        if self.takes_it_for_shown:
            return self._log_shown(R) - self.shown_threshold[0]
        of_axis = self.axis.of_image(R @ self._body.axis) - self.hidden_threshold[0]
        return torch.minimum(of_axis, self._views.logit(R))

    def claimed_on(self, grid: Grid) -> tuple[Indices, Tensor]:
        """Return grid indices, and ln p - ln t there."""
        axes, which = grid.axes(self._axis_key)
        least = self.hidden_threshold[0]
        if self.takes_it_for_shown:
            least = self.shown_threshold[0] - float(np.log(len(self._body.group)))
        near = torch.nonzero((self.axis.of_image(axes) > least - CLAIMED_FROM)[which])[:, 0]
        return near.numpy(), self.log_claim(grid.rotations[near])

    def on_cells(self, grid: Grid) -> Tensor:
        """Return ln p (N,) averaged over cells, nearly."""
        blurred = copy.copy(self)
        blurred.axis, blurred.pose = self.axis.blurred(grid.blur_rad), self.pose.blurred(grid.blur_rad)
        return blurred._on_grid(grid)  # noqa: SLF001 - of the same class

    def _on_grid(self, grid: Grid) -> Tensor:
        """Return ln p (N,) on the grid; the pose's part only where the axis's density is not uniform."""
        axes, which = grid.axes(self._axis_key)
        of_axis = self.axis.of_image(axes)
        log_p = of_axis[which] + self._views.log_relative_on(grid)
        log_p += float(np.log1p(-min(self.probability_shown, 1.0 - 1e-6)))
        near = torch.nonzero((of_axis > float(self.axis.log_weights[0, -1]) + 0.1)[which])[:, 0]
        log_p[near] = self.log_density(grid.rotations[near])
        return log_p

    def hypotheses(self) -> npt.NDArray[np.float64]:
        """Return the likeliest rotation where the marking shows, else 30 spread evenly over the views that hide it."""
        candidates = _frame(self._told.axis, self._body) @ self._body.group
        if self.probability_shown > 0.5:
            return candidates[self.pose.of_image(candidates).argmax()][None].double().numpy()
        hidden = torch.nonzero(self._views.logit(candidates) > 0)[:, 0]
        kept = candidates[hidden] if len(hidden) >= HYPOTHESES else candidates
        chosen = ((np.arange(HYPOTHESES) + 0.5) * len(kept) / HYPOTHESES).astype(int)
        return kept[chosen].double().numpy()

    def surest(self) -> npt.NDArray[np.float64]:
        """Return the turn about the likeliest axis that is expected to be nearest, whether the marking shows or not."""
        candidates = _frame(self._told.axis, self._body) @ self._body.group
        R = candidates.double().numpy()
        angles = np.arccos(np.clip((np.einsum("aij,bij->ab", R, R) - 1.0) / 2.0, -1.0, 1.0))
        share = torch.softmax(self.pose.of_image(candidates), 0).double().numpy()
        expected = self.probability_shown * angles @ share
        is_hidden = self._views.logit(candidates).numpy() > 0
        if is_hidden.any():
            expected += (1.0 - self.probability_shown) * angles[:, is_hidden].min(axis=1)
        return R[expected.argmin()][None]

    def samples(self, count: int) -> npt.NDArray[np.float64]:
        """Return rotations (count, 3, 3) drawn from the density, several about each of a few axes."""
        axes = self.axis.samples(_AXES_OF_SAMPLES, self._rng)[0]
        each = -(-count // len(axes))
        shown, hidden = self._turns_of(axes, each)[0], self._hidden_turns_of(axes, each)
        is_shown = torch.rand(shown.shape, generator=self._rng) < self.probability_shown
        turned = _frames_of(axes, self._body)[:, None] @ self._body.group[torch.where(is_shown, shown, hidden)]
        return turned.transpose(0, 1).flatten(0, 1)[:count].double().numpy()


def _frame(told: AxisMixture, body: Body) -> Tensor:
    """Return a rotation (3, 3) whose axis R a is the mean of the heaviest component."""
    heaviest = int(told.log_weights[0, :-1].argmax())
    return _frames_of(told.frames[0, heaviest, :, 2][None], body)[0]


def _frames_of(axes: Tensor, body: Body) -> Tensor:
    """Return rotations (n, 3, 3) that take the body's axis to axes (n, 3)."""
    return _with_last_column(axes) @ _with_last_column(body.axis[None]).mT


def _with_last_column(axes: Tensor) -> Tensor:
    """Return rotations (n, 3, 3) whose last column is a unit vector (n, 3)."""
    least = torch.nn.functional.one_hot(axes.abs().argmin(dim=1), 3).to(axes)
    x = torch.nn.functional.normalize(torch.linalg.cross(least, axes), dim=1)
    return torch.stack([x, torch.linalg.cross(axes, x), axes], dim=-1)


class Densities:
    """The densities that a model, as its weights are now, tells of images; worked out on the CPU, one by one.

    Args:
        model: that tells of them.
        structure: the recipe's.
        body: the object's.
        calibration: fitted on validation images.
    """

    def __init__(self, model: MixtureNetwork, structure: str, body: Body, calibration: Calibration) -> None:
        self._model, self._structure, self._body, self._calibration = model, structure, body.cpu(), calibration

    @cached_property
    def _views(self) -> MarkingViews:
        return MarkingViews(self._model, self._body)

    def of_image(self, told: Told, seed: int) -> ImageDensity:
        """Return the density of one image.

        Args:
            told: of this image alone.
            seed: of the samples by which the threshold is found.
        """
        rng = torch.Generator().manual_seed(seed)
        body, calibration = self._body, self._calibration
        if self._structure == MARKED_CIRCLE:
            return MarkedCircleDensity(told, self._views, body, calibration, rng)
        if self._structure == CIRCLE:
            return CircleDensity(told.axis, body, calibration, rng)
        if self._structure == GROUP:
            return PoseDensity(told.pose.spread_over(body.group), len(body.group), calibration, rng)
        members = float(body.set_sizes[int(told.set_size[0].argmax())])
        return PoseDensity(told.pose, members, calibration, rng, has_volume=members > len(body.group))
