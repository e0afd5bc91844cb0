"""The scores once more, in plain loops, from what the documents say: thesis 5.2 and 7.2, and the files' formats.

It shares no code with the package. Distances are roma's on torch in float64, grid and groups are scipy's and
healpix's, and files are read with h5py alone. Every per-image figure is a pair of value and weight; NaN with weight
0 is undefined.
"""

import hashlib
import json
import math
from pathlib import Path

import h5py
import healpix
import numpy as np
import roma
import torch
from scipy.spatial.transform import Rotation

ANGLES_DEG = (1, 2, 5, 10, 15, 30)
SWEPT = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
STANDARD = 0.8
DECOYS = 8
ROUNDING_RAD = 1e-9  # between labels: 5 degrees are not more than 5 degrees, whatever their last digits are
SLACK_RAD = 1e-6  # between labels and predictions, which may be float32
NEAR_PI_RAD = 1e-3

torch.set_num_threads(1)  # the arrays are small, and waiting threads cost more than they save


def angles(R, many):
    """Eq. 5.6 from one rotation to each of many."""
    one = torch.from_numpy(np.ascontiguousarray(R, dtype=np.float64))
    others = torch.from_numpy(np.ascontiguousarray(many, dtype=np.float64))
    return roma.rotmat_geodesic_distance(one.expand_as(others), others).numpy()


def mean(numbers):
    return math.fsum(numbers) / len(numbers)


def nearest_rotation(matrix):
    """The rotation that a rounded one stands for, by its singular vectors."""
    if not np.isfinite(matrix).all():
        return matrix  # of weight 0
    u, _, vt = np.linalg.svd(matrix)
    return u @ vt


def weighted_mean(numbers, weights):
    return math.fsum(w * x for w, x in zip(weights, numbers, strict=True)) / math.fsum(weights)


def grid(level):
    """HEALPix directions in ring order times tilts; index = tilt x directions + direction."""
    directions, tilts = 12 * 4**level, 6 * 2**level
    rotations = []
    for tilt in range(tilts):
        eulers = []
        for pixel in range(directions):
            polar, azimuth = healpix.pix2ang(2**level, pixel)
            eulers.append([azimuth, polar, 2 * math.pi * tilt / tilts])
        rotations.append(Rotation.from_euler("ZYZ", eulers).as_matrix())
    return np.concatenate(rotations)


def digest(matrices):
    """Entries x 2^20, rounded to the nearest integer, as little-endian 32-bit integers."""
    return hashlib.sha256(np.rint(np.asarray(matrices) * 2**20).astype("<i4").tobytes()).hexdigest()


def query_stream(fingerprint, image, count):
    stream = hashlib.shake_256(f"symsol-annot queries 1/{fingerprint}/{image}".encode()).digest(8 * count)
    return [int.from_bytes(stream[8 * k : 8 * k + 8], "little") for k in range(count)]


def query_order(fingerprint, image, group_order):
    """Query q asks number order[q] of the list R_gt g, R'_1 g, .., R'_8 g."""
    count = (1 + DECOYS) * group_order
    numbers = query_stream(fingerprint, image, 3 * DECOYS + count)[3 * DECOYS :]
    return sorted(range(count), key=numbers.__getitem__)


def queries(fingerprint, image, R_gt, group):
    """The rotations themselves, with Shoemake's uniform random rotations as decoys."""
    numbers = [n / 2**64 for n in query_stream(fingerprint, image, 3 * DECOYS)]
    bases = [R_gt]
    for k in range(DECOYS):
        u, v, w = numbers[3 * k : 3 * k + 3]
        inner, outer, v, w = math.sqrt(1 - u), math.sqrt(u), 2 * math.pi * v, 2 * math.pi * w
        x, y, z = inner * math.sin(v), inner * math.cos(v), outer * math.sin(w)
        bases.append(Rotation.from_quat([x, y, z, outer * math.cos(w)]).as_matrix())
    asked = [base @ g for base in bases for g in group]
    return np.array([asked[n] for n in query_order(fingerprint, image, len(group))])


def arc_pieces(group):
    """For a round body, the pairs (i, j) of elements with element j one degree after i about z; else none."""
    if len(group) < 360:
        return []
    step = Rotation.from_euler("z", 1, degrees=True).as_matrix()
    pieces = []
    for i, g in enumerate(group):
        distance = angles(g @ step, group)
        j = int(distance.argmin())
        assert distance[j] < 1e-7
        pieces.append((i, j))
    return pieces


