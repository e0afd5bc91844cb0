"""What a mixture says of one image: its density anywhere, what it claims, and a few hypotheses."""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.method import BALANCED, COVERING, SUREST
from symsol_annot.bench.models.methods.mixture.cells import Grid
from symsol_annot.bench.models.methods.mixture.claims import Calibration, best_threshold
from symsol_annot.bench.models.networks.mixtures import PoseMixture
from symsol_annot.rotations.grid import grid_size

MANY_HYPOTHESES = 180
SAMPLES = 1024  # by which a threshold is found
LEAST_CELL = 1e-9  # of a cell's probability: less is not told apart, and a file of 5,000 images stays small
CLAIMED_FROM = float(np.log(4.0) + np.log(9.0))  # below, a claim is under the floor of 0.1 of what a file lists
_NEGLIGIBLE = 5.0  # what all components' shares are less by, in logarithms, where they may be left out: under 0.7%
_LEAST_WEIGHT = 0.01  # of a component that is a hypothesis

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
        drawn = self.mixture.samples(SAMPLES, self._rng)
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
