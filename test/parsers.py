"""What reads a file or the message of a plan, by the name of its folder in `corpus`."""

from pathlib import Path

from secure_uav_planner import (
    Eavesdropper, fly_hover_fly, Origin, Plan, read_flight, read_zones, Scenario, Uav)
from secure_uav_planner.apps.campaign_file import load_campaign
from secure_uav_planner.plan.file import parse_text

CORPUS = Path(__file__).parent / 'corpus'
ORIGIN = Origin(47.4, 8.5)


FLOWN = fly_hover_fly(Scenario(
    ground_node=(0.0, 0.0), eavesdroppers=(Eavesdropper((200.0, 0.0), 10.0),), duration=20.0,
    uavs=(Uav('uav1', (0.0, 0.0), (100.0, 0.0), altitude=50.0, max_speed=10.0),), slots=10))
"""The plan that the logs in the corpus are of."""


def _read_zones(path):
    return read_zones(path, ORIGIN)


def _read_log(path):
    return read_flight({'uav1': path}, FLOWN)


def _read_message(path):
    return parse_text(path.read_bytes().decode(errors='replace'), Plan)


READERS = {
    'mission.yaml': Scenario.load, 'mission.json': Scenario.load, 'campaign.yaml': load_campaign,
    'zones.geojson': _read_zones, 'zones.kml': _read_zones, 'zones.plan': _read_zones,
    'plan.json': Plan.load, 'plan.message': _read_message, 'log.ulg': _read_log,
    'log.bin': _read_log, 'log.tlog': _read_log, 'log.csv': _read_log, 'log.tum': _read_log}
