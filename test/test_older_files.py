"""Files that version 0.1.0 wrote or took still load, and mean the same."""

import json
from pathlib import Path
import shutil

from secure_uav_planner import Plan, run_campaign, Scenario
from secure_uav_planner.apps.campaign_file import load_campaign
import yaml

DATA = Path(__file__).parent / 'data'
MISSION = DATA / 'mission_0.1.0.yaml'


def test_a_mission_file_with_every_field_of_0_1_0_has_each_value():
    given, taken = yaml.safe_load(MISSION.read_text()), Scenario.load(MISSION).to_dict()
    given['eavesdroppers'][1] |= {
        'name': 'eavesdropper', 'error_radius': 0.0, 'receiver_advantage_db': 0.0}

    def check(old, new, name):
        if isinstance(old, dict):
            for key, value in old.items():
                check(value, new[key], f'{name}.{key}')
        elif isinstance(old, list):
            assert len(new) == len(old), name
            for number, value in enumerate(old):
                check(value, new[number], f'{name}.{number}')
        else:
            assert new == old, name

    check(given, taken, 'mission')


def test_a_plan_file_of_0_1_0_keeps_its_bound_and_at_least_its_rates():
    file = DATA / 'bounded_plan_0.1.0.json'
    stored, plan = json.loads(file.read_text()), Plan.load(file)
    assert stored['version'] == 2 and plan.scenario == Scenario.load(MISSION)
    assert plan.positions.tolist() == stored['positions']
    assert plan.powers.tolist() == stored['powers']
    assert plan.bound.rate == stored['bound']['rate']
    assert plan.bound.ignored == tuple(stored['bound']['ignored'])
    # Version 0.1.0 counted rates below 0.
    for rate in ('guaranteed_rate', 'worst_case_rate'):
        assert stored[rate] < getattr(plan, rate) < stored[rate] + 0.1


def test_a_campaign_of_0_1_0_has_the_missions_that_it_had_and_goes_on_in_its_folder(tmp_path):
    campaign, journal = DATA / 'campaign_0.1.0.yaml', DATA / 'results_0.1.0.jsonl'
    rows = [json.loads(line) for line in journal.read_text().splitlines()]
    assert [(row['method'], row['fields']) for row in rows] == [
        (task['method'], task['fields']) for task in load_campaign(campaign).tasks()]
    shutil.copy(journal, tmp_path / 'results.jsonl')
    table = run_campaign(campaign, folder=tmp_path, jobs=1)
    assert [*table.outcome] == ['ok'] * len(rows)
    for row, rate in zip(rows, table.guaranteed_rate):
        assert rate > row['guaranteed_rate'] - 1e-4
