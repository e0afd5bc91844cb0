"""Faults planted in a copy of the package, one at a time: for each, a named test must fail.

These are the mistakes that a data set of rotations invites. The first case plants nothing and must pass, so
that a copy that cannot run at all is not taken for a fault that was found.
"""

import os
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from forked_programs import Server

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"symsol_annot": "symsol_annot", "cli": "symsol_annot_cli", "blender_assets": "symsol_annot_assets"}

CAST = "rendering/test_blender.py::test_segmentation_is_the_ray_casters_but_for_boundary_pixels[tetX]"
SETS = "annotation/test_annotator.py::test_a_hidden_marking_leaves_all_that_hide_it"
FAULTS = {
    "multiplied from the left": (
        "symsol_annot/annotation/annotator.py",
        "R_gt @ self.spec.symmetry_group[others.reshape(-1)]",
        "self.spec.symmetry_group[others.reshape(-1)] @ R_gt",
        SETS,
    ),
    "set multiplied from the left": (
        "symsol_annot/annotation/symmetry_set.py",
        "return turned(self.R_gt, self.turns)",
        "return self.turns @ self.R_gt",
        "house/test_planted_faults.py::test_stored_sets_hold_rotations_that_draw_the_stored_image",
    ),
    "label transposed": (
        "symsol_annot/generation/maker.py",
        "return ImageRecord(view, R_gt, coset_px, annotation.mask, annotation.volume)",
        "return ImageRecord(view, R_gt.T, coset_px, annotation.mask, annotation.volume)",
        "house/test_planted_faults.py::test_stored_sets_hold_rotations_that_draw_the_stored_image",
    ),
    "object turned the other way": (
        "symsol_annot/rendering/frames/projection.py",
        "vertices @ np.swapaxes(R_m2c, -1, -2)",
        "vertices @ R_m2c",
        CAST,
    ),
    "camera the wrong way up": (
        "symsol_annot/rendering/camera.py",
        "self.focal_px * points[..., :2] / depth",
        "-self.focal_px * points[..., :2] / depth",
        CAST,
    ),
    "wrong flip axis": (
        "symsol_annot/rotations/groups.py",
        "np.diag([1.0, -1.0, -1.0])",
        "np.diag([-1.0, -1.0, 1.0])",
        "house/test_planted_faults.py::test_groups_have_their_orders_without_duplicates",
    ),
    "end of the circle counted twice": (
        "symsol_annot/rotations/groups.py",
        "np.arange(order) / order",
        "np.arange(order) / (order - 1)",
        "house/test_planted_faults.py::test_groups_have_their_orders_without_duplicates",
    ),
    "front faces culled": (
        "symsol_annot/rendering/blender/opengl.py",
        'face_culling_set("FRONT")',
        'face_culling_set("BACK")',
        CAST,
    ),
    "candidates of shown views kept": (
        "symsol_annot/annotation/annotator.py",
        "if self.is_shown(coset_px):",
        "if not len(cosets):",
        "annotation/test_annotator.py::test_a_shown_marking_leaves_the_stabiliser",
    ),
    "geometry seen from behind": (
        "symsol_annot/annotation/visibility.py",
        "camera = -self._lattice.distance * R_m2c[:, 2]",
        "camera = self._lattice.distance * R_m2c[:, 2]",
        "annotation/test_visibility.py::test_a_ray_casters_count_lies_between_the_bounds[tetX]",
    ),
    "samples near the outline taken for counted": (
        "symsol_annot/annotation/visibility.py",
        "return count - np.bincount(less, minlength=n), count",
        "return count + 9 * np.bincount(less, minlength=n), count",
        "annotation/test_visibility.py::test_a_ray_casters_count_lies_between_the_bounds[tetX]",
    ),
    "triangles turned round forgotten": (
        "symsol_annot/annotation/visibility.py",
        "upper[open_] = np.bincount(turned.owner, minlength=len(open_))",
        "upper[open_] = 0",
        "annotation/test_visibility.py::test_however_vertices_are_moved_the_count_lies_between_the_bounds[0.1-tetX]",
    ),
    "no margin about a square of samples": (
        "symsol_annot/annotation/visibility.py",
        "np.sqrt(2.0) - self._shift) - 1.0",
        "np.sqrt(2.0)) - 1.0",
        "annotation/test_visibility.py::test_however_vertices_are_moved_the_count_lies_between_the_bounds[0.1-tetX]",
    ),
    "vertices rounded to a coarser grid": (
        "symsol_annot/rendering/frames/projection.py",
        "SUBPIXELS = 256",
        "SUBPIXELS = 128",
        "rendering/test_opengl.py::test_the_points_of_each_part_are_those_of_integer_arithmetic[cylO]",
    ),
    "normals not divided by depth": (
        "symsol_annot/rendering/blender/opengl.py",
        "turned = normal * corner.w;",
        "turned = normal;",
        "rendering/test_opengl.py::test_normals_are_interpolated_on_the_surface_and_not_in_the_picture",
    ),
    "samples beside the pixels' centres": (
        "symsol_annot/rendering/frames/supersampling.py",
        "ids[n // 2 :: n, n // 2 :: n]",
        "ids[:-1:n, :-1:n]",
        CAST,
    ),
    "a group that no digest is over": (
        "symsol_annot/sets/shard/reader.py",
        "digest.update(content_heading(name, values.dtype.str, values.shape) + values.tobytes())",
        "digest.update(content_heading(name, values.dtype.str, values.shape))",
        "sets/test_reader.py::test_content_digest_depends_on_the_group",
    ),
    "the hour in a shard's bytes": (
        "symsol_annot/sets/shard/writer.py",
        "plist.set_obj_track_times(False)",
        "plist.set_obj_track_times(True)",
        "sets/test_writer.py::test_same_contents_give_the_same_bytes_at_another_time[1000]",
    ),
    "a set of an older format added to": (
        "symsol_annot/sets/manifest.py",
        "if manifest.format_version != NEWEST:",
        "if manifest.format_version > NEWEST:",
        "sets/test_format_1.py::test_another_plan_is_refused_in_the_same_line",
    ),
    "positives at the threshold": (
        "symsol_annot/bench/scoring/scorers/classifier.py",
        'thresholds.astype(in_order.dtype), side="right"',
        'thresholds.astype(in_order.dtype), side="left"',
        "bench/scoring/test_classifier.py::test_a_probability_of_exactly_the_threshold_is_no_claim",
    ),
    "one of many equal methods the best by chance": (
        "symsol_annot/bench/scoring/best.py",
        "by_chance.max(axis=1)",
        "by_chance.mean(axis=1)",
        "bench/scoring/test_best.py::test_of_many_equal_methods_a_given_one_is_left_out_in_at_most_one_case_of_twenty",
    ),
    "a copy of the labels that ranks": (
        "symsol_annot/bench/leaderboard/rows.py",
        "for group in groups if not group.is_exact",
        "for group in groups",
        "bench/leaderboard/test_rows.py::test_copies_of_the_truth_have_no_rank_and_say_so",
    ),
    "last images of an epoch left out": (
        "symsol_annot/sets/epoch_order.py",
        "n * (part + 1) // parts",
        "n // parts * (part + 1)",
        "sets/test_epoch_order.py::test_parts_hold_every_row_once_and_differ_by_at_most_one_image",
    ),
    "more shards shuffled together than are kept open": (
        "symsol_annot/sets/epoch_order.py",
        "-(-shards // MAX_OPEN_SHARDS)",
        "-(-shards // (2 * MAX_OPEN_SHARDS))",
        "sets/test_epoch_order.py::test_reader_of_files_opens_each_of_its_shards_once[1]",
    ),
    "losers share by the number of all": (
        "symsol_annot/bench/models/losses.py",
        "epsilon / (M - 1) * losses.sum(dim=-1)",
        "epsilon / M * losses.sum(dim=-1)",
        "bench/models/test_losses.py::test_rwta_is_its_equation[0.05-30]",
    ),
    "statistics of a frozen stage move": (
        "symsol_annot/bench/models/networks/first_stage.py",
        "super().train(mode and not self._is_frozen)",
        "super().train(mode)",
        "bench/models/test_first_stage.py::test_a_frozen_first_stage_stays_to_the_bit_while_the_second_learns",
    ),
    "queries in order": (
        "symsol_annot/bench/predictions/queries.py",
        "in_order[order] = probability",
        "in_order[:] = probability",
        "bench/predictions/test_queries.py::test_unshuffle_puts_candidates_in_row_0_and_decoys_in_the_others_in_the_order_of_the_group",
    ),
    "secret seed of half its bits": (
        "symsol_annot/sealing/making.py",
        "secrets.randbits(SECRET_SEED_BITS)",
        "secrets.randbits(SECRET_SEED_BITS // 2)",
        "sealing/test_secret.py::test_seeds_are_of_128_bits_and_no_two_are_alike",
    ),
    "any seed opens a commitment": (
        "symsol_annot/sealing/secret.py",
        "if secret.digest != self.digest:",
        "if not secret.digest:",
        "sealing/test_secret.py::test_a_seed_opens_its_own_commitment_and_no_other_does",
    ),
    "a count of the annotation published": (
        "symsol_annot/sealing/images.py",
        "header = manifest.header(entry, shard.versions)",
        "header = manifest.header(entry, {**shard.versions, 'drawn': str(shard.candidates_drawn)})",
        "sealing/test_images.py::test_other_labels_of_the_same_images_are_published_as_the_same_bytes",
    ),
    "a path that leads outside not looked for": (
        "symsol_annot/archives/archive.py",
        r'if header.name.startswith("/") or ".." in re.split(r"[/\\]", header.name):',
        "if not header.name:",
        "archives/test_archive.py::test_an_archive_with_something_that_no_set_has_is_refused_and_nothing_is_written",
    ),
    "shards put in place without their digests": (
        "symsol_annot/archives/archive.py",
        "if found != entry.sha256:",
        "if not found:",
        "archives/test_archive.py::test_a_bit_that_flips_anywhere_is_found",
    ),
    "a download resumed whatever became of the file": (
        "symsol_annot/archives/download.py",
        'headers["If-Range"] = self._note.validator',
        'headers["X-If-Range"] = self._note.validator',
        "archives/test_fetching.py::test_an_archive_that_changed_meanwhile_is_not_put_together_from_two",
    ),
    "labels of other images scored": (
        "symsol_annot/sealing/labels.py",
        "    refuse_other_images(sealed.manifest, sealed.folder, labelled.manifest, folder)\n",
        "",
        "bench/predictions/test_sealed_predictions.py::test_labels_of_other_images_are_refused",
    ),
}


