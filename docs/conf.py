"""
Configuration of the documentation's site, which `make docs` and rosdoc2 build.

rosdoc2 runs this file in a copy of the folder, so the package tells where the sources are.
"""

from importlib import import_module
from pathlib import Path
import sys

from docutils import nodes
from docutils.nodes import SkipNode
from latex2mathml.converter import convert

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
_package = import_module('secure_uav_planner')
_root = Path(_package.__file__).parents[1]

project = 'secure_uav_planner'
author = 'secure_uav_planner maintainers'
project_copyright = f'2026, {author}'
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.viewcode']

autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented_params'
toc_object_entries_show_parents = 'hide'
myst_enable_extensions = ['colon_fence', 'dollarmath']
html_math_renderer = 'mathml'
myst_heading_anchors = 3

html_title = project
html_theme = 'furo'
html_static_path = [str(_root / 'docs' / '_static')]
html_css_files = ['site.css']


_SOURCES = 'https://github.com/secure-uav-planner/secure_uav_planner/blob/main'
_PARTS = {
    '% README.md': (_root / 'README.md').read_text().replace('](docs/', ']('),
    '.. CHANGELOG.rst': (_root / 'CHANGELOG.rst').read_text(),
    '](../README.md': '](index.md', '](studies/': f']({_SOURCES}/studies/',
    **{f'](../{folder}/': f']({_SOURCES}/{folder}/' for folder in ('studies', 'examples')}}


def insert_parts(_app, _page, source):
    """Put the files at the root into pages, and let links to the README lead to its page."""
    for mark, text in _PARTS.items():
        source[0] = source[0].replace(mark, text)


def label_cells(_app, doctree, _page):
    """
    Put its column's heading into each cell of tables that may be wider than a screen.

    site.css then stacks the cells: of `long` ones on a phone, of `wide` ones on a tablet, too.
    """
    for table in doctree.findall(nodes.table):
        rows = [list(row.findall(nodes.entry)) for row in table.findall(nodes.row)]
        columns = [[entry.astext() for entry in column] for column in zip(*rows)]
        words = sum(max(len(word) for text in column for word in text.split() or [''])
                    for column in columns)
        if words > 65:
            table['classes'].append('wide')
        elif sum(max(map(len, column)) for column in columns) > 36:
            table['classes'].append('long')
        else:
            continue
        for row in rows[1:]:
            for head, entry in zip(rows[0], row):
                if head.astext() and entry.children:
                    entry[0].insert(0, nodes.inline(
                        '', f'{head.astext()}: ', classes=['heading']))


def write_inline(translator, node):
    """Write a formula as MathML, which browsers show without a script."""
    translator.body.append(convert(node.astext()))
    raise SkipNode


def write_block(translator, node):
    """Write a formula in a line of its own."""
    translator.body.append(
        f'<div class="math">{convert(node.astext(), display="block")}</div>\n')
    raise SkipNode


def setup(app):
    """Connect with Sphinx."""
    app.connect('source-read', insert_parts)
    app.connect('doctree-resolved', label_cells)
    app.add_html_math_renderer('mathml', (write_inline, None), (write_block, None))
