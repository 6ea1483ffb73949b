"""The seeds of the fuzzer, and what it has found, are read or refused."""

from parsers import CORPUS, READERS
import pytest
from secure_uav_planner.errors import PlanningError

SEEDS = sorted(CORPUS.glob('*/*'))


def test_every_parser_has_seeds_and_every_seed_a_parser():
    assert {seed.parent.name for seed in SEEDS} == set(READERS)


@pytest.mark.parametrize('seed', SEEDS, ids=lambda seed: '/'.join(seed.parts[-2:]))
def test_a_seed_is_read_and_what_the_fuzzer_found_is_read_or_refused(seed, tmp_path):
    file = tmp_path / seed.parent.name
    file.write_bytes(seed.read_bytes())
    try:
        READERS[file.name](file)
    except PlanningError:
        assert seed.name.startswith('found')
