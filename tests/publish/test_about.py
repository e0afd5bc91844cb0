"""What a publisher says of a bundle: what hosts refuse is refused."""

import pytest

from symsol_annot.errors import SettingsError
from symsol_annot.publish.about import About


@pytest.mark.parametrize(
    "wrong",
    [
        {"title": ""},
        {"title": "two\nlines"},
        {"authors": ()},
        {"version": "1"},
        {"date": "31.1.2026"},
        {"url": "ftp://x"},
    ],
)
def test_what_hosts_refuse_is_refused(wrong):
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        About(**wrong)
