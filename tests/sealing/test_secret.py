"""The secret and the commitment: bound to each other by SHA-256, and neither read where a byte differs."""

import hashlib
import json
import stat

import pytest
from sealed_tests import plan_to_seal, software

from symsol_annot.errors import SealError
from symsol_annot.sealing import making
from symsol_annot.sealing.secret import read_commitment, read_secret


@pytest.fixture
def sealed(tmp_path):
    making.seal(plan_to_seal(), software(), tmp_path / "tetX")
    return tmp_path / "tetX"


def test_the_digest_is_what_sha256sum_says_of_the_secrets_file(sealed):
    digest = hashlib.sha256((sealed / "secret.json").read_bytes()).hexdigest()
    assert json.loads((sealed / "commitment.json").read_text())["sha256"] == digest
    assert read_secret(sealed / "secret.json").digest == digest


def test_the_secret_is_its_owners_alone_and_the_commitment_anybodys(sealed):
    assert stat.S_IMODE((sealed / "secret.json").stat().st_mode) == 0o600
    assert stat.S_IMODE((sealed / "commitment.json").stat().st_mode) & 0o444 == 0o444


def test_the_commitment_says_all_but_the_seed(sealed):
    secret = json.loads((sealed / "secret.json").read_text())
    commitment = json.loads((sealed / "commitment.json").read_text())
    assert secret.pop("seed") not in (sealed / "commitment.json").read_text()
    commitment.pop("sha256")
    assert {**secret, "format": ""} == {**commitment, "format": ""}
    assert (commitment["object"], commitment["images"], commitment["versions"]) == ("tetX", 24, software())


def test_seeds_are_of_128_bits_and_no_two_are_alike(tmp_path):
    seeds = [making.seal(plan_to_seal(), software(), tmp_path / str(i)).settings.seed for i in range(64)]
    assert len(set(seeds)) == 64
    for bit in range(128):  # a bit that is the same in all 64 has a chance of 1 in 2^63
        assert len({seed >> bit & 1 for seed in seeds}) == 2


def test_a_seed_opens_its_own_commitment_and_no_other_does(sealed):
    secret, commitment = (
        read_secret(sealed / "secret.json"),
        read_commitment(sealed / "commitment.json"),
    )
    assert commitment.opened_by(secret.settings.seed) == secret
    for bit in (0, 64, 127):
        with pytest.raises(SealError, match="does not fit the commitment") as refused:
            commitment.opened_by(secret.settings.seed ^ 1 << bit)
        assert "\n" not in str(refused.value)
        assert commitment.digest in str(refused.value)


@pytest.mark.parametrize("name", ["secret.json", "commitment.json"])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"images": 24', '"images": 25'),
        ('"object": "tetX"', '"object": "cylO"'),
        ('"tolerance_px": 5.0', '"tolerance_px": 4.0'),
        ('"renderer": "numpy"', '"renderer": "bpy"'),
    ],
)
def test_no_term_can_be_changed_after_the_commitment(sealed, name, old, new):
    path = sealed / name
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    secret, commitment = read_secret(sealed / "secret.json"), read_commitment(sealed / "commitment.json")
    assert secret.commitment != commitment
    with pytest.raises(SealError, match="is another sealed test's; it was not touched"):
        making.keep_secret(sealed, secret)
    if name == "commitment.json":
        with pytest.raises(SealError, match="does not fit the commitment"):
            commitment.opened_by(secret.settings.seed)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        '{"format": "symsol-annot set"}',
        '{"format": "symsol-annot sealed test: secret", "format_version": 1}',
        '{"format": "symsol-annot sealed test: secret", "format_version": 2}',
        "[" * 100000,
    ],
)
def test_a_file_that_is_no_secret_is_refused_in_a_line_that_names_it(tmp_path, text):
    path = tmp_path / "secret.json"
    path.write_text(text)
    with pytest.raises(SealError, match=r"^\S+secret.json: .+$"):
        read_secret(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("seed", "0" * 31),
        ("seed", 7),
        ("seed", "A" * 32),
        ("images", 0),
        ("images", True),
        ("versions", []),
        ("versions", {"numpy": 1}),
        ("object", "../x"),
        ("more", 1),
    ],
)
def test_each_value_of_a_secret_is_of_its_kind(sealed, key, value):
    path = sealed / "secret.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}, indent=1, sort_keys=True) + "\n")
    with pytest.raises(SealError, match="was damaged or edited"):
        read_secret(path)


def test_a_missing_secret_is_named_with_what_makes_one(tmp_path):
    with pytest.raises(SealError, match=r"secret.json: cannot be read: No such file.*`symsol-annot seal new`"):
        read_secret(tmp_path / "secret.json")


def test_a_test_is_not_sealed_over_another(sealed):
    before = {path.name: path.read_bytes() for path in sealed.iterdir()}
    with pytest.raises(SealError, match=r"holds secret.json of a sealed test already, and nothing was touched"):
        making.seal(plan_to_seal(), software(), sealed)
    assert {path.name: path.read_bytes() for path in sealed.iterdir()} == before
