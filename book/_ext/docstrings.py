"""Docstrings, which are written like Markdown, for Sphinx.

Sphinx reads reStructuredText, where code, mathematics and links look
otherwise, and a `|` or a `*` has a meaning.
"""

import re
from dataclasses import fields, is_dataclass

from docutils import nodes
from sphinx.ext.autodoc import ClassDocumenter, DataDocumenter, Options

NAME = re.compile(r"[A-Za-z_][\w.]*(\(\))?")
MARKUP = re.compile(
    r"^(?P<indent> *)\$\$(?P<display>[^$]+)\$\$"
    r"|\$(?P<inline>[^$]+)\$"
    r"|`(?P<code>[^`]+)`"
    r"|(?<!\S)(?P<emphasis>\*\w[^*]*\w\*)"
    # What would be markup: also `O.`, the first item of a list.
    r"|(?P<special>[|*\\]|_(?!\w)|(?<=\b[A-Za-z])\.(?!\w))",
    re.MULTILINE,
)
# What Python says of a named tuple's fields.
FIELD = re.compile(r"Alias for field number \d+")
# A class's attributes are its arguments.
ATTRIBUTES = re.compile(r"^( *)Attributes:$", re.MULTILINE)
# Napoleon takes what stands before a colon in the first line of an
# attribute, or of what is returned, for a type. So the first line is empty,
# but for what is not shown.
NOTHING = "\\"
RETURNS = re.compile(r"^( *)Returns:\n( *)", re.MULTILINE)
LONGEST_VALUE = 60
MOST_FIELDS = 10


def _converted(match):
    indent, display, inline, code, emphasis, special = match.groups()
    if display:
        lines = [
            f"{indent}    {line.strip()}" for line in display.split("\n")
        ]
        return "\n".join([f"{indent}.. math::", "", *lines, ""])
    if inline:
        return f":math:`{inline}`"
    if emphasis:
        return emphasis
    if special:
        return f"\\{special}"
    if not NAME.fullmatch(code):
        return f"``{code}``"
    # A name with a dot may begin anywhere: `Config.reward`.
    return f":py:obj:`{'.' * ('.' in code)}{code}`"


def converted(docstring):
    """Return a docstring as reStructuredText.

    Formulas between dollars, code between backticks and emphasis between
    stars are marked up, names in the code are links; all else is literal.
    """
    docstring = ATTRIBUTES.sub(r"\1Args:", docstring.strip())
    docstring = MARKUP.sub(_converted, docstring)
    return RETURNS.sub(rf"\g<0>{re.escape(NOTHING)}\n\2", docstring)


def convert(app, what, name, obj, options, lines):
    """Convert a docstring in place."""
    lines[:] = [*converted("\n".join(lines)).split("\n"), ""]
    if what in ("attribute", "data", "property"):
        lines.insert(0, NOTHING)


def shorten(app, what, name, obj, options, signature, returns):
    """Leave out a large dataclass's arguments: its fields are listed."""
    if is_dataclass(obj) and len(fields(obj)) > MOST_FIELDS:
        return "(…)", None
    # What is no Python would be shown as it is.
    return signature and signature.replace("<factory>", "..."), returns


def unbracket(app, doctree, page):
    """Call the links to the code `source`, without brackets."""
    for link in doctree.findall(nodes.inline):
        if "viewcode-link" in link["classes"]:
            link[:] = [nodes.Text("source")]


class Class(ClassDocumenter):
    """A class; of its fields those are listed that have a description."""

    def filter_members(self, members, want_all):
        """Return the members to list."""
        return [
            (name, member, is_attribute)
            for name, member, is_attribute in super().filter_members(
                members, want_all
            )
            if is_attribute or not FIELD.fullmatch(str(member.__doc__))
        ]


class Constant(DataDocumenter):
    """A constant, whose value is shown if it is short."""

    def add_directive_header(self, sig):
        """Begin its description."""
        if len(repr(self.object)) > LONGEST_VALUE:
            self.options = Options({**self.options, "no-value": True})
        super().add_directive_header(sig)


def setup(app):
    """Register with Sphinx."""
    for extension in ("autodoc", "napoleon", "viewcode"):
        app.setup_extension(f"sphinx.ext.{extension}")
    # Before napoleon, which makes sections of what it is given.
    app.connect("autodoc-process-docstring", convert, priority=400)
    app.connect("autodoc-process-signature", shorten)
    app.connect("doctree-resolved", unbracket)
    app.add_autodocumenter(Class, override=True)
    app.add_autodocumenter(Constant, override=True)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
