"""What the book asks of Sphinx beyond its configuration."""

import re
from pathlib import Path

from docutils import nodes
from sphinx_external_toc.collectors import TocTreeCollectorWithStyles

# Thebe would run cells on a server; its script names a content network.
# Preloaded fonts are refused by browsers when a page is opened as a file,
# and are then loaded as usual.
UNWANTED = re.compile(
    r"""<script[^>]*>[^<]*\bTHEBE_JS_URL\b.*?</script>"""
    r"""|<script[^>]*sphinx-thebe\.js.*?</script>"""
    r"""|<script type="text/x-thebe-config">.*?</script>"""
    r"""|<script>kernelName\b.*?</script>"""
    r"""|<link[^>]*rel="preload" as="font"[^>]*>""",
    re.DOTALL,
)


# On a dark page the browser asks a drawing for its dark form. Curves and
# diagrams are drawn light on dark, with the hues that they have. A map
# would lose its order, so it keeps its colours, dimmed, and only what is
# around it turns light: titles, numbers and walls.
DARK = "@media screen and (prefers-color-scheme: dark) {{ {} }}"
TURNED = "filter: invert(0.91) hue-rotate(180deg) brightness(1.2)"
NO_PAPER = "#patch_1 path { fill: none !important }"
INVERTED = f"svg {{ {TURNED} }} {NO_PAPER}"
MAP = "[id^=axes_]:has(image)"
AROUND_MAPS = f"""
{NO_PAPER}
image {{ filter: brightness(0.85) }}
[id^=axes_]:not(:has(image)) {{ {TURNED} }}
#figure_1 > [id^=text_], {MAP} [id^=text_] {{ fill: #e8e8e8 }}
{MAP} > [id^=patch_] path[style*="fill: #ffffff"] {{
  fill: none !important
}}
{MAP} [id^=_Walls] path,
{MAP} [id*=tick_] use,
{MAP} > [id^=patch_] path[style*="stroke: #000000"] {{
  stroke: #e8e8e8 !important
}}
"""
DIMMED = f"""
@supports selector(:has(image)) {{ {AROUND_MAPS} }}
@supports not selector(:has(image)) {{ svg {{ filter: brightness(0.85) }} }}
"""


def for_dark_pages(drawing: str) -> str:
    """Return an SVG with a style for dark pages."""
    style = DARK.format(DIMMED if "<image" in drawing else INVERTED)
    return re.sub(
        r"(<svg\b[^>]*>)", rf"\1<style>{style}</style>", drawing, count=1
    )


def draw_for_dark_pages(app, exception):
    """Give the figures that cells have drawn a form for dark pages."""
    for path in Path(app.outdir, "_images").glob("*.svg"):
        text = path.read_text(encoding="utf-8")
        if "(prefers-color-scheme: dark)" not in text:
            path.write_text(for_dark_pages(text), encoding="utf-8")


def tell_boxes_apart(app, doctree):
    """Give questions to the reader a colour, and proofs a quiet one."""
    looks = dict.fromkeys(("Bet", "Predict"), "question-to-you")
    looks["Proof"] = "quiet"
    for box in doctree.findall(nodes.admonition):
        first = box[0].astext().split(" ")[0].rstrip(":")
        if first in looks:
            box["classes"].append(looks[first])


def keep_percentages_together(app, doctree):
    """Let no line end between a number and its percent sign."""
    code = nodes.literal, nodes.FixedTextElement, nodes.raw
    for text in [*doctree.findall(nodes.Text)]:
        whole = re.sub(r"(?<=\d) (?=%)", "\u00a0", text)
        if whole != text and not isinstance(text.parent, code):
            text.parent.replace(text, nodes.Text(whole))


def make_offline(app, exception):
    """Leave out what needs a server: pages are opened as files."""
    for page in Path(app.outdir).rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        kept = UNWANTED.sub("", text)
        if kept != text:
            page.write_text(kept, encoding="utf-8")


def assign_section_numbers(
    collector, env, assign=TocTreeCollectorWithStyles.assign_section_numbers
):
    """Make 05_….ipynb chapter 5 also while earlier chapters are missing."""
    rewritten = assign(collector, env)
    for page, numbers in env.toc_secnumbers.items():
        chapter = Path(page).name.split("_")[0]
        if chapter.isdecimal():
            for heading in [
                env.titles[page],
                *env.tocs[page].findall(nodes.reference),
            ]:
                heading["secnumber"] = [
                    int(chapter),
                    *heading["secnumber"][1:],
                ]
            for anchor, number in numbers.items():
                numbers[anchor] = (int(chapter), *number[1:])
    return rewritten


def assign_figure_numbers(
    collector, env, assign=TocTreeCollectorWithStyles.assign_figure_numbers
):
    """Number figures in chapters only, where a number says which page."""
    before = dict(env.toc_fignumbers)
    assign(collector, env)
    for page, kinds in env.toc_fignumbers.items():
        if not env.titles[page].get("secnumber"):
            kinds.pop("figure", None)
    now = env.toc_fignumbers
    return [page for page in now if now[page] != before.get(page)]


def need_an_address(app, config):
    """Leave out the buttons for Colab and Binder while there is none."""
    if not config.html_theme_options.get("repository_url"):
        config.html_theme_options.pop("launch_buttons", None)


def setup(app):
    """Register with Sphinx."""
    TocTreeCollectorWithStyles.assign_section_numbers = (
        assign_section_numbers
    )
    TocTreeCollectorWithStyles.assign_figure_numbers = assign_figure_numbers
    # Before the theme reads its options, which it does at this event.
    app.connect("config-inited", need_an_address, priority=100)
    app.connect("build-finished", make_offline)
    app.connect("doctree-read", tell_boxes_apart)
    app.connect("doctree-read", keep_percentages_together)
    app.connect("build-finished", draw_for_dark_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