def angle_to_arcs(members_of, pieces, R_other):
    """The angle from R_other to the nearest member, or to the nearest point of the pieces between neighbours.

    Args:
        members_of: index in the group to R g, for the g in the set.
        pieces: of the group.
        R_other: (3, 3).
    """
    order = list(members_of)
    to_members = dict(zip(order, angles(R_other, np.array([members_of[i] for i in order])), strict=True))
    best = min(to_members.values())
    reach = best + math.radians(1.01)  # no piece is longer than a degree
    begins = [members_of[i] for i, j in pieces if i in members_of and j in members_of and to_members[i] <= reach]
    if not begins:
        return best
    begins = np.array(begins)

    def turned(t):
        cosine, sine = np.cos(t), np.sin(t)
        turn = np.zeros((len(t), 3, 3))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cosine, -sine, sine, cosine, 1
        return begins @ turn

    low, high = np.zeros(len(begins)), np.full(len(begins), math.radians(1))
    for _ in range(75):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        is_left = np.linalg.norm(turned(left) - R_other, axis=(1, 2)) < np.linalg.norm(
            turned(right) - R_other, axis=(1, 2)
        )
        low, high = np.where(is_left, low, left), np.where(is_left, right, high)
    return min(best, *angles(R_other, turned((low + high) / 2)))


class TruthOracle:
    """A split, read from its shards."""

    def __init__(self, folder, split="test"):
        folder = Path(folder)
        manifest = json.loads((folder / "manifest.json").read_text())
        self.object, self.split = manifest["object"], split
        self.fingerprint = manifest["splits"][split]["fingerprint"]
        self.rotation, self.mask, self.is_shown, self.is_barely = [], [], [], []
        for path in sorted(folder.glob(f"{split}-*.h5")):
            with h5py.File(path) as f:
                assert f.attrs["first_index"] == len(self.rotation)
                self.group = f.attrs["symmetry_group"]
                camera, tolerance = json.loads(f.attrs["camera"]), float(f.attrs["tolerance_px"])
                self.is_marked = not math.isnan(tolerance)
                barely = 20 * camera["width"] * camera["height"] / 224**2
                for R, mask, pixels in zip(
                    f["rotation"][()], f["symmetry_mask"][()], f["marking_pixels"][()].tolist(), strict=True
                ):
                    self.rotation.append(R)
                    self.mask.append(mask)
                    self.is_shown.append(self.is_marked and pixels >= tolerance)
                    self.is_barely.append(self.is_shown[-1] and pixels < barely)
        self.pieces = arc_pieces(self.group)

    def __len__(self):
        return len(self.rotation)

    def members_of(self, i):
        return {g: self.rotation[i] @ self.group[g] for g in range(len(self.group)) if self.mask[i][g]}

    def symmetry_set(self, i):
        return np.array(list(self.members_of(i).values()))

    def strata(self):
        images = range(len(self))
        if not self.is_marked:
            return {"all": list(images)}
        return {
            "all": list(images),
            "shown": [i for i in images if self.is_shown[i]],
            "hidden": [i for i in images if not self.is_shown[i]],
            "barely": [i for i in images if self.is_barely[i]],
        }


