"""All kinds of attack, and what makes the valid files that they are made from."""

from attack.archives import Archives, make_archives
from attack.bop import BopFolders, BopResults, make_bop
from attack.checkpoints import Checkpoints, make_checkpoints
from attack.fixed import Found, NoFiles
from attack.manifests import Manifests
from attack.meshes import Meshes, make_meshes
from attack.predictions import Predictions, make_predictions
from attack.sets import make_sets
from attack.shards import Shards, SignedShards
from attack.texts import Leaderboards, Objects, Recipes, Scores, make_scores
from attack.zips import Zips, make_zip

BASES = {
    "sets": make_sets,
    "scores": make_scores,
    "checkpoints": make_checkpoints,
    "zips": make_zip,
    "predictions": make_predictions,
    "archives": make_archives,
    "bop": make_bop,
    "meshes": make_meshes,
}
KINDS = {
    kind.name: kind
    for kind in (
        *(Shards, SignedShards, Manifests, Found, NoFiles),
        *(Objects, Recipes, Scores, Leaderboards, Checkpoints, Zips, Predictions),
        *(Archives, BopFolders, BopResults, Meshes),
    )
}
