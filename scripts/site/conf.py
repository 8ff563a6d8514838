# Sphinx builds the site of the pages in docs/ with these settings; scripts/docs calls it.
import posixpath
import re

from docutils import nodes

project = "abcal"
author = "abcal maintainers"
copyright = ""
html_title = "abcal"
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "index"
exclude_patterns = []
suppress_warnings = []
# A made page depends on its text alone, so that a package built twice has the same bytes.
html_last_updated_fmt = None
html_theme = "furo"
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_show_sphinx = False
html_use_index = False
html_domain_indices = False
templates_path = ["templates"]
html_static_path = ["static"]
html_css_files = ["site.css"]
html_additional_pages = {"search": "search.html"}
html_theme_options = {"sidebar_hide_name": False}
myst_heading_anchors = 6
myst_enable_extensions = []
highlight_language = "none"
pygments_style = "default"

# Where the sidebar puts pages that index.md does not name: below the page about them.
FOLDERS = {
    "theory/README": "/theory/*",
    "protocols/README": "/protocols/*",
    "instruments": "/drivers/*",
    "architecture": "/decisions/*",
}
LINK = re.compile(r"\]\(([^)#\s]+)\.md(?:#[^)\s]*)?\)")


def toctree(entries, glob=False, caption=None):
    lines = ["", "```{toctree}", ":hidden:"]
    if glob:
        lines.append(":glob:")
    if caption:
        lines.append(":caption: " + caption)
    return "\n".join(lines + ["", *entries, "```", ""])


def navigation_of(text):
    """The sidebar: each section of the front page with the pages that it names, each page once."""
    seen = {"index"}
    trees = []
    for section in re.split(r"^## ", text, flags=re.M)[1:]:
        entries = []
        for page in LINK.findall(section):
            page = posixpath.normpath(page)
            # A page of a folder stands below the page about the folder.
            if page in seen or page.startswith("../") or ("/" in page and page not in FOLDERS):
                continue
            seen.add(page)
            entries.append(page)
        if entries:
            trees.append(toctree(entries, caption=section.split("\n", 1)[0].strip()))
    return "".join(trees)


def read_source(app, docname, source):
    text = source[0]
    if docname == "index":
        text += navigation_of(text)
    if docname in FOLDERS:
        text += toctree([FOLDERS[docname]], glob=True)
    # A folder is linked as the page about it; what is not a page is copied beside the site (scripts/docs).
    folder = posixpath.dirname(docname)
    for name, page in (("drivers", "instruments"), ("decisions", "architecture"), ("theory", "theory/README"), ("protocols", "protocols/README")):
        target = posixpath.relpath(page + ".md", folder or ".")
        written = posixpath.relpath(name, folder or ".")
        text = re.sub(r"\]\(" + re.escape(written) + r"/?\)", "](" + target + ")", text)
    source[0] = text


def slug(text):
    """The anchor of a heading, as tests/docs/pages_test.cc and documents.mjs make it."""
    return re.sub(r"[^a-z0-9_ -]", "", text.lower()).replace(" ", "-")


def add_anchors(app, doctree):
    """Anchors of headings are those of the Markdown, whatever docutils calls them."""
    seen = {}
    for section in doctree.findall(nodes.section):
        name = slug(section.next_node(nodes.title).astext())
        count = seen.get(name, 0)
        seen[name] = count + 1
        anchor = name if count == 0 else f"{name}-{count}"
        if anchor and anchor not in section["ids"]:
            section["ids"].append(anchor)


def without_own_search(app):
    # MiniSearch takes its place: Sphinx's index finds whole words only and knows no sections.
    app.builder.search = False


def without_scripts(app, pagename, templatename, context, doctree):
    # Those of Sphinx serve its own search and highlight words from it; the theme's are loaded by themselves.
    context["script_files"] = [script for script in context["script_files"] if "furo" in str(getattr(script, "filename", script))]


def setup(app):
    app.connect("html-page-context", without_scripts, priority=900)
    app.connect("builder-inited", without_own_search)
    app.connect("source-read", read_source)
    app.connect("doctree-read", add_anchors)
