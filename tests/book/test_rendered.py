"""The rendered book: complete, correct and readable without network."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
from bs4 import BeautifulSoup
from sphinx_external_toc.parsing import parse_toc_yaml

ROOT = Path(__file__).parents[2]
PAGES = list(parse_toc_yaml(ROOT / "_toc.yml"))
CHAPTERS = [page for page in PAGES if (ROOT / f"{page}.ipynb").exists()]

# What is fetched when a page is opened, as opposed to the links that a reader may follow.
LOADED = [
    ("script, img, video, audio, source, track, iframe, embed, input", "src"),
    ("link:not([rel=canonical], [rel=next], [rel=prev])", "href"),
    ("img, source", "srcset"),
    ("video", "poster"),
    ("object", "data"),
]
EXTERNAL = re.compile(r"\s*(https?:|//)")
EXTERNAL_CSS = re.compile(r"""(?:url\(|@import)\s*["']?\s*((?:https?:)?//[^"')\s;]+)""")
EXTERNAL_SCRIPT = re.compile(r"""["'](https?://[^"']+\.js)["']""")
RAW_MARKUP = re.compile(
    r"```|:::|\$\$"  # a fence or a formula
    r"|\{[a-z][a-z:-]*\}`"  # a role
    r"|^\s*:(?:label|class|name|nonumber):"  # an option of a directive
    r"|\]\(#|\]\[",  # a link
    re.MULTILINE,
)
TRACEBACK = re.compile(r"Traceback \(most recent call last\)")


def external(soup):
    """Whatever a page loads from the network."""
    loaded = [
        element.get(attribute, "")
        for selector, attribute in LOADED
        for element in soup.select(selector)
    ]
    css = [element.text for element in soup.select("style")]
    css += [element["style"] for element in soup.select("[style]")]
    scripts = [element.text for element in soup.select("script")]
    return (
        [url for url in loaded if EXTERNAL.match(url)]
        + EXTERNAL_CSS.findall(" ".join(css))
        + EXTERNAL_SCRIPT.findall(" ".join(scripts))
    )


def raw_markup(soup):
    """Markdown that was shown instead of interpreted."""
    prose = BeautifulSoup(str(soup.select_one("article") or soup), "html.parser")
    for element in prose.select("pre, script, style, .math, .cell_output"):
        element.decompose()
    for element in prose.select("code"):
        element.replace_with(f"`{element.text}`")
    return RAW_MARKUP.findall(prose.get_text())


def errors(soup):
    """Tracebacks, and what Sphinx leaves where it could not go on."""
    found = soup.select(".output.traceback, .system-message, .problematic")
    return [element.text for element in found] + TRACEBACK.findall(soup.text)


def without_alternative(soup):
    """Images that say nothing to those who do not see them."""
    images = soup.select("img")
    return [image.get("src", "")[:80] for image in images if not image.get("alt", "").strip()]


def broken(page, soups):
    """Links within the book that lead nowhere, and references that are no link at all."""
    found = [span.text for span in soups[page].select("span.xref") if not span.find_parent("a")]
    for link in soups[page].select("a[href]"):
        url = urlsplit(link["href"])
        if url.scheme or url.netloc:
            continue
        target = (page.parent / unquote(url.path)).resolve() if url.path else page
        if not target.exists():
            found.append(link["href"])
        elif url.fragment and target in soups:
            anchor = unquote(url.fragment)
            if not soups[target].find(id=anchor) and not soups[target].find(attrs={"name": anchor}):
                found.append(link["href"])
    return found


def parse(text):
    return BeautifulSoup(text, "html.parser")


def code_cells(path):
    cells = nbformat.read(path, as_version=4).cells
    return [cell for cell in cells if cell.cell_type == "code"]


@pytest.fixture(scope="module")
def soups(html):
    return {path.resolve(): parse(path.read_text()) for path in html.rglob("*.html")}


BAD_AND_GOOD = [
    (external, '<script src="https://cdn/x.js"></script>', '<a href="https://x.org">x</a>'),
    (external, '<link rel="stylesheet" href="//cdn/x">', '<link rel="canonical" href="https://x">'),
    (external, "<style>@import 'https://cdn/x.css'</style>", "<style>a {b: url(x)}</style>"),
    (external, '<p style="b: url(https://cdn/x)">', '<img src="data:image/png;base64,">'),
    (external, '<script>u = "https://cdn/x.js"</script>', "<script>u = 1</script>"),
    (raw_markup, "<p>{cite}<code>x</code></p>", "<p>Write <code>x</code></p>"),
    (raw_markup, "<p>```{note}</p>", "<pre>```{note}</pre>"),
    (raw_markup, "<p>:::{exercise}\n:label: x</p>", "<p>a: b</p>"),
    (raw_markup, "<p>$$ x $$</p>", "<p>$5</p>"),
    (errors, '<div class="output traceback">ValueError</div>', "<p>fine</p>"),
    (errors, "<pre>Traceback (most recent call last)</pre>", "<p>A traceback is printed.</p>"),
    (without_alternative, '<img src="x.png">', '<img src="x.png" alt="a curve">'),
    (without_alternative, '<img src="x.png" alt=" ">', ""),
]


@pytest.mark.parametrize(("check", "bad", "good"), BAD_AND_GOOD)
def test_checks_detect(check, bad, good):
    assert check(parse(bad))
    assert not check(parse(good))


def test_check_of_links_detects(tmp_path):
    page = tmp_path / "page.html"
    page.write_text(
        '<a href="#no">1</a><a href="no.html">2</a><span class="xref">3</span>'
        '<a href="#yes">4</a><a href="https://x.org/no">5</a><p id="yes">'
    )
    assert len(broken(page, {page: parse(page.read_text())})) == 3


def test_renders_without_a_warning(rendering):
    assert rendering.returncode == 0, rendering.stdout + rendering.stderr


def test_opens_at_the_front_page(html):
    assert (html / "index.html").exists()


def test_loads_nothing_from_the_network(html, soups):
    found = {path.name: urls for path, soup in soups.items() if (urls := external(soup))}
    for path in html.rglob("*.css"):
        if urls := EXTERNAL_CSS.findall(path.read_text()):
            found[path.name] = urls
    assert not found


@pytest.mark.parametrize("page", PAGES)
def test_page(html, soups, page):
    path = (html / page).with_suffix(".html").resolve()
    soup = soups[path]
    assert not errors(soup)
    assert not raw_markup(soup)
    assert not without_alternative(soup)
    assert not broken(path, soups)


@pytest.mark.parametrize("page", CHAPTERS)
def test_chapter_was_executed_and_shows_its_output(book, soups, html, page):
    cells = code_cells(book / f"{page}.ipynb")
    assert all(cell.execution_count for cell in cells)

    for cell in cells:
        for output in cell.outputs:
            assert "Warning" not in output.get("text", ""), f"cell {cell.id} warns: {output.text}"

    shown = [
        cell
        for cell in cells
        if cell.outputs
        and not {"remove-cell", "remove-output"} & set(cell.metadata.get("tags", []))
    ]
    path = (html / page).with_suffix(".html").resolve()
    assert len(soups[path].select(".cell_output")) == len(shown)


def header_links(page):
    soup = parse(page.read_text())
    return {link["href"] for link in soup.select(".article-header-buttons a[href]")}


@pytest.mark.parametrize("page", CHAPTERS)
def test_notebook_can_be_downloaded_without_network(html, page):
    path = (html / page).with_suffix(".html")
    (link,) = header_links(path)  # and no other button, while the book has no address
    assert nbformat.read(path.parent / link, as_version=4).cells


def test_one_line_brings_the_buttons_for_binder_and_colab(tmp_path):
    address = "https://github.com/someone/offairl"
    config, chapter = (ROOT / "_config.yml").read_text(), CHAPTERS[0]
    assert config.count('\n  url: ""\n') == 1
    (tmp_path / "_config.yml").write_text(config.replace('url: ""', f"url: {address}"))
    (tmp_path / "_toc.yml").write_text(f"format: jb-book\nroot: {chapter}\n")
    (tmp_path / "book").mkdir()
    for name in ("_ext", "_static", "references.bib", f"{Path(chapter).name}.ipynb"):
        (tmp_path / "book" / name).symlink_to(ROOT / "book" / name)
    command = shutil.which("jupyter-book", path=Path(sys.executable).parent)
    subprocess.run([command, "build", "-q", tmp_path], check=True, capture_output=True)
    links = header_links(tmp_path / f"_build/html/{chapter}.html")
    assert (
        f"https://mybinder.org/v2/gh/someone/offairl/main?urlpath=lab/tree/{chapter}.ipynb" in links
    )
    assert (
        f"https://colab.research.google.com/github/someone/offairl/blob/main/{chapter}.ipynb"
        in links
    )
