"""The documentation as a site: it is built without a warning and leaves nothing out."""

from html.parser import HTMLParser
import re
import subprocess

from environments import build_wheel, make_environment, OUTSIDE
from processes import ROOT
import pytest
import secure_uav_planner
from secure_uav_planner import errors

pytestmark = pytest.mark.slow


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
def folder(tmp_path_factory):
    """Return the folder in which the site has been built, with only what `make docs` has."""
    folder = tmp_path_factory.mktemp('site')
    python = make_environment('docs', build_wheel(folder), folder / 'venv')
    result = subprocess.run(
        [python, '-m', 'sphinx', '-q', '-W', '--keep-going', '-b', 'html',
         '-d', str(folder / 'doctrees'), str(ROOT / 'docs'), str(folder / 'html')],
        capture_output=True, text=True, timeout=600, env=OUTSIDE)
    assert result.returncode == 0, result.stdout + result.stderr
    return folder / 'html'


@pytest.fixture(scope='module')
def site(folder):
    """Return the pages of the site by their file names."""
    return {str(file.relative_to(folder)): Page(file)
            for file in (*folder.glob('*.html'), *folder.glob('gallery/*.html'))}


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    pytest.importorskip('selenium')
    from test_page import browser_in
    with browser_in(tmp_path_factory.mktemp('browser')) as driver:
        yield driver


@pytest.mark.parametrize('width', [360, 1024, 1920])
def test_no_page_table_or_formula_is_wider_than_the_screen(browser, folder, site, width):
    browser.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', {
        'width': width, 'height': 900, 'deviceScaleFactor': 1, 'mobile': False})
    for name in sorted(site):
        browser.get((folder / name).as_uri())
        assert browser.execute_script('return window.innerWidth') == width
        assert browser.execute_script(
            'return document.documentElement.scrollWidth') <= width, name
        assert not browser.execute_script(
            'return [...document.querySelectorAll(".table-wrapper, div.math")]'
            '.filter(one => one.scrollWidth > one.clientWidth + 1)'
            '.map(one => one.textContent.slice(0, 80))'), name


def test_formulas_are_typeset_without_a_script_and_nothing_is_loaded_from_elsewhere(folder):
    text = (folder / 'model.html').read_text()
    assert text.count('<math') > 20 and '$' not in re.sub('(?s)<pre>.*?</pre>', '', text)
    for page in folder.glob('*.html'):
        assert not re.search('(src|<link[^>]*href)="(https?:)?//', page.read_text()), page.name


def test_every_page_is_in_the_site_and_in_its_table_of_contents(site):
    names = {str(file.relative_to(ROOT / 'docs').with_suffix('.html'))
             for file in (ROOT / 'docs').rglob('*') if file.suffix in ('.md', '.rst')}
    assert names <= set(site)
    assert names - {'index.html'} <= site['index.html'].links


def test_the_gallery_has_a_picture_of_every_page(folder, site):
    for name, page in site.items():
        if name.startswith('gallery/') and 'index' not in name:
            pictures = [link for link in page.links if link.endswith('.png')]
            assert pictures, name
            for link in pictures:
                assert (folder / 'gallery' / link).read_bytes().startswith(b'\x89PNG')


def test_the_api_documents_every_public_name_and_every_error(site):
    documented = site['api.html'].anchors
    for name in secure_uav_planner.__all__:
        places = 'secure_uav_planner', 'secure_uav_planner.errors'
        assert any(f'{place}.{name}' in documented for place in places), name
    for name, kind in vars(errors).items():
        if isinstance(kind, type) and issubclass(kind, errors.PlanningError):
            assert f'secure_uav_planner.errors.{name}' in documented
