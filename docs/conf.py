"""Configuration of the documentation: `sphinx-build -W -b html docs docs/_build/html`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))
sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

import pm3dof_pin

project = "pm3dof-pin"
author = "The pm3dof-pin authors"
copyright = f"2026, {author}"
release = version = pm3dof_pin.__version__

extensions = [
    "myst_parser",
    "sphinx_design",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "computed_pictures",
    "examples",
    "machine_tables",
    "mathml",
    "module_pages",
    "plain_docstrings",
]
default_role = "code"
exclude_patterns = ["_build", "extensions", "notebooks"]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3

# cards on other sites need the picture's whole address, which is known where the documentation is hosted
html_baseurl = os.environ.get("READTHEDOCS_CANONICAL_URL", "")
if html_baseurl:
    myst_html_meta = {"property=og:image": f"{html_baseurl.rstrip('/')}/_static/social_card.png"}

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "pm3dof-pin"
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_logo = html_favicon = "static/logo.svg"
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0b5c8a", "color-brand-content": "#0b5c8a"},
    "dark_css_variables": {"color-brand-primary": "#6fb7e0", "color-brand-content": "#6fb7e0"},
}
pygments_style = "friendly"
pygments_dark_style = "native"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
autodoc_type_aliases = {
    name: name
    for name in ("ArrayLike", "Array", "Vector", "Matrix", "Mask", "Indices", "Objects", "OnFailure", "Engine")
}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