def test_stored_sets_hold_rotations_that_draw_the_stored_image(tmp_path):
    import numpy as np
    from made_sets import SIZE, make_set
    from oracle import cast

    import symsol_annot

    for sample in symsol_annot.load(make_set(tmp_path, "tetX", test=6)):
        for R in sample.symmetry_set:
            assert np.count_nonzero(cast("tetX", R, SIZE) != sample.segmentation) <= 5


def test_groups_have_their_orders_without_duplicates():
    import numpy as np

    from symsol_annot.objects.spec import load_object

    for name, order in {"tet": 12, "cube": 24, "icosa": 60, "cone": 360, "cyl": 720}.items():
        group = load_object(name).symmetry_group
        assert len(np.unique(np.round(group.reshape(-1, 9), 6) + 0.0, axis=0)) == order == len(group)


# Others' packages alone: what is imported before the fork cannot be a copy with a fault.
SERVER = Server(
    "quick_pytest", "numpy", "scipy.spatial", "scipy.stats", "healpix", "h5py", "zlib_ng", "PIL.Image", "roma"
)
CLAIMS = ("AssertionError", "assert ", "Failed: DID NOT", "symsol_annot.errors.")


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the packages, and a place for what Python compiles of it and of the tests: once for all faults."""
    folder = tmp_path_factory.mktemp("copy")
    for source, package in PACKAGES.items():
        shutil.copytree(ROOT / source, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def run_with(copy, tmp_path, nodes, fault=None):
    """Run tests on the copy of the package, with a fault planted; return pytest's exit code, output and report."""
    if fault:
        file, right, wrong = fault
        path = copy / file
        text = path.read_text()
        assert text.count(right) == 1, f"{file} does not hold {right!r} once: the fault cannot be planted"
        path.write_text(text.replace(right, wrong))
    report = tmp_path / "report.xml"
    options = [
        "-W",
        "ignore::pytest.PytestAssertRewriteWarning",
        "-p",
        "no:cacheprovider",
        "-x",
        f"--junitxml={report}",
        f"--basetemp={tmp_path / 'inside'}",
    ]
    compiled = {"PYTHONPYCACHEPREFIX": str(copy / "compiled"), "PYTHONDONTWRITEBYTECODE": ""}
    environment = {**os.environ, **compiled, "PYTHONPATH": str(copy)}
    words = [*options, *(f"tests/{node}" for node in nodes)]
    try:
        done = SERVER.run("quick_pytest:main", *words, cwd=ROOT, env=environment, path=[copy])
    finally:
        if fault:
            path.write_text(text)
    return done.returncode, done.stdout + done.stderr, report


