"""Recipes of four epochs and a backbone of small files: what trainings obey whatever they train."""

from torch import nn

from symsol_annot.bench.models.kinds import Recipe
from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.methods.diffusion.recipe import DiffusionRecipe
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.methods.implicit_pdf.recipe import ImplicitPdfRecipe
from symsol_annot.bench.models.methods.mixture.recipe import MixtureRecipe
from symsol_annot.bench.models.networks import resnet
from symsol_annot.bench.models.networks.backbones import BACKBONES, Backbone
from symsol_annot.bench.models.training.loop import Options

_NARROWER = 8
_FEATURES = resnet.FEATURES // _NARROWER


class _NarrowResNet(resnet.ResNet18):
    """ResNet-18 with an eighth of the channels, so with files of a fiftieth."""

    def __init__(self):
        nn.Module.__init__(self)
        a, b, c, d = (channels // _NARROWER for channels in (64, 128, 256, resnet.FEATURES))
        block = resnet._Block
        self.conv1 = nn.Conv2d(3, a, kernel_size=7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(a)
        self.layer1 = nn.Sequential(block(a, a, stride=1), block(a, a, stride=1))
        self.layer2 = nn.Sequential(block(a, b, stride=2), block(b, b, stride=1))
        self.layer3 = nn.Sequential(block(b, c, stride=2), block(c, c, stride=1))
        self.layer4 = nn.Sequential(block(c, d, stride=2), block(d, d, stride=1))


NARROW = Backbone("narrow-resnet18", "resnet", _FEATURES, _NarrowResNet, (), resnet.load_pretrained)
BACKBONES[NARROW.name] = NARROW

_COMMON = {
    "title": "tiny",
    "epochs": 4,
    "batch_size": 8,
    "learning_rates": (1e-3, 1e-4),
    "milestones": (3,),
    "validation_images": 4,
    "start": "random",
    "backbone": NARROW.name,
}
HYPOTHESES = HypothesisRecipe(
    **_COMMON,
    hypotheses=4,
    meta_loss="ewta",
    embedded_loss="von-mises",
    epochs_to_one=3,
)
CLASSIFIER = ClassifierRecipe(
    **_COMMON,
    negatives=16,
    frozen_epochs=2,
)
MIXTURE = MixtureRecipe(**_COMMON, structure="free", components=3, members=4)
IMPLICIT_PDF = ImplicitPdfRecipe(**_COMMON, queries=16)
DIFFUSION = DiffusionRecipe(**_COMMON, draws=4, samples=8, hypotheses=5, steps=3)
RECIPES: dict[str, Recipe] = {
    "hypotheses": HYPOTHESES,
    "classifier": CLASSIFIER,
    "mixture": MIXTURE,
    "implicit-pdf": IMPLICIT_PDF,
    "diffusion": DIFFUSION,
}
CPU = Options(device="cpu")
