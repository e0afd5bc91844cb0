"""The table of the tracks, by name; scores, messages and choices list them in its order."""

from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER
from symsol_annot.bench.predictions.tracks.density import DENSITY
from symsol_annot.bench.predictions.tracks.hypotheses import HYPOTHESES
from symsol_annot.bench.predictions.tracks.track import Track

TRACKS: dict[str, Track] = {track.name: track for track in (HYPOTHESES, CLASSIFIER, DENSITY)}
TRACK_OF_DATASET: dict[str, str] = {dataset: track.name for track in TRACKS.values() for dataset in track.datasets}
