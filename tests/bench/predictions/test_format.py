"""The version of the format of a predictions file."""

import pytest


@pytest.mark.parametrize(
    ("version", "said"),
    [
        (2, "the file: is of format version 2, newer than 1, which this symsol-annot reads: update it"),
        (0, "the file: this version reads format_version 1, found 0"),
    ],
)
def test_another_format_version_is_refused_and_a_later_one_says_what_to_do(faults, version, said):
    assert said in faults(attributes={"format_version": version})
