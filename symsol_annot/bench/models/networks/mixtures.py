"""Mixtures of densities on SO(3) and on axes, of anisotropic components; all log-densities are relative to uniform.

A rotation R = H exp([xi]) near a component's centre H has, in H's own frame, a rotation vector xi that is nearly normal
with the precision K = L L^T. The component on SO(3) is the matrix Fisher distribution (Downs, 1972; Khatri and Mardia,
1977) of the same curvature, exp(tr(A (H^T R - I))), A = tr(K) / 2 I - K, with its normalisation for concentrated ones,
8 pi^2 (2 pi)^-1.5 det L. An axis, a direction up to its sign, has a Bingham distribution: with the tangents x, y of H
at its mean z, exp(-|L^T (x, y)|^2 / 2) times det L, again as for concentrated ones. A direction has the same, twice as
dense on its own hemisphere and pushed off the other. A last component is uniform.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import roma
import torch
from torch import Tensor
from torch.nn import functional

from symsol_annot.bench.models.networks.hypothesis_network import gram_schmidt

_LOG_POSE = math.log(8.0 * math.pi**2) - 1.5 * math.log(2.0 * math.pi)  # uniform on SO(3): 1 / (8 pi^2)
_LOG_AXIS = 0.0  # uniform on axes: 1 / (2 pi), of a normal's 1 / (2 pi)
_LEAST, _MOST = 0.8, 5.5  # of the logarithm of a precision's root: 26 degrees to 0.23 degrees
_AT_ONCE, _NOTHING = 2048, -60.0
_RARE = 4.0  # what the logit of the uniform component begins below the others

POSE_NUMBERS, AXIS_NUMBERS = 13, 10  # that a network gives for a component: two columns of H, L, a logit
Mixture: TypeAlias = "PoseMixture | AxisMixture"


class LogDensity(ABC):
    """What mixtures share: from the logarithms of their components' shares to that of the density."""

    log_weights: Tensor

    @property
    @abstractmethod
    def log_peaks(self) -> Tensor:
        """Ln of each component's share of p at its centre (B, M)."""

    @abstractmethod
    def log_shares(self, at: Tensor) -> Tensor:
        """Return ln of each component's share of p (B, Q, M) at Q places, which may be the same for all images."""

    def log_density(self, at: Tensor) -> Tensor:
        """Return ln p (B, Q) at rotations (B, Q, 3, 3) or axes (B, Q, 3), or without B, the same for all images."""
        return torch.logaddexp(torch.logsumexp(self.log_shares(at), -1), self.log_weights[:, -1:])

    @torch.no_grad()
    def of_image(self, at: Tensor) -> Tensor:
        """Return ln p (Q,) of the only image at many rotations (Q, 3, 3) or axes (Q, 3), sooner than `log_density`.

        A share of less than e^-60 of the highest peak counts as so much: exp takes ten times as long where it
        underflows. What is worked out at once fits the processor's cache.
        """
        if not self.log_peaks.numel():
            return self.log_weights[0, -1].expand(len(at))
        highest = self.log_peaks.max()
        found = []
        for part in torch.split(at, _AT_ONCE):
            shares = (self.log_shares(part)[0] - highest).clamp_(min=_NOTHING).exp_()
            found.append(shares.sum(-1))
        return torch.logaddexp(torch.cat(found).log_() + highest, self.log_weights[0, -1])