def failed_claims(report):
    """Return what tests said whose own claim failed, or that the library refused; any other crash is none."""
    messages = [failure.get("message", "") for failure in ET.parse(report).iter("failure")]
    return [message for message in messages if message.startswith(CLAIMS)]


@pytest.mark.blender
def test_nothing_planted_fails_nothing(copy, tmp_path):
    nodes = sorted({fault[3] for fault in FAULTS.values()})
    code, output, report = run_with(copy, tmp_path, nodes)
    assert code == pytest.ExitCode.OK, output
    assert len(list(ET.parse(report).iter("testcase"))) >= len(nodes)  # some are run with several parameters


@pytest.mark.blender
@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_fails_its_test(name, copy, tmp_path):
    *fault, node = FAULTS[name]
    code, output, report = run_with(copy, tmp_path, [node], fault)
    assert code == pytest.ExitCode.TESTS_FAILED, output
    assert failed_claims(report), output


def test_a_crash_is_not_taken_for_a_fault_that_was_found(copy, tmp_path):
    fault = ("symsol_annot/rotations/groups.py", "np.diag([1.0, -1.0, -1.0])", "np.diag(undefined)")
    node = "house/test_planted_faults.py::test_groups_have_their_orders_without_duplicates"
    code, output, report = run_with(copy, tmp_path, [node], fault)
    assert code == pytest.ExitCode.TESTS_FAILED, output
    assert failed_claims(report) == []
