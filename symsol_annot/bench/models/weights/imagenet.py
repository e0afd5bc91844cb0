"""The weights of ResNet-18 that the thesis begins with, trained on ImageNet and published by torchvision."""

import sys
from http.client import HTTPException
from pathlib import Path

import torch

from symsol_annot.errors import WeightsError
from symsol_annot.system.reading import file_sha256

# 69.8% top-1; the name ends in the file's SHA-256.
IMAGENET_URL = "https://download.pytorch.org/models/resnet18-f37072fd.pth"


def imagenet_file() -> Path:
    """Return the path of ResNet-18's ImageNet weights in torch's cache, downloaded where they are not there yet.

    Raises:
        WeightsError: no download, or the file in the cache is another one.
    """
    path = Path(torch.hub.get_dir()) / "checkpoints" / IMAGENET_URL.rpartition("/")[2]
    sha256 = path.stem.rpartition("-")[2]
    try:
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            torch.hub.download_url_to_file(IMAGENET_URL, str(path), sha256, progress=sys.stderr.isatty())
        found = file_sha256(path)
    except (OSError, HTTPException, RuntimeError, ValueError) as error:
        raise WeightsError(
            f"the ImageNet weights of ResNet-18 could not be downloaded from {IMAGENET_URL} to {path}: {error}. "
            "Put that file there yourself, give the path of a copy instead of 'imagenet', or ask for a random start"
        ) from None
    if not found.startswith(sha256):
        raise WeightsError(
            f"{path}: expected the file of {IMAGENET_URL}, whose SHA-256 begins with {sha256}, found {found}; "
            "delete it, and it is downloaded again"
        )
    return path
