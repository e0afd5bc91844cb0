"""What the publisher says about the data, and no file can tell."""

import re
from dataclasses import dataclass
from datetime import date
from itertools import accumulate

from symsol_annot.errors import SettingsError

LICENCE = "CC-BY-4.0"
LICENCE_URL = "https://creativecommons.org/licenses/by/4.0/"


@dataclass(frozen=True)
class About:
    """What the publisher says about the data.

    Attributes:
        title: of the data set.
        authors: names of people or groups.
        version: of the data, like 1.0.0.
        date: of publication, like 2026-01-31; None leaves it out.
        url: where the data will be; None leaves it out.
    """

    title: str = "Images of symmetric objects with their symmetry sets"
    authors: tuple[str, ...] = ("The symsol-annot developers",)
    version: str = "1.0.0"
    date: str | None = None
    url: str | None = None

    def __post_init__(self) -> None:
        """Refuse what hosts refuse."""
        texts = (self.title, *self.authors)
        if not self.authors or any(not text.strip() or not text.isprintable() for text in texts):
            raise SettingsError(f"title and authors: expected text on one line, found {texts!r}")
        if not all(_is_balanced(text) for text in texts):
            raise SettingsError(f"title and authors: expected a }} for each {{, or BibTeX is broken, found {texts!r}")
        if not re.fullmatch(r"\d+\.\d+\.\d+", self.version, re.ASCII):
            raise SettingsError(f"version: expected three numbers, like 1.0.0, found {self.version!r}")
        if self.date is not None and not _is_date(self.date):
            raise SettingsError(f"date: expected a day, like 2026-01-31, found {self.date!r}")
        if self.url is not None and not re.fullmatch(r"https?://(?:(?![{}\"<>\\])[!-~])+", self.url):
            raise SettingsError(
                f'url: expected http:// or https://, then ASCII without spaces or any of {{}}"<>\\, found {self.url!r}'
            )


def _is_balanced(text: str) -> bool:
    """Say whether the braces in a text are pairs, as BibTeX counts them."""
    depths = list(accumulate((character == "{") - (character == "}") for character in text))
    return min(depths) >= 0 and depths[-1] == 0


def _is_date(text: str) -> bool:
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False
