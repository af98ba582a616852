"""The documentation as a site: ``make docs`` builds it, without network access."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))
os.environ.setdefault("MPLBACKEND", "agg")

import rtin

project = "rtin"
author = "The rtin developers"
copyright = author  # noqa: A001  (Sphinx wants this name)
version = release = rtin.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "benchmark_figures",
    "mathml",
    "repository_links",
]
exclude_patterns = ["_build", "gallery"]
nitpicky = False
numfig = False
suppress_warnings = ["config.cache"]  # sphinx-gallery's settings hold objects

# --- pages ---------------------------------------------------------------------------------------

myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

# --- the reference -------------------------------------------------------------------------------

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units as well
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

# --- the gallery ---------------------------------------------------------------------------------

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "auto_gallery",
    "backreferences_dir": "auto_gallery/backreferences",
    "filename_pattern": r"/plot_",
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 5,
    "remove_config_comments": True,
    "abort_on_example_error": True,
    "plot_gallery": "True",
    "matplotlib_animations": (True, "html5"),
    "reset_modules": ("matplotlib", "gallery_films.find_ffmpeg"),
    "image_scrapers": ("matplotlib",),
    "write_computation_times": False,
    "show_signature": False,
}

# --- the looks -----------------------------------------------------------------------------------

html_theme = "furo"
html_title = "rtin"
html_theme_options = {"light_css_variables": {"code-font-size": "76%"}}  # for 90 columns
html_static_path: list[str] = []
html_show_sphinx = False
html_copy_source = False