class ScoreOracle:
    """The scores of a predictions file.

    Attributes:
        per_image: track to metric to a list of (value, weight), image by image.
        is_near_pi: track to a list of whether an angle near pi, where eq. 5.6 itself errs, is in an image's figures.
        knife_edge_rad: the smallest difference between an angle and a threshold that it was held against.
    """

    def __init__(self, path, truth):
        self.truth, self.per_image, self.is_near_pi, self.knife_edge_rad = truth, {}, {}, math.inf
        with h5py.File(path) as f:
            self.attributes = dict(f.attrs)
            self.columns = {name: column[()] for name, column in f.items()}
        assert self.attributes["fingerprint"] == truth.fingerprint
        self.row_of = {int(i): row for row, i in enumerate(self.columns["image_index"])}
        scorers = {
            "hypotheses": (self._hypotheses, "hypotheses"),
            "classifier": (self._classifier, "query_probability"),
            "density": (self._density, "density_offsets"),
        }
        for track, (score, needed) in scorers.items():
            if needed in self.columns:
                self.is_near_pi[track] = [False] * len(truth)
                rows = [score(i, self.row_of[i]) for i in range(len(truth))]
                self.per_image[track] = {metric: [row[metric] for row in rows] for metric in rows[0]}

    def figures(self, track):
        """Stratum to metric to (value, images, undefined)."""
        made = {}
        for stratum, images in self.truth.strata().items():
            made[stratum] = {}
            for metric, column in self.per_image[track].items():
                chosen = [column[i] for i in images if column[i][1] > 0]
                total = math.fsum(weight for _, weight in chosen)
                value = math.fsum(value * weight for value, weight in chosen) / total if chosen else math.nan
                made[stratum][metric] = (value, len(chosen), len(images) - len(chosen))
        return made

    def _note_near_pi(self, track, i, errors):
        self.is_near_pi[track][i] |= bool(max(errors) > math.pi - NEAR_PI_RAD)

    def _is_within(self, angle, threshold_rad):
        self.knife_edge_rad = min(self.knife_edge_rad, abs(angle - threshold_rad))
        return angle <= threshold_rad + SLACK_RAD

    def _hypotheses(self, i, row):
        hypotheses = np.array([nearest_rotation(h) for h in self.columns["hypotheses"][row].astype(np.float64)])
        weights = [1.0] * len(hypotheses)
        if "hypothesis_weights" in self.columns:
            weights = [float(w) for w in self.columns["hypothesis_weights"][row]]
        hypotheses = np.array([h for h, w in zip(hypotheses, weights, strict=True) if w > 0])
        weights = [w for w in weights if w > 0]
        members_of = self.truth.members_of(i)
        members = np.array(list(members_of.values()))
        recall_errors = [float(angles(member, hypotheses).min()) for member in members]
        precision_errors = [float(angles(hypothesis, members).min()) for hypothesis in hypotheses]
        self._note_near_pi("hypotheses", i, recall_errors + precision_errors)
        row = {
            "recall_mean_error_rad": (mean(recall_errors), len(members)),
            "recall_mean_error_image_mean_rad": (mean(recall_errors), 1),
            "precision_mean_error_rad": (weighted_mean(precision_errors, weights), 1),
        }
        if self.truth.pieces:
            to_arcs = [angle_to_arcs(members_of, self.truth.pieces, hypothesis) for hypothesis in hypotheses]
            row["precision_mean_error_continuous_rad"] = (weighted_mean(to_arcs, weights), 1)
        for degrees in ANGLES_DEG:
            limit = math.radians(degrees)
            coverage = mean([float(self._is_within(error, limit)) for error in recall_errors])
            accuracy = weighted_mean([float(self._is_within(error, limit)) for error in precision_errors], weights)
            both = coverage + accuracy
            row[f"coverage_at_{degrees}_deg"] = (coverage, len(members))
            row[f"coverage_image_mean_at_{degrees}_deg"] = (coverage, 1)
            row[f"accuracy_at_{degrees}_deg"] = (accuracy, 1)
            row[f"f_measure_at_{degrees}_deg"] = (2 * coverage * accuracy / both if both else 0.0, 1)
            if degrees == 5 and "hypothesis_weights" in self.columns:
                accuracy = mean([float(self._is_within(error, limit)) for error in precision_errors])
                both = coverage + accuracy
                row["f_measure_unweighted_at_5_deg"] = (2 * coverage * accuracy / both if both else 0.0, 1)
        return row

    def _grid(self):
        if not hasattr(self, "_made_grid"):
            self._made_grid = grid(int(self.attributes["grid_level"]))
        return self._made_grid

    def _sparse(self, row, offsets, indices, values):
        start, stop = self.columns[offsets][row], self.columns[offsets][row + 1]
        listed = [int(n) for n in self.columns[indices][start:stop]]
        return dict(zip(listed, [float(v) for v in self.columns[values][start:stop]], strict=True))

    def _hard_negatives(self, mask):
        """The rejected candidates more than 5 degrees from every member."""
        if not hasattr(self, "_group_angles"):
            self._group_angles = np.array([angles(g, self.truth.group) for g in self.truth.group])
        members = np.flatnonzero(mask)
        return [
            g
            for g in range(len(mask))
            if not mask[g] and self._group_angles[g][members].min() > math.radians(5) + ROUNDING_RAD
        ]

    def _classifier(self, i, row):
        mask, order = self.truth.mask[i], len(self.truth.group)
        in_order = [math.nan] * ((1 + DECOYS) * order)
        answers = self.columns["query_probability"][row].tolist()
        for q, number in enumerate(query_order(self.truth.fingerprint, i, order)):
            in_order[number] = answers[q]
        candidates, decoys = in_order[:order], in_order[order:]
        on_grid = self._sparse(row, "grid_offsets", "grid_indices", "grid_probabilities")
        size, set_size = len(self._grid()), int(mask.sum())

        def counts(threshold):
            return (
                sum(mask[g] and candidates[g] > threshold for g in range(order)),
                sum(p > threshold for p in on_grid.values()),
            )

        def ratios(threshold):
            tp, fp = counts(threshold)
            fn = set_size - tp
            return tp / (tp + fn), tp / (tp + fp) if tp + fp else 1.0, 2 * tp / (2 * tp + fp + fn)

        tp, fp = counts(STANDARD)
        recall, precision, f_measure = ratios(STANDARD)
        far, members = 0, self.truth.symmetry_set(i)
        for n, p in on_grid.items():
            if p > STANDARD:
                far += not self._is_within(float(angles(self._grid()[n], members).min()), math.radians(0.5))
        hard = [candidates[g] > STANDARD for g in self._hard_negatives(mask)]
        made = {
            "recall": (recall, 1),
            "precision": (precision, 1),
            "f_measure": (f_measure, 1),
            "accuracy": ((tp + size - fp) / (set_size + size), 1),
            "precision_beyond_half_degree": (tp / (tp + far) if tp + far else 1.0, 1),
            "nothing_predicted_rate": (float(tp == 0 and fp == 0), 1),
            "grid_positive_rate": (fp / size, 1),
            "decoy_false_positive_rate": (mean([float(p > STANDARD) for p in decoys]), 1),
            "hard_negative_rate": (mean([float(h) for h in hard]), 1) if hard else (math.nan, 0),
        }
        for threshold in SWEPT:
            if threshold >= self.attributes["floor"]:
                recall, precision, f_measure = ratios(threshold)
                made[f"recall_above_{threshold}"] = (recall, 1)
                made[f"precision_above_{threshold}"] = (precision, 1)
                made[f"f_measure_above_{threshold}"] = (f_measure, 1)
        return made

    def _density(self, i, row):
        cells, size = self._grid(), len(self._grid())
        listed = self._sparse(row, "density_offsets", "density_indices", "density_log_probabilities")
        left = 1 - math.fsum(math.exp(v) for v in listed.values())
        rest = left / (size - len(listed)) if len(listed) < size else math.nan
        to_set, cell_of, share = np.full(size, math.inf), [], {}
        for member in self.truth.symmetry_set(i):
            distance = angles(member, cells)
            to_set = np.minimum(to_set, distance)
            cell_of.append(int(distance.argmin()))
            share[cell_of[-1]] = share.get(cell_of[-1], 0) + 1
        self._note_near_pi("density", i, to_set.tolist())
        cell_of_gt = int(angles(self.truth.rotation[i], cells).argmin())
        best = {cell: count / len(cell_of) for cell, count in share.items()}
        per_volume = math.log(size / math.pi**2)

        def log_p(cell):
            return listed[cell] if cell in listed else math.log(rest)

        p = {cell: math.exp(v) for cell, v in listed.items()}

        def in_region(cell, mass):
            own = p.get(cell, rest)
            others = [(value, 1) for value in p.values()] + [(rest, size - len(p))] * (size > len(p))
            alike = math.fsum(n * value for value, n in others if abs(value - own) <= 1e-5 * own)
            denser = math.fsum(n * value for value, n in others if value > own * (1 + 1e-5))
            return min(1.0, max(0.0, (mass - denser) / alike)) if alike else 0.0

        expected = [math.exp(v) * to_set[cell] for cell, v in listed.items()]
        expected += [rest * to_set[cell] for cell in range(size) if cell not in listed]
        return {
            "log_likelihood": (mean([log_p(cell) for cell in cell_of]) + per_volume, 1),
            "log_likelihood_ceiling": (mean([math.log(best[cell]) for cell in cell_of]) + per_volume, 1),
            "log_likelihood_at_gt": (log_p(cell_of_gt) + per_volume, 1),
            "log_likelihood_at_gt_ceiling": (math.log(best[cell_of_gt]) + per_volume, 1),
            "spread_rad": (math.fsum(expected), 1),
            "spread_at_ceiling_rad": (math.fsum(share * to_set[cell] for cell, share in best.items()), 1),
            **{
                f"set_in_region_of_{q}_percent": (mean([in_region(cell, q / 100) for cell in cell_of]), 1)
                for q in (50, 80, 90, 95, 99)
            },
        }
