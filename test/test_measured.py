"""The measured numbers of the pages are those that a run gives today."""

import re

from benchmarks import __main__ as bench
from docs.tools import gallery, measured
from processes import ROOT
import pytest
from secure_uav_planner import Scenario, solve
from secure_uav_planner.mission.formats.mission_file import EXAMPLE
from studies import paper as study

pytestmark = pytest.mark.slow

RATE = re.compile(r'-?\d+\.\d{4}\b(?! s\b)')  # In bit/s/Hz; times depend on the machine.


def written():
    """Return the tables of the pages by name."""
    return {block[2]: block[0] for page in measured.PAGES
            for block in measured.BLOCK.finditer(page.read_text(encoding='utf-8'))}


def assert_current(name, computed, pattern=RATE, tolerance=1e-3):
    """Compare the numbers of a table in a page with those of today, and all the words."""
    block = written()[name]
    assert [float(number) for number in pattern.findall(computed)] == pytest.approx(
        [float(number) for number in pattern.findall(block)], abs=tolerance), (
        f'write {name} anew: make numbers')
    rows = [line for line in block.splitlines() if line.startswith('|')]
    assert [line.split('|')[1] for line in rows[1:]] == [
        line.split('|')[1] for line in computed.splitlines()[1:]]


@pytest.mark.parametrize('name, measure', [
    ('rates', lambda folder: measured.measure_rates(folder, proof=0.5)),
    ('city', measured.measure_city), ('objectives', measured.measure_objectives),
    ('methods', measured.measure_methods)])
def test_a_table_of_rates_is_that_of_today(name, measure, tmp_path):
    table = measure(tmp_path)
    assert_current(name, table)
    for picture in tmp_path.iterdir():
        assert table.encode() in picture.read_bytes()


@pytest.mark.parametrize('picture', measured.PICTURES)
def test_a_picture_is_of_the_run_of_its_table_and_loads_fast(picture):
    content = (measured.DOCS / picture).read_bytes()
    table = '\n'.join(line for line in written()[measured.PICTURES[picture]].splitlines()
                      if line.startswith('|'))
    assert content.startswith(b'\x89PNG') and table.encode() in content
    assert len(content) < 150_000


@pytest.mark.parametrize('page', gallery.PAGES, ids=lambda page: page.stem)
def test_the_pictures_of_a_page_of_the_gallery_are_of_its_programs_and_of_what_they_print(page):
    assert gallery.list_pictures(page)
    for name in gallery.list_pictures(page):
        content = page.with_name(name).read_bytes()
        assert content.startswith(b'\x89PNG')
        assert gallery.describe_page(page).encode() in content, (
            f'draw it anew: python -m docs.tools.gallery {page.stem}')
        assert len(content) < 150_000


def test_the_pictures_of_explore_show_the_rates_of_today():
    plan = solve(Scenario.load(EXAMPLE))
    for name in ('explore-1', 'explore-6'):
        content = (measured.DOCS / f'{name}.png').read_bytes()
        for rate in (plan.worst_case_rate, plan.guaranteed_rate):
            assert f'{rate:.3f}'.encode() in content, (
                'draw them anew: python -m docs.tools.screens')


@pytest.mark.soak
def test_the_claims_are_those_of_the_study_of_today(tmp_path):
    assert study.main(['--out', str(tmp_path)]) == 0
    claims = measured.copy_claims(tmp_path, tmp_path)
    assert_current('claims', claims, re.compile(r'\d\.\d{3}\b'), 2e-3)


def test_the_speed_says_which_version_had_it_and_is_of_the_missions_of_today():
    [measured_version] = re.findall('with version (.*?),', written()['speed'])
    assert f'\n{measured_version} (' in (ROOT / 'CHANGELOG.rst').read_text()
    for duration, radius, _ in bench.PAPER:
        assert f'T = {duration:g} s, radius {radius:g} m' in written()['speed']


def test_each_table_has_its_place_and_a_stale_table_is_rejected_and_replaced():
    assert set(written()) == set(measured.TABLES)
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    stale = measured.replace_tables(text, {'rates': '| scheme |\n| --- |\n| other | 9.9999 |'})
    assert '9.9999' in stale and '3.0577' not in stale
    assert measured.replace_tables(stale, {'rates': '\n'.join(
        line for line in written()['rates'].splitlines() if line.startswith('|'))}) == text
    with pytest.raises(AssertionError, match='make numbers'):
        assert_current('rates', '| this planner | 9.9999 |')
