"""How Sphinx builds the site: `just docs`, from these pages and from the docstrings, without a network."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src"))
# The tutorial's cells run in a process of their own, in the root of the checkout.
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))

project = "cophy"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = "cophy"

# Python: Google style, as in the code
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_use_ivar = True

# Markdown: every heading can be linked to; a link that leads nowhere ends the build (-W)
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
myst_links_external_new_tab = True

# The tutorial is executed by tests/test_readme.py; the site shows what its cells printed then
nb_execution_mode = "off"
suppress_warnings = ["config.cache"]
