"""Settings of the documentation site: Sphinx (BSD), MyST-NB (BSD), furo (MIT), all maintained."""

from __future__ import annotations

from pathlib import Path

import geomag

project = "geomag"
author = "The geomag developers"
copyright = author
version = release = geomag.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx-mathjax-offline",  # MathJax beside the pages: formulas need no network
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
root_doc = "index"
exclude_patterns = ["_build", "_rust", "**.ipynb_checkpoints"]
# Attributes such as x stand in many classes; their docstrings do not mean any of them as a link.
suppress_warnings = ["mystnb.unknown_mime_type", "ref.python"]

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 240
nb_execution_in_temp = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_default_options = {"members": True, "show-inheritance": False}
autosummary_generate = True
napoleon_numpy_docstring = True
napoleon_google_docstring = False

html_theme = "furo"
html_title = f"geomag {release}"
# rustdoc's output, where make docs has put it
html_extra_path = ["_rust"] if (Path(__file__).parent / "_rust").is_dir() else []
html_show_sourcelink = False
