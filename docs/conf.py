"""The documentation site: `make docs` builds it with Sphinx from these pages and the docstrings; warnings are errors."""

from importlib.metadata import version as installed_version

project = "brdfpipe"
author = "the brdfpipe authors"
copyright = author
release = version = installed_version("brdfpipe")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_click"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "tradeoff"]

html_theme = "furo"
html_title = f"brdfpipe {release}"
html_show_copyright = False
html_last_updated_fmt = None

myst_enable_extensions = ["colon_fence", "attrs_inline"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True


def in_numpy_style(app, what, name, obj, options, lines: list[str]) -> None:
    """Docstrings here describe a parameter behind a colon, where napoleon expects its type, and bars are those of absolute values."""
    section, written = "", []
    for number, line in enumerate(lines):
        text = line.replace("|", r"\|")
        following = lines[number + 1] if number + 1 < len(lines) else ""
        if following and set(following.strip()) == {"-"}:
            section = line.strip()
        term, colon, words = text.partition(" : ")
        if section in ("Parameters", "Raises") and colon and not line.startswith(" "):
            written += [term, f"    {words}"]
        elif section == "Returns" and line.strip() == "Returns":
            written.append("Notes")  # the text of what is returned, without a name or a type
        elif section == "Returns" and set(line.strip()) == {"-"}:
            written += ["-----", "**Returns**", ""]
        else:
            written.append(text)
    lines[:] = written


def setup(app) -> None:
    app.connect("autodoc-process-docstring", in_numpy_style, priority=400)
