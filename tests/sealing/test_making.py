"""Making a sealed test: resumed where it was stopped, published whole or not at all, and never over anything else."""

import stat

import pytest
from command_line import contents
from sealed_tests import IMAGES, everything_in, plan_to_seal, sealed_test, software, workers

from symsol_annot.errors import DataError, RenderError, SealError
from symsol_annot.sealing import making
from symsol_annot.sets.manifest import read_manifest


def unasked(_plan):
    pytest.fail("the software was asked for")


def stops_after(frames):
    left = iter(range(frames))

    def on_frame():
        if next(left, None) is None:
            raise RenderError("the lamp went out")

    return on_frame


def test_an_interrupted_test_is_resumed_to_the_bytes_of_one_that_was_not(tmp_path):
    making.seal(plan_to_seal(), software(), tmp_path / "a")
    for name in ("secret.json", "commitment.json"):
        (tmp_path / "b").mkdir(exist_ok=True)
        (tmp_path / "b" / name).write_bytes((tmp_path / "a" / name).read_bytes())
    with pytest.raises(RenderError, match="the lamp went out"):
        making.render(tmp_path / "a", workers(stops_after(18)), software)
    assert len(list((tmp_path / "a/labelled").glob("*.h5"))) == 1  # of 2
    assert not (tmp_path / "a/public").exists()
    kept = (tmp_path / "a/labelled/test-00000-of-00002.h5").stat().st_mtime_ns
    for name in ("a", "b"):
        test = making.render(tmp_path / name, workers(), software)
        assert test.secret.images == IMAGES
    assert (tmp_path / "a/labelled/test-00000-of-00002.h5").stat().st_mtime_ns == kept
    assert everything_in(tmp_path / "a") == everything_in(tmp_path / "b")


def test_the_same_command_on_a_finished_test_writes_nothing_and_asks_no_renderer(folder):
    before = {name: contents(folder / name) for name in ("public", "labelled")}
    making.render(folder, lambda _: pytest.fail("an executor was opened"), unasked)
    assert {name: contents(folder / name) for name in ("public", "labelled")} == before


def test_labels_are_in_a_folder_that_others_cannot_enter(made):
    assert stat.S_IMODE((made / "labelled").stat().st_mode) == 0o700


def test_images_that_were_lost_are_published_again_to_the_same_bytes(folder):
    before = everything_in(folder / "public")
    for path in (folder / "public").iterdir():
        path.unlink()
    making.render(folder, workers(), unasked)
    assert everything_in(folder / "public") == before


def test_two_tests_of_the_same_terms_have_other_images(made, tmp_path):
    other = read_manifest(sealed_test(tmp_path / "other") / "public")
    assert [one.content_sha256 for one in other.shards] != [
        one.content_sha256 for one in read_manifest(made / "public").shards
    ]


def test_other_software_than_was_sealed_for_is_refused_before_a_shard_is_made(tmp_path):
    making.seal(plan_to_seal(), {**software(), "renderer": "another"}, tmp_path)
    with pytest.raises(SealError, match=r"renderer: sealed for another, here numpy\).*seal anew before"):
        making.render(tmp_path, workers(), software)
    assert {path.name for path in tmp_path.iterdir()} == {"secret.json", "commitment.json"}


@pytest.mark.parametrize("damage", ["edited", "lost", "foreign"])
def test_images_that_somebody_changed_are_named_and_left_alone(folder, damage):
    path = folder / "public/test-00001-of-00002.h5"
    if damage == "edited":
        path.write_bytes(path.read_bytes()[:-1] + b"x")
    elif damage == "lost":
        path.unlink()
    else:
        for name in ("manifest.json", path.name):
            (folder / "public" / name).write_bytes((folder / "labelled" / name).read_bytes())
    before = contents(folder / "public")
    with pytest.raises(SealError, match=r"public: holds other files than this test's images, or damaged ones"):
        making.render(folder, workers(), software)
    assert contents(folder / "public") == before


def test_a_damaged_shard_of_the_labels_is_named_and_left_alone(folder):
    path = folder / "labelled/test-00001-of-00002.h5"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(DataError, match=r"finished shards are missing or damaged: test-00001-of-00002.h5"):
        making.render(folder, workers(), software)


def test_a_folder_without_a_secret_is_refused_and_left_empty(tmp_path):
    with pytest.raises(SealError, match=r"secret.json: cannot be read"):
        making.render(tmp_path, workers(), software)
    assert list(tmp_path.iterdir()) == []
