"""
Configuration of the documentation's site, which `make docs` and rosdoc2 build.

rosdoc2 runs this file in a copy of the folder, so the package tells where the sources are.
"""

from importlib import import_module
from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
_package = import_module('secure_uav_planner')
_root = Path(_package.__file__).parents[1]
for _name in _package.__all__:
    getattr(_package, _name)  # autodoc documents only what has been imported.

project = 'secure_uav_planner'
author = 'secure_uav_planner maintainers'
project_copyright = f'2026, {author}'
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.viewcode']

autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented'
toc_object_entries_show_parents = 'hide'
myst_enable_extensions = ['colon_fence']
myst_heading_anchors = 3

html_title = project
html_theme_options = {
    'font_family': 'sans-serif', 'page_width': '1200px', 'sidebar_width': '250px'}
html_static_path = [str(_root / 'docs' / '_static')]
html_css_files = ['site.css']


_PARTS = {
    '% README.md': (_root / 'README.md').read_text().replace('](docs/', ']('),
    '.. CHANGELOG.rst': (_root / 'CHANGELOG.rst').read_text(),
    '](../README.md': '](index.md'}


def insert_parts(_app, _page, source):
    """Put the files at the root into pages, and let links to the README lead to its page."""
    for mark, text in _PARTS.items():
        source[0] = source[0].replace(mark, text)


def setup(app):
    """Connect with Sphinx."""
    app.connect('source-read', insert_parts)
