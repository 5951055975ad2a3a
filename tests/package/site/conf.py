"""The pages of this clone as a site with a search: `sphinx-build -W -c tests/package/site . build/site`.

`-W` ends with an error where a link leads nowhere. Pages stay where they are; the contents come from here.
"""

import shutil

from sphfilter import __version__ as release

project, author, html_title = "sphfilter", "the sphfilter authors", f"sphfilter {release}"
extensions, html_theme = ["myst_nb"], "furo"
nb_execution_mode = "off"  # notebooks keep their outputs, and tests run them
myst_heading_anchors = 3  # those that GitHub makes of headings
root_doc = "README"
include_patterns = ["*.md", "sphfilter/*.md", "experiments/**.md", "notebooks/*.ipynb"]
CONTENTS = {
    "To use it": "sphfilter/RECIPES sphfilter/API sphfilter/FAILURES sphfilter/*",
    "To look at": "notebooks/first_filter notebooks/* experiments/README experiments/**",
    "To work on it": "ARCHITECTURE CONTRIBUTING CHANGELOG",
}


def add_contents(app, page, source):
    """The README leads to all pages, in the margin of each."""
    if page == root_doc:
        for caption, pages in CONTENTS.items():
            listed = "\n".join(pages.split())
            source[0] += f"\n```{{toctree}}\n:hidden:\n:glob:\n:caption: {caption}\n{listed}\n```\n"


def add_index(app, failure):
    """The README is also what a server shows first."""
    if failure is None:
        shutil.copy(app.outdir / "README.html", app.outdir / "index.html")


def setup(app):
    """What Sphinx calls first."""
    app.connect("source-read", add_contents)
    app.connect("build-finished", add_index)
