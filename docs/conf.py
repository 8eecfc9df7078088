"""How the site is built (`make docs`). Its source is the repository, so links stay as read."""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent / "_ext")]

import osc_contact  # noqa: E402

project = "osc_contact"
author = "The osc_contact developers"
project_copyright = author
release = version = osc_contact.__version__

root_doc = "docs/index"
include_patterns = ["*.md", "docs/*.md", "docs/api/*.rst", "notebooks/*.py"]
exclude_patterns = [
    ".*",
    "out",
    "build",
    "dist",
    "osc_contact",
    "tests",
    "urdf",
    "paper",
    "benchmarks",
]
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docstrings",
    "glossary",
    "law_lines",
    "mathml",
    "notebooks",
    "pairs",
    "scenario_keys",
    "try_it",
    "typesetting",
]
nitpicky = True
nitpick_ignore_regex = [
    ("py:class", r"(npt\.)?(Array|ArrayLike)|TypeAliasForwardRef"),
    ("py:class", r"(Force|Motion|Structure)Command|Block"),
    ("py:class", r"FieldInfo|NoneType|Outward|(Body)?(Point|Direction)"),  # of pairs' fields
    ("py:class", r"Radius|Extent|Angle|Field|pi"),  # likewise
    ("py:class", r"(pin\.)?(SE3|Inertia|Model|Data)|Path|Sequence|Callable|Mapping|Any"),
    ("py:class", r"(numpy|pinocchio|coal|enum|os|pathlib|collections|typing)\..*"),
    ("py:class", r"MjcfSource|Mj(Model|Data)|Progress|Design|ArmOptions"),
    ("py:class", r"(np|npt|pyarrow|distributed)\..*"),
    ("py:class", r"osc_contact\..*"),  # types in signatures that have no page
    ("py:obj", r".*"),  # arguments and formulas stand between single backticks too
]

# Pages: Markdown. Equations are set when the site is built, as MathML: no script, no network.
# What stands in a line is Unicode, as in the code.
myst_enable_extensions = ["colon_fence", "dollarmath"]
html_math_renderer = "mathml"
myst_heading_anchors = 4

# API: Google docstrings, names as users write them.
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_type_aliases = {"Array": "Array", "npt.ArrayLike": "ArrayLike", "Outward": "ArrayLike"}
autodoc_type_aliases |= dict.fromkeys(("Direction", "Place", "Points"), "ArrayLike")
for quantity in ("Angle", "Force", "Frequency", "Length", "Number", "Time", "Torque"):
    autodoc_type_aliases[quantity] = "float"
for quantity in ("Velocity", "AngularVelocity", "Radius", "Extent"):
    autodoc_type_aliases[quantity] = "float"
autodoc_default_options = {"members": True}
autoclass_content = "both"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
napoleon_use_rtype = False
python_use_unqualified_type_names = True
maximum_signature_line_length = 80
add_module_names = False
default_role = "py:obj"

# Look: furo, system fonts; nothing is fetched from anywhere.
html_theme = "furo"
html_title = "osc_contact"
html_extra_path = ["_site"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
