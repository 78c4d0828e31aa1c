"""The documentation as a site: `python -m sphinx -W -c docs . build/site`, from the top folder, with the extra `docs`.

Pages are the Markdown files that a repository browser shows too.  What only a site needs is made while it is built: the
table of contents from the lists of `docs/index.md`, the reference from the docstrings (`docs/site/`).
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "site"))

import phfmu  # noqa: E402  (the path comes first)

project = "phfmu"
author = "phfmu contributors"
copyright = author
version = release = phfmu.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "cells", "contents", "reference"]
root_doc = "docs/index"
include_patterns = ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/*.md", "docs/**/*.md", "docs/**/*.ipynb"]
exclude_patterns = [".*", "build", "components", "dist", "fmus", "phfmu", "tests"]

myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "smartquotes"]
myst_links_external_new_tab = False
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"phfmu {version}"
html_static_path = ["site/static"]
html_css_files = ["phfmu.css"]
html_extra_path = ["site/top"]  # index.html, which leads to docs/index.html
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"source_edit_link": "", "top_of_page_buttons": []}
