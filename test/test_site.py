"""The documentation as a site: it is built without a warning and leaves nothing out."""

from html.parser import HTMLParser
from pathlib import Path
import subprocess
import sys

import pytest
import secure_uav_planner
from secure_uav_planner import errors

ROOT = Path(__file__).resolve().parents[1]


class Page(HTMLParser):
    """The anchors and the links of a page."""

    def __init__(self, file):
        super().__init__()
        self.anchors, self.links = set(), set()
        self.feed(file.read_text())

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        if 'id' in found:
            self.anchors.add(found['id'])
        link = found.get('href' if tag == 'a' else 'src')
        if link and '://' not in link and not link.startswith(('mailto:', 'data:')):
            self.links.add(link)


@pytest.fixture(scope='module')
def site(tmp_path_factory):
    """Return the pages of the site by their file names."""
    folder = tmp_path_factory.mktemp('site')
    result = subprocess.run(
        [sys.executable, '-m', 'sphinx', '-q', '-W', '--keep-going', '-b', 'html',
         '-d', str(folder / 'doctrees'), str(ROOT / 'docs'), str(folder / 'html')],
        capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stdout + result.stderr
    return {file.name: Page(file) for file in (folder / 'html').glob('*.html')}


def test_every_page_is_in_the_site_and_in_its_table_of_contents(site):
    names = {f'{file.stem}.html' for file in (ROOT / 'docs').iterdir()
             if file.suffix in ('.md', '.rst')}
    assert names <= set(site)
    assert names - {'index.html'} <= site['index.html'].links


def test_every_link_inside_the_site_leads_somewhere(site):
    for name, page in site.items():
        for link in page.links:
            target, _, anchor = link.partition('#')
            if target.endswith('.html') and '/' not in target or not target:
                other = site[target or name]
                assert not anchor or anchor in other.anchors, f'{name}: {link}'


def test_the_api_documents_every_public_name_and_every_error(site):
    documented = site['api.html'].anchors
    for name in secure_uav_planner.__all__:
        assert f'secure_uav_planner.{name}' in documented
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, errors.PlanningError):
            assert f'secure_uav_planner.errors.{name}' in documented
