"""What comes from files is text on a page: built to HTML as the site does, it comes out as the words that went in."""

import html
import re
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import markdown
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mkdocs.config import load_config

from symsol_annot.system.text.markdown import escaped, fenced

ROOT = Path(__file__).resolve().parents[2]
UNPRINTABLE = dict.fromkeys(n for n in range(0x3000) if not chr(n).isprintable())
HOSTILE = [
    "::: symsol_annot",
    "<script>alert(1)</script>",
    "[x](javascript:alert(1))",
    "![x](http://a/b.png)",
    "[x][y]",
    "[x]: http://a",
    "!!! note",
    "??? note",
    "{{ config }}",
    "{% raw %}",
    "{: .class }",
    "$x_1$ and $$y$$",
    r"\(x\) \[y\]",
    "# heading",
    "a\n# heading",
    "a\n---",
    "a\n===",
    "---",
    "===",
    "***",
    "+++",
    "- item",
    "+ item",
    "* item",
    "1. item",
    "1) item",
    "> quote",
    "    code",
    "\tcode",
    "`code` and ``more``",
    "```",
    "~~~",
    "~~struck~~ ~sub~ ^sup^ ==mark== --- ++key++",
    "*a* **b** _c_ __d__",
    "&lt; &amp; &#60;",
    "a | b",
    "|---|",
    ":smile: :material-home:",
    "<https://a.b> https://a.b www.a.b",
    "<!-- comment -->",
    "*[HTML]: text",
    "[^1] [^1]: note",
    "--8<-- 'file'",
    "a\\",
    "&",
    "\\",
    "@someone #12",
]


@cache
def _config():
    return load_config(str(ROOT / "mkdocs.yml"))


def built(page):
    """A page as the site's Markdown builds it."""
    config = _config()
    return markdown.markdown(page, extensions=config.markdown_extensions, extension_configs=config.mdx_configs)


class _Elements(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.text = [], ""

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)

    def handle_data(self, data):
        self.text += data


def tags_and_text(page):
    elements = _Elements()
    elements.feed(built(page))
    elements.close()
    return elements.tags, elements.text.strip()


def shown(words):
    """The words of a text, without what cannot be printed."""
    return re.sub(r" +", " ", re.sub(r"\s", " ", words).translate(UNPRINTABLE)).strip()


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_words_are_shown_as_they_are_in_a_paragraph_a_table_and_a_heading(words):
    assert tags_and_text(escaped(words)) == (["p"], shown(words))
    tags, text = tags_and_text(f"| {escaped(words)} | b |\n| --- | --- |\n| c | {escaped(words)} |")
    assert tags == ["table", "thead", "tr", "th", "th", "tbody", "tr", "td", "td"]
    assert re.sub(r"\s*\n\s*", "|", text) == f"{shown(words)}|b|c|{shown(words)}"
    tags, text = tags_and_text(f"## {escaped(words)}\n\nMore.")
    assert (tags, text.startswith(shown(words))) == (["h2", "a", "p"], True)


@given(st.text(alphabet=st.sampled_from(" \n\t#*_-+=`~[](){}<>!|$&\\:;@^%.,'\"/0123aZ\u202e\x1b\x02"), max_size=30))
@settings(max_examples=300, deadline=None)
def test_any_words_are_shown_as_they_are(words):
    tags, text = tags_and_text(f"A {escaped(words)}")
    assert (tags, text) == (["p"], shown(f"A {words}"))
    if shown(words):
        assert tags_and_text(escaped(words)) == (["p"], shown(words))


def test_plain_words_stay_readable_in_the_source():
    for words in ("EWTA, von Mises", "Classifier, F = 5", "AMD EPYC, 1 thread (no GPU); torch 2.13.0", "a-b, c/d: 5%"):
        assert escaped(words) == words


def test_what_cannot_be_printed_is_left_out():
    assert escaped("a\x1b[2J\u202eb\u2028c\x00") == "a&#91;2Jb c"


@pytest.mark.parametrize(
    "lines",
    [
        "echo `date`",
        "a\n```\n::: x\n# b",
        "~~~\n<script>\n~~~",
        "````\n```\n`````",
        "    indented\n\ttab\n\n\n- item",
        "`" * 40,
    ],
)
def test_nothing_in_a_block_of_code_ends_it(lines):
    page = built(f"{fenced(lines, 'sh')}\n\nAfter.")
    assert page.count("<pre") == 1
    inside = re.search(r"<pre.*?>(.*)</pre>", page, re.DOTALL)[1]
    expected = "\n".join(line.rstrip() for line in lines.expandtabs(4).splitlines())
    assert html.unescape(re.sub(r"<[^>]+>", "", inside)).strip("\n") == expected
    assert page.rstrip().endswith("<p>After.</p>")


def test_the_site_builds_with_hostile_words_and_shows_them(tmp_path):
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# One\n\n" + "\n\n".join(f"## {escaped(w)}\n\n{escaped(w)}" for w in HOSTILE))
    config = tmp_path / "mkdocs.yml"
    config.write_text(f"INHERIT: {ROOT / 'mkdocs.yml'}\nhooks: []\nnav: [index.md]\nextra_css: []\n")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config), "-d", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "index.html").read_text()
    paragraphs = [html.unescape(found) for found in re.findall(r"<p>(.*?)</p>", page, re.DOTALL)]
    assert paragraphs[: len(HOSTILE)] == [shown(words) for words in HOSTILE]
