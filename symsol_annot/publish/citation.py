"""How the data are to be cited: CITATION.cff, and the same as BibTeX."""

import json
from importlib import resources
from string import Template

from symsol_annot import __version__
from symsol_annot.publish.about import LICENCE, About

CITATION_NAME = "CITATION.cff"


def citation_cff(about: About) -> str:
    """Return the CITATION.cff of the data."""
    optional = {"date-released": about.date, "url": about.url}
    lines = [f"{name}: {json.dumps(value)}" for name, value in optional.items() if value]
    template = resources.files("symsol_annot.publish").joinpath("citation.cff").read_text(encoding="utf-8")
    text = Template(template).substitute(
        title=json.dumps(about.title, ensure_ascii=False),
        authors="\n".join(f"  - name: {json.dumps(author, ensure_ascii=False)}" for author in about.authors),
        version=about.version,
        licence=LICENCE,
        optional="\n".join(lines),
        software=__version__,
    )
    return text.replace("\n\n", "\n")


def bibtex(about: About) -> str:
    """Return the data's entry for a bibliography."""
    fields = {
        "title": f"{{{about.title}}}",
        "author": " and ".join(f"{{{author}}}" for author in about.authors),
        "version": about.version,
        **({"year": about.date[:4]} if about.date else {}),
        **({"url": about.url} if about.url else {}),
    }
    return "@misc{symsol_annot_data,\n" + "".join(f"  {name} = {{{value}}},\n" for name, value in fields.items()) + "}"
