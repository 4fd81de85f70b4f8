"""How Sphinx builds the site: `just docs`, from these pages and from the docstrings, without a network."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src"))
# The tutorial's cells run in a process of their own: they find this checkout and the commands of its environment
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

from cophy import __version__  # noqa: E402 (of this checkout)

project = "cophy"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build"]
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types of other libraries, whose lists of names are on the network

html_theme = "furo"
html_title = f"cophy {__version__}"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_show_copyright = False

# Python: Google style, as in the code
autodoc_member_order = "bysource"
autodoc_inherit_docstrings = False
autodoc_typehints_format = "short"
default_role = "code"  # single backticks in docstrings
napoleon_use_ivar = True

# Markdown: every heading can be linked to; a link that leads nowhere ends the build (-W)
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
myst_links_external_new_tab = True

# The tutorial is executed when it has changed, and a cell that fails ends the build
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "remove"
