"""From an image, a noisy rotation and how noisy it is, to the way in which it is to be turned."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from symsol_annot.bench.models.networks.backbones import RESNET18, Backbone
from symsol_annot.bench.models.networks.first_stage import EMBEDDING_SIZE
from symsol_annot.bench.models.networks.reference_model import ReferenceModel, single_or_double
from symsol_annot.bench.models.networks.rotation_classifier import positional_encoding

_HIDDEN, _BLOCKS = 384, 3
_NOISE_FREQUENCIES = 4  # at which the logarithm of the deviation is encoded
_WAVE_SCALES = (1.5, 24.0)  # from the longest wave's to the shortest's: rad per unit of an entry, a normal's deviation


class ScoreNetwork(ReferenceModel):
    """The first stage, and a small network from an embedding, a rotation and a deviation to sigma times the score.

    Args:
        frequencies: F of the positional encoding of a rotation's entries; 0 for none.
        waves: number of random Fourier features of a rotation (Tancik et al., NeurIPS 2020); 0 for none.
        pretrained: where the backbone begins: "imagenet", the path of a file of its weights, or None, at random.
        rng: draws the weights of what is not pretrained, see `initialise`.
        backbone: of the first stage.
        input_size: the side in pixels that it reduces images to; 0 for images as they are.

    Raises:
        WeightsError: the pretrained weights cannot be had.
    """

    def __init__(
        self,
        frequencies: int,
        waves: int = 0,
        *,
        pretrained: str | Path | None,
        rng: torch.Generator,
        backbone: Backbone = RESNET18,
        input_size: int = 0,
    ) -> None:
        with torch.random.fork_rng(devices=[]):  # torch's layers draw weights that are drawn again below
            super().__init__(backbone, input_size)
            self.of_image = nn.Linear(EMBEDDING_SIZE, _HIDDEN)
            self.of_rotation = nn.Linear(9 + 18 * frequencies + 2 * waves, _HIDDEN)
            self.of_noise = nn.Linear(2 * _NOISE_FREQUENCIES, _HIDDEN)
            self.blocks = nn.ModuleList(_Block() for _ in range(_BLOCKS))
            self.output = nn.Linear(_HIDDEN, 3)
        self.frequencies = frequencies
        scales = torch.from_numpy(np.geomspace(*_WAVE_SCALES, waves)).float()
        drawn = scales[:, None] * torch.randn(waves, 9, generator=rng) if waves else None
        self.waves: Tensor | None
        self.register_buffer("waves", drawn)
        self.begin(pretrained, rng)

    def scores(self, embeddings: Tensor, R: Tensor, sigma: Tensor) -> Tensor:
        """Return sigma times the score (B, J, 3), a rotation vector seen from R.

        Args:
            embeddings: (B, E) of the first stage.
            R: (B, J, 3, 3) noisy rotations.
            sigma: (B, J) their deviations in rad.
        """
        octaves = 0.5 * math.pi * torch.arange(1, _NOISE_FREQUENCIES + 1, device=sigma.device)
        phases = sigma.log()[..., None] / math.log(0.01) * octaves
        noise = self.of_noise(torch.cat([phases.sin(), phases.cos()], dim=-1))
        x = self.of_rotation(self._encoded(R)) + noise
        image = self.of_image(embeddings)[:, None]
        for block in self.blocks:
            x = block(x, image)
        return single_or_double(self.output(functional.silu(x)))

    def _encoded(self, R: Tensor) -> Tensor:
        """Return the entries of rotations (..., 3, 3), and what encodes them (..., E), in float32."""
        entries = R.flatten(-2)
        parts = [entries]
        if self.frequencies:
            parts.append(positional_encoding(entries, self.frequencies))
        if self.waves is not None:
            with torch.autocast(R.device.type, enabled=False):  # bfloat16 is off by up to 0.5 rad at short waves
                phases = entries @ self.waves.T
            parts += [phases.sin(), phases.cos()]
        return torch.cat(parts, dim=-1)


class _Block(nn.Module):
    """Two layers, and what went in carried past them; the image changes every value that the first gives."""

    def __init__(self) -> None:
        super().__init__()
        self.scale, self.shift = nn.Linear(_HIDDEN, _HIDDEN), nn.Linear(_HIDDEN, _HIDDEN)
        self.first, self.second = nn.Linear(_HIDDEN, _HIDDEN), nn.Linear(_HIDDEN, _HIDDEN)

    def forward(self, x: Tensor, image: Tensor) -> Tensor:
        y = self.first(functional.silu(x)) * (1.0 + self.scale(image)) + self.shift(image)
        out: Tensor = x + self.second(functional.silu(y))
        return out
