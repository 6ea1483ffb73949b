"""The layouts for PlotJuggler and Foxglove show what the nodes publish, under the names there."""

import json
import re
from xml.etree import ElementTree

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from processes import ROOT
import pytest
from ros_client import Client, values_of
from ros_nodes import node_process, wait_for, wait_for_line
from std_msgs.msg import Float64

pytestmark = pytest.mark.slow

CONFIG = ROOT / 'config'
STREAMS = {'/diagnostics': DiagnosticArray, '/replay/secrecy_rate': Float64,
           **{f'/uav{number}/setpoint/pose': PoseStamped for number in (1, 2)},
           **{f'/uav{number}/setpoint/power': Float64 for number in (1, 2)}}


def series_of(topic, message):
    """Yield the names and values of a message's numbers, as PlotJuggler names them."""
    if isinstance(message, DiagnosticArray):
        for status in message.status:
            for key, value in values_of(status).items():
                if re.fullmatch(r'-?\d+(\.\d+)?(e[+-]\d+)?', value):
                    yield f'{topic}/{status.hardware_id}/{status.name}/{key}', float(value)
    elif isinstance(message, float):
        yield topic, message
    elif hasattr(message, 'get_fields_and_field_types'):
        for field in message.get_fields_and_field_types():
            yield from series_of(f'{topic}/{field}', getattr(message, field))


@pytest.fixture(scope='module')
def flown():
    """Return the series of a flight that is replayed to the planner, and the planner's status."""
    with Client() as client, node_process('planner', duration=120.0, slots=20), node_process(
            'replay', true_eavesdropper='[200.0, 0.0]') as replay:
        received = {topic: client.listen(kind, topic, 10) for topic, kind in STREAMS.items()}
        client.send_paper()
        assert client.call('planner/plan').success
        wait_for_line(replay, 'got a plan')
        assert client.call('replay/start').success
        wait_for(lambda: client.status.track.rate >= 0.0, what='the rate achieved so far')

        def named():
            return {name for topic, messages in received.items() for message in list(messages)
                    for name, _ in series_of(topic, message)}
        wait_for(lambda: any(name.endswith('track.rate') for name in named()))
        wait_for(lambda: all(received.values()))
        yield named(), client.status


def test_plotjuggler_finds_all_its_series(flown):
    layout = ElementTree.parse(CONFIG / 'plotjuggler.xml').getroot()
    curves = list(layout.iter('curve'))
    wanted = {curve.get(axis) for curve in curves
              for axis in (['curve_x', 'curve_y'] if curve.get('curve_x') else ['name'])}
    assert len(wanted) >= 12 and wanted <= flown[0]
    topics = layout.find('Plugins/plugin/selected_topics').get('value').split(';')
    assert set(topics) == set(STREAMS)
    for name in wanted:
        assert any(name.startswith(f'{topic}/') for topic in topics)


def test_foxglove_finds_all_keys_of_the_status(flown):
    layout = json.loads((CONFIG / 'foxglove.json').read_text())
    keys = {key for panel in layout['configById'].values() for path in panel.get('paths', ())
            for key in re.findall('{key=="(.+?)"}', path['value'])}
    assert keys >= {'track.rate', 'track.planned_rate', 'track.distance.uav1'}
    values = values_of(flown[1].to_message('planner'))
    for key in keys:
        assert float(values[key]) >= 0.0


def test_every_panel_of_foxglove_is_in_its_layout():
    layout = json.loads((CONFIG / 'foxglove.json').read_text())
    placed = re.findall('"([A-Za-z0-9]+![a-z]+)"', json.dumps(layout['layout']))
    assert sorted(placed) == sorted(layout['configById'])
