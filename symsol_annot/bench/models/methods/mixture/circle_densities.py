"""What a mixture says of one image of a body with a circle in its group, without or with a marking that breaks it."""

import copy
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.mixture.body import Body
from symsol_annot.bench.models.methods.mixture.cells import Grid
from symsol_annot.bench.models.methods.mixture.claims import Calibration, best_threshold
from symsol_annot.bench.models.methods.mixture.image_density import CLAIMED_FROM, SAMPLES, ImageDensity, Indices
from symsol_annot.bench.models.methods.mixture.marking_views import MarkingViews
from symsol_annot.bench.models.networks.mixture_network import Told
from symsol_annot.bench.models.networks.mixtures import AxisMixture, PoseMixture
from symsol_annot.rotations.grid import grid_size

HYPOTHESES = 30
_AXIS_SAMPLES = 192  # by which the threshold of a marking that shows is found
_AXES_OF_SAMPLES = 24  # about which hypotheses are drawn, several about each
_SAME = 6  # decimals to which axes are compared


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
        at_samples = self.mixture.of_image(self.mixture.samples(SAMPLES, self._rng)[0]).numpy()
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
        at_samples = self.axis.of_image(self.axis.samples(SAMPLES, self._rng)[0]).numpy()
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
        log_share = self._log_share_of_turns(self._turned(axes))
        drawn = torch.gather(log_share, 1, self._draw(log_share.exp(), 1))[:, 0]
        return self.axis.of_image(axes) + drawn + float(np.log(len(self._body.group)))

    def _turned(self, axes: Tensor) -> Tensor:
        """Return the rotations (n, G, 3, 3) about axes (n, 3): a turn for each of the group's G."""
        return _frames_of(axes, self._body)[:, None] @ self._body.group

    def _log_share_of_turns(self, turned: Tensor) -> Tensor:
        """Return ln of the shares (n, G), of 1 about an axis, of turns (n, G, 3, 3) where the marking shows."""
        return torch.log_softmax(self.pose.of_image(turned.flatten(0, 1)).reshape(turned.shape[:2]), 1)

    def _draw(self, shares: Tensor, each: int) -> Tensor:
        """Return indices (n, each) of turns, drawn about each axis as often as their shares (n, G) say."""
        return torch.multinomial(shares, each, replacement=True, generator=self._rng)

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
        turned = self._turned(self.axis.samples(_AXES_OF_SAMPLES, self._rng)[0])
        each = -(-count // len(turned))
        shown = self._draw(self._log_share_of_turns(turned).exp(), each)
        hides = torch.sigmoid(self._views.logit(turned.flatten(0, 1))).reshape(turned.shape[:2])
        hidden = self._draw(hides, each)
        is_shown = torch.rand(shown.shape, generator=self._rng) < self.probability_shown
        drawn = turned[torch.arange(len(turned))[:, None], torch.where(is_shown, shown, hidden)]
        return drawn.transpose(0, 1).flatten(0, 1)[:count].double().numpy()


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
