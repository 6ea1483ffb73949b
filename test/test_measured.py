"""The measured numbers of the pages are those that a run gives today."""

from pathlib import Path
import re

from benchmarks import __main__ as bench
from docs.tools import measured
import pytest
import secure_uav_planner
from studies import paper as study

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
RATE = re.compile(r'-?\d+\.\d{4}\b(?! s\b)')  # In bit/s/Hz; times depend on the machine.


def written():
    """Return the tables of the pages by name."""
    return {block[2]: block[0] for page in measured.PAGES
            for block in measured.BLOCK.finditer((ROOT / page).read_text(encoding='utf-8'))}


def assert_current(name, computed, pattern=RATE, tolerance=1e-3):
    """Compare the numbers of a table in a page with those of today, and all the words."""
    known, found = written()[name], f'{computed}'
    assert [float(number) for number in pattern.findall(found)] == pytest.approx(
        [float(number) for number in pattern.findall(known)], abs=tolerance), (
        f'write {name} anew: make numbers')
    rows = [line for line in known.splitlines() if line.startswith('|')]
    assert [line.split('|')[1] for line in rows[1:]] == [
        line.split('|')[1] for line in found.splitlines()[1:]]


@pytest.mark.parametrize('name, compute', [
    ('rates', lambda: measured.rates(proof=0.5)), ('objectives', measured.objectives),
    ('methods', measured.methods)])
def test_a_table_of_rates_is_that_of_today(name, compute):
    assert_current(name, compute())


@pytest.mark.soak
def test_the_claims_are_those_of_the_study_of_today(tmp_path):
    assert study.main(['--out', str(tmp_path)]) == 0
    claims = '\n'.join(line for line in (tmp_path / 'claims.md').read_text().splitlines()
                       if line.startswith('|'))
    assert_current('claims', claims, re.compile(r'\d\.\d{3}\b'), 2e-3)


def test_the_speed_is_that_of_this_version():
    assert f'with version {secure_uav_planner.__version__},' in written()['speed']
    for duration, radius, _ in bench.PAPER:
        assert f'T = {duration:g} s, radius {radius:g} m' in written()['speed']


def test_every_table_has_its_place_and_a_stale_one_is_found_and_renewed():
    assert set(written()) == set(measured.TABLES)
    text = (ROOT / 'README.md').read_text(encoding='utf-8')
    stale = measured.renewed(text, {'rates': '| scheme |\n| --- |\n| other | 9.9999 |'})
    assert '9.9999' in stale and '3.0577' not in stale
    assert measured.renewed(stale, {'rates': '\n'.join(
        line for line in written()['rates'].splitlines() if line.startswith('|'))}) == text
    with pytest.raises(AssertionError, match='make numbers'):
        assert_current('rates', '| this planner | 9.9999 |')
