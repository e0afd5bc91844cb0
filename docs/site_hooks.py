"""What the site does beyond MkDocs: pages from the repository's root, and equations as MathML.

Browsers draw MathML themselves: no script, no font, nothing to fetch. The code host makes equations of the same $..$.
"""

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
FROM_ROOT = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
FROM_ROOT |= {f"examples/{path.name}": f"examples/{path.name}" for path in ROOT.glob("examples/*.py")}

_LINK = re.compile(r"\[([^\]]+)\]\((?!https?:)([^)#]+)(#[^)]*)?\)")
_FENCED = re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r'<span class="arithmatex">\\\((.+?)\\\)</span>', re.DOTALL)
_DISPLAYED = re.compile(r'<div class="arithmatex">\s*\\\[(.+?)\\\]\s*</div>', re.DOTALL)
_CELL = re.compile(r"<t[hd]\b.*?</t[hd]>", re.DOTALL)
_CODE = re.compile(r"(<code>)([^<]+)(</code>)")
_AFTER = re.compile(r"(?<=[_/.=-])(?=[\w<-])")
_DIGEST = re.compile(r"\b([0-9a-f]{64})\b(?![^<]*>)")
_BAR = re.compile(r"<mo>(&#x0007C;|&#x02016;)</mo>")  # which browsers would set as operators between two others
_FUNCTION = r"<mi>(?:ln|exp|sin|cos|arcsin|det)</mi>"
_BEFORE_FUNCTION = re.compile(rf"(?<=</mi>)(?={_FUNCTION})")
_AFTER_FUNCTION = re.compile(rf"({_FUNCTION})(?=<m(?!o\b))")
_THIN_SPACE = '<mspace width="0.17em"></mspace>'
_PICTURE = re.compile(r'<img\b[^>]*?\bsrc="([^"]+)"[^>]*>')


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Take in what stands outside of docs/."""
    for name, place in FROM_ROOT.items():
        files.append(File.generated(config, place, abs_src_path=str(ROOT / name)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turn links as the code host has them into the site's; fenced code stays as it is."""
    folder = ROOT if page.file.src_uri in FROM_ROOT.values() else (DOCS / page.file.src_uri).parent
    parts = _FENCED.split(markdown)
    parts[::2] = [_LINK.sub(lambda link: _site_link(folder, *link.groups(default="")), part) for part in parts[::2]]
    return "".join(parts)


def _site_link(folder: Path, label: str, target: str, heading: str) -> str:
    """Return a link of a page in `folder` as the site has it; what is in the repository alone becomes its label."""
    path = (folder / target).resolve()
    in_repository = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else ""
    if in_repository in FROM_ROOT:
        return f"[{label}]({FROM_ROOT[in_repository]}{heading})"
    if path.is_dir() or (path.exists() and not path.is_relative_to(DOCS)):
        return label
    return f"[{label}]({target.removeprefix('docs/')}{heading})"


def on_page_content(content: str, **_: object) -> str:
    """Turn equations into MathML, say where long words of tables may break, and let pictures open in their own size."""
    content = _CELL.sub(_breakable, content)
    content = _PICTURE.sub(r'<a class="picture" href="\1">\g<0></a>', content)
    content = _INLINE.sub(lambda found: _mathml(found[1], "inline"), content)
    return _DISPLAYED.sub(lambda found: _mathml(found[1], "block"), content)


def on_post_page(output: str, **_: object) -> str:
    """Name the theme's search for those who hear the page."""
    return output.replace(
        'data-md-component="search" role="dialog"', 'data-md-component="search" role="dialog" aria-label="Search"'
    )


def _breakable(cell: re.Match[str]) -> str:
    """Return a table's cell with places where its names and digests may break; what is copied stays as it was."""
    names = _CODE.sub(lambda code: code[1] + _AFTER.sub("<wbr>", code[2]) + code[3], cell[0])
    return _DIGEST.sub(
        lambda digest: f'<span class="digest">{"<wbr>".join(re.findall(".{8}", digest[1]))}</span>', names
    )


def _mathml(equation: str, display: str) -> str:
    drawn = convert(html.unescape(equation), display=display)
    drawn = _AFTER_FUNCTION.sub(rf"\1{_THIN_SPACE}", _BEFORE_FUNCTION.sub(_THIN_SPACE, drawn))
    return _BAR.sub(r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>', drawn)
