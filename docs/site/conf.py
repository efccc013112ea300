"""Sphinx settings of the documentation site; `scripts/site.py` builds it."""

import inspect
import re

from ves_gym import __version__

project = "ves_gym"
author = "The ves_gym authors"
copyright = "2026, the ves_gym authors"
version = release = __version__
root_doc = "site/index"
source_suffix = {".md": "markdown"}
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes and units are in the text
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_preprocess_types = False
python_use_unqualified_type_names = True
default_role = "literal"  # `q` in a docstring is code

html_theme = "furo"
html_title = "ves_gym"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["static"]
html_css_files = ["phone.css"]
templates_path: list[str] = []
# a name of the front door is also one of its room
suppress_warnings = ["ref.python"]
highlight_language = "none"


def plain(app, what, name, obj, options, lines):
    """Escape what reStructuredText would read as markup in docstrings of plain text."""
    markup = r"(?<![`\\])([*|])(?!`)|(?<=\w)_(?=[\s,.;)\]]|$)"
    lines[:] = [re.sub(markup, r"\\\g<0>", line) for line in lines]
    if what in ("attribute", "property") and ": " in lines[0]:
        # napoleon takes `text: more` for a type and a description, unless a line ends between
        lines[:1] = lines[0].replace(": ", ":\n", 1).split("\n")


# pages that list their neighbours: GitHub shows the list, the site's sidebar needs the tree
PARENTS = ("environments/README", "decisions/README")
# what a reader types, and the page that comes first: an index entry outranks every name
SOUGHT = {"site/first-hour/train": "train"}
TREE = "\n```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"


def children(app, docname, source):
    """Put the other pages of its folder below a page of `PARENTS`; enter what is sought."""
    if docname in PARENTS:
        source[0] += TREE
    if docname in SOUGHT:
        source[0] = f"```{{index}} ! {SOUGHT[docname]}\n```\n\n{source[0]}"


class Short:
    """Default value that is not written out."""

    def __repr__(self):
        return "..."


def shorten(app, what, name, obj, options, signature, annotation):
    """Leave out defaults that would fill the page: a whole arm, a whole structure."""
    if not signature or len(signature) < 400:
        return None
    full = inspect.signature(obj)
    parameters = [
        p.replace(
            annotation=p.empty,
            default=Short()
            if len(repr(p.default)) > 60 and p.default is not p.empty
            else p.default,
        )
        for p in full.parameters.values()
    ]
    return str(full.replace(parameters=parameters, return_annotation=full.empty)), annotation


def setup(app):
    """Connect the events."""
    app.connect("source-read", children)
    app.connect("autodoc-process-docstring", plain, priority=400)
    app.connect("autodoc-process-signature", shorten)
