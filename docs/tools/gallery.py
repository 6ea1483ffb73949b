"""
The pictures of the gallery, each drawn by the programs of its page.

`python -m docs.tools.gallery` draws those of all pages, or of the pages that it is told. A picture
carries, as its description, the programs and what they print.
"""

import argparse
from collections.abc import Sequence
import os
from pathlib import Path
import re
import subprocess
import sys
import tempfile

from .png import save_png

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / 'docs' / 'gallery').glob('[!i]*.md'))
BLOCK = re.compile('^```(python|text)\n(.*?)^```', re.DOTALL | re.MULTILINE)


def main(argv: Sequence[str] | None = None) -> int:
    """Draw the pictures of pages; return the exit status."""
    names = [page.stem for page in PAGES]
    parser = argparse.ArgumentParser(prog='python -m docs.tools.gallery', description=__doc__)
    parser.add_argument('pages', nargs='*', metavar='PAGE',
                        help=f'pages to draw, by default all: {", ".join(names)}')
    chosen = parser.parse_args(argv).pages or names
    if unknown := sorted({*chosen} - {*names}):
        parser.error(f'there is no page {unknown[0]}')
    for page in PAGES:
        if page.stem in chosen:
            draw_pictures(page)
    return 0


def draw_pictures(page: Path) -> None:
    """Run the programs of a page, and put the pictures that it shows beside it."""
    with tempfile.TemporaryDirectory() as folder:
        programs = [text for kind, text in BLOCK.findall(page.read_text()) if kind == 'python']
        subprocess.run([sys.executable, '-c', '\n'.join(programs)], cwd=folder, check=True,
                       stdout=subprocess.DEVNULL, env={**os.environ, 'PYTHONPATH': str(ROOT)})
        for name in list_pictures(page):
            save_png(Path(folder, name), page.with_name(name), describe_page(page))


def list_pictures(page: Path) -> list[str]:
    """Return the names of the pictures that a page shows."""
    return re.findall(r'!\[[^\]]*\]\((\S+\.png)\)', page.read_text())


def describe_page(page: Path) -> str:
    """Return the programs of a page and what they print."""
    return '\n'.join(text for _, text in BLOCK.findall(page.read_text()))


if __name__ == '__main__':
    sys.exit(main())