@dataclass(frozen=True, eq=False)
class PoseMixture(LogDensity):
    """Densities of rotations, one for each of B images.

    Attributes:
        centres: (B, M, 3, 3) H.
        roots: (B, M, 3, 3) L, lower triangular, per rad.
        log_weights: (B, M + 1), the last of the uniform component.
    """

    centres: Tensor
    roots: Tensor
    log_weights: Tensor

    @classmethod
    def from_output(cls, numbers: Tensor, uniform_logit: Tensor) -> "PoseMixture":
        """Return the mixtures that a network's output means.

        Args:
            numbers: (B, M, 13).
            uniform_logit: (B, 1).
        """
        diagonal = _log_root(numbers[..., 6:9]).exp()
        roots = torch.diag_embed(diagonal)
        below = 2.0 * torch.tanh(numbers[..., 9:12] / 2.0)
        roots[..., 1, 0] = below[..., 0] * diagonal[..., 0]
        roots[..., 2, 0] = below[..., 1] * diagonal[..., 0]
        roots[..., 2, 1] = below[..., 2] * diagonal[..., 1]
        return cls(_frames(numbers), roots, _log_weights(numbers[..., 12], uniform_logit))

    def log_shares(self, at: Tensor) -> Tensor:
        """Return ln of each component's share of p (B, Q, M) at rotations (B, Q, 3, 3), or (Q, 3, 3) for all images."""
        turned, constants = self._linear
        return torch.baddbmm(constants[:, None], _by_image(at, 3).flatten(-2).expand(len(constants), -1, -1), turned.mT)

    def along_third_axis(self, R: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return a, b and c (n, M), by which ln of the only image's shares at R Rz(t) is c + a cos t + b sin t.

        R is (n, 3, 3). With the columns r of R and h of a component's matrix H A, a = <h1, r1> + <h2, r2>,
        b = <h1, r2> - <h2, r1>, and c is <h3, r3> and the constant.
        """
        turned, constants = self._linear
        h1, h2, h3 = turned[0].reshape(-1, 3, 3).unbind(-1)
        r1, r2, r3 = R.unbind(-1)
        return r1 @ h1.mT + r2 @ h2.mT, r2 @ h1.mT - r1 @ h2.mT, r3 @ h3.mT + constants[0]

    @cached_property
    def _linear(self) -> tuple[Tensor, Tensor]:
        """H A (B, M, 9) and constants (B, M): the logarithm of a share at R is <H A, R> + constant."""
        precisions = self.roots @ self.roots.mT
        half = 0.5 * torch.diagonal(precisions, dim1=-2, dim2=-1).sum(-1)  # tr K / 2 = tr A
        A = half[..., None, None] * torch.eye(3, device=half.device) - precisions
        return (self.centres @ A).flatten(2), self.log_peaks - half  # tr(A H^T R) = <H A, R>

    @property
    def log_peaks(self) -> Tensor:
        """Ln of each component's share of p at its centre (B, M)."""
        return _LOG_POSE + _log_determinant(self.roots) + self.log_weights[:, :-1]

    def samples(self, count: int, rng: torch.Generator) -> Tensor:
        """Return rotations (B, count, 3, 3) drawn from the mixtures, the components taken as normal in their frames."""
        chosen, is_uniform = _components(self.log_weights, count, rng)
        roots, centres = _chosen(self.roots, chosen), _chosen(self.centres, chosen)
        normal = torch.randn((*chosen.shape, 3, 1), generator=rng, device=rng.device)
        xi = torch.linalg.solve_triangular(roots.mT, normal, upper=True)[..., 0]
        drawn = centres @ roma.rotvec_to_rotmat(xi)
        anywhere = roma.unitquat_to_rotmat(
            functional.normalize(torch.randn((*chosen.shape, 4), generator=rng, device=rng.device), dim=-1)
        )
        return torch.where(is_uniform[..., None, None], anywhere, drawn)

    def with_precision(self, factor: float) -> "PoseMixture":
        """Return it with all precisions K times a factor."""
        return replace(self, roots=self.roots * math.sqrt(factor))

    def blurred(self, deviation_rad: float) -> "PoseMixture":
        """Return it convolved with a normal distribution of a deviation about each axis, as narrow ones are."""
        covariance = torch.cholesky_inverse(self.roots) + deviation_rad**2 * torch.eye(3, device=self.roots.device)
        return replace(self, roots=torch.linalg.cholesky(torch.linalg.inv(covariance)))

    def spread_over(self, group: Tensor) -> "PoseMixture":
        """Return the mixtures that are the same at R and R g, for g of a group (G, 3, 3): of G M components.

        A component at R g is one of R with the centre H g^-1, in whose frame its precision is g K g^T.
        """
        centres = (self.centres[:, :, None] @ group.mT).flatten(1, 2)
        turned = group @ (self.roots @ self.roots.mT)[:, :, None] @ group.mT
        roots = torch.linalg.cholesky(0.5 * (turned + turned.mT)).flatten(1, 2)
        log_weights = (self.log_weights[:, :-1, None] - math.log(len(group))).expand(-1, -1, len(group)).flatten(1)
        return PoseMixture(centres, roots, torch.cat([log_weights, self.log_weights[:, -1:]], dim=1))

    def cpu(self) -> "PoseMixture":
        """Return them in the processor's memory."""
        return PoseMixture(self.centres.cpu(), self.roots.cpu(), self.log_weights.cpu())

    @property
    def components(self) -> int:
        """How many components it has, but for the uniform one."""
        return self.centres.shape[1]

    def chosen(self, is_kept: Tensor) -> "PoseMixture":
        """Return what is left with some of the components (M,) alone, and the uniform one; their weights stay."""
        with_uniform = torch.cat([is_kept, is_kept.new_ones(1)])
        return PoseMixture(self.centres[:, is_kept], self.roots[:, is_kept], self.log_weights[:, with_uniform])

    def __len__(self) -> int:
        return len(self.log_weights)

    def row(self, i: int) -> "PoseMixture":
        """Return the mixture of one image."""
        return PoseMixture(self.centres[i : i + 1], self.roots[i : i + 1], self.log_weights[i : i + 1])


@dataclass(frozen=True, eq=False)
class AxisMixture(LogDensity):
    """Densities of axes, one for each of B images.

    Attributes:
        frames: (B, M, 3, 3), whose columns are two tangents and the mean axis.
        roots: (B, M, 2, 2) L, lower triangular, per rad.
        log_weights: (B, M + 1), the last of the uniform component.
        is_directed: whether a and -a are two: they are densities of directions.
    """

    frames: Tensor
    roots: Tensor
    log_weights: Tensor
    is_directed: bool = False

    @classmethod
    def from_output(cls, numbers: Tensor, uniform_logit: Tensor, *, is_directed: bool) -> "AxisMixture":
        """Return the mixtures that a network's output means.

        Args:
            numbers: (B, M, 10).
            uniform_logit: (B, 1).
            is_directed: whether a and -a are two.
        """
        diagonal = _log_root(numbers[..., 6:8]).exp()
        roots = torch.diag_embed(diagonal)
        roots[..., 1, 0] = 2.0 * torch.tanh(numbers[..., 8] / 2.0) * diagonal[..., 0]
        return cls(_frames(numbers), roots, _log_weights(numbers[..., 9], uniform_logit), is_directed)

    def log_shares(self, at: Tensor) -> Tensor:
        """Return ln of each component's share of p (B, Q, M) at axes (B, Q, 3), unit vectors, or (Q, 3) for all."""
        axes = _by_image(at, 2).expand(len(self.frames), -1, -1)
        across = torch.einsum("bmij,bmjk->bmik", self.frames[..., :2], self.roots)  # (B, M, 3, 2)
        offsets = torch.einsum("bqi,bmik->bqmk", axes, across)
        of_each = self.log_peaks[:, None] - 0.5 * offsets.square().sum(-1)
        if self.is_directed:
            along = torch.einsum("bqi,bmi->bqm", axes, self.frames[..., 2])
            determinant = torch.diagonal(self.roots, dim1=-2, dim2=-1).prod(-1)
            of_each = of_each + 2.0 * determinant[:, None] * along.clamp(max=0.0)
        return of_each

    @property
    def log_peaks(self) -> Tensor:
        """Ln of each component's share of p at its mean (B, M)."""
        of_direction = math.log(2.0) if self.is_directed else 0.0
        return _LOG_AXIS + of_direction + _log_determinant(self.roots) + self.log_weights[:, :-1]

    def samples(self, count: int, rng: torch.Generator) -> Tensor:
        """Return axes (B, count, 3) drawn from the mixtures, the components taken as normal on their tangent planes."""
        chosen, is_uniform = _components(self.log_weights, count, rng)
        roots, frames = _chosen(self.roots, chosen), _chosen(self.frames, chosen)
        normal = torch.randn((*chosen.shape, 2, 1), generator=rng, device=rng.device)
        xi = torch.linalg.solve_triangular(roots.mT, normal, upper=True)
        drawn = frames[..., 2] + (frames[..., :2] @ xi)[..., 0]
        anywhere = torch.randn((*chosen.shape, 3), generator=rng, device=rng.device)
        return functional.normalize(torch.where(is_uniform[..., None], anywhere, drawn), dim=-1)

    def with_precision(self, factor: float) -> "AxisMixture":
        """Return it with all precisions times a factor."""
        return replace(self, roots=self.roots * math.sqrt(factor))

    def blurred(self, deviation_rad: float) -> "AxisMixture":
        """Return it convolved with a normal distribution of a deviation along each tangent, as narrow ones are."""
        covariance = torch.cholesky_inverse(self.roots) + deviation_rad**2 * torch.eye(2, device=self.roots.device)
        return replace(self, roots=torch.linalg.cholesky(torch.linalg.inv(covariance)))

    def cpu(self) -> "AxisMixture":
        """Return them in the processor's memory."""
        return replace(self, frames=self.frames.cpu(), roots=self.roots.cpu(), log_weights=self.log_weights.cpu())

    def __len__(self) -> int:
        return len(self.log_weights)

    def row(self, i: int) -> "AxisMixture":
        """Return the mixture of one image."""
        rows = slice(i, i + 1)
        return AxisMixture(self.frames[rows], self.roots[rows], self.log_weights[rows], self.is_directed)


def _frames(numbers: Tensor) -> Tensor:
    return gram_schmidt(numbers[..., :6].reshape(*numbers.shape[:2], 2, 3))


def _log_root(numbers: Tensor) -> Tensor:
    """Return logarithms of precisions' roots, within bounds; a network begins near 10 degrees."""
    return torch.clamp(_LEAST + functional.softplus(numbers + 0.6), max=_MOST)


def _log_weights(logits: Tensor, uniform_logit: Tensor) -> Tensor:
    return torch.log_softmax(torch.cat([logits, uniform_logit - _RARE], dim=1), dim=1)


def _log_determinant(roots: Tensor) -> Tensor:
    return torch.diagonal(roots, dim1=-2, dim2=-1).log().sum(-1)


def _by_image(values: Tensor, dimensions: int) -> Tensor:
    """Return values with an axis of images in front, where they are the same for all."""
    return values[None] if values.ndim == dimensions else values


def _components(log_weights: Tensor, count: int, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """Draw components (B, count), and tell which of the draws are of the uniform one."""
    drawn = torch.multinomial(log_weights.exp(), count, replacement=True, generator=rng)
    last = log_weights.shape[1] - 1
    return drawn.clamp(max=last - 1), drawn == last


def _chosen(of_components: Tensor, chosen: Tensor) -> Tensor:
    """Return what is known (B, M, i, j) of chosen components (B, n): (B, n, i, j)."""
    index = chosen[..., None, None].expand(*chosen.shape, *of_components.shape[2:])
    return torch.gather(of_components, 1, index)
