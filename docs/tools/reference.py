"""
The reference of topics, services, parameters and the status.

`python -m docs.tools.reference docs` puts it into the page of each node.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from secure_uav_planner.output.autopilots import REFERENCES, STACKS
from secure_uav_planner.ros.parameters import (
    PLANNER, read_specs, RELAY, REPLAY, Spec)
from secure_uav_planner.ros.planner_status import list_keys
from secure_uav_planner.ros.topics import SENSOR, SERVICES, STREAM, TOPICS


class Interface(NamedTuple):
    """A topic or service of a node."""

    node: str
    direction: str
    name: str
    kind: str
    qos: str
    meaning: str


def interfaces() -> list[Interface]:
    """Return each Interface of the nodes; the relay's depend on its parameter `stack`."""
    rows = [Interface(
        node, direction, name, f'{topic.kind.__module__.split(".")[0]}/msg/{topic.kind.__name__}',
        describe_qos(topic.qos), topic.meaning)
        for (node, direction), topics in TOPICS.items() for name, topic in topics.items()]
    rows += [Interface(node, 'srv', name, f'std_srvs/srv/{service.kind.__name__}', '',
                       service.meaning) for (node, name), service in SERVICES.items()]
    for name, stack in STACKS.items():
        rows += [Interface('relay', 'pub', f'<vehicle>/{topic}', f'{stack.package}/msg/{kind}',
                           describe_qos(STREAM), f'with `stack` {name}')
                 for kind, topic in stack.topics.items()]
        rows += [Interface('relay', 'sub', f'<vehicle>/{topic}', kind.replace('/', '/msg/'),
                           describe_qos(SENSOR), f'with `stack` {name}: where the vehicle is')
                 for kind, topic in stack.states.items()]
    rows += [Interface(node, 'sub', f'{member}/{topic}', source.kind.replace('/', '/msg/'),
                       f'{describe_qos(SENSOR)}; and latched',
                       f'with `<uav>.reference` {name}: where the local frame of the vehicle '
                       'begins')
             for node, member in (('planner', '<uav>'), ('relay', '<vehicle>'))
             for name, source in REFERENCES.items() for topic in source.topics]
    return rows


def specs() -> dict[str, dict[str, Spec]]:
    """Return the Spec of each parameter of each node by name; `<uav>` stands for any UAV."""
    members = {**read_specs('uav', '<uav>'), **read_specs('ground_node', '<ground_node>'),
               **read_specs('eavesdropper', '<eavesdropper>'),
               **read_specs('no_fly_zone', '<zone>')}
    return {'planner': {**PLANNER, **members}, 'replay': REPLAY,
            'relay': {**RELAY, **read_specs('relay_uav', '<uav>')}}


def markdown() -> dict[str, str]:
    """Return the reference of each node by its name, as Markdown."""
    pages = {}
    for node, parameters in specs().items():
        lines = ['## Topics and services', '',
                 '| | name | type | QoS | meaning |', '| --- | --- | --- | --- | --- |']
        lines += [f'| {row.direction} | `{row.name}` | {row.kind} | {row.qos} | {row.meaning} |'
                  for row in interfaces() if row.node == node]
        lines += ['', '## Parameters', '',
                  '| name | default | allowed | meaning |', '| --- | --- | --- | --- |']
        shared = [] if node == 'planner' else [
            name for name, spec in parameters.items() if spec == specs()['planner'].get(name)]
        lines += [f'| `{name}` | {_default(name, spec)} | {spec.allowed} | {spec.description}'
                  f'{" Set at start only." if spec.read_only else ""} |'
                  for name, spec in parameters.items() if name not in shared]
        if shared:
            lines += ['', f'{", ".join(f"`{name}`" for name in shared)} are as those of the '
                      '[planner](planner.md#parameters).']
        if node == 'planner':
            lines += ['', '## Status', '', 'The values in `~/status`:', '',
                      '| key | meaning |', '| --- | --- |']
            lines += [f'| `{key}` | {meaning} |' for key, meaning in list_keys()]
        pages[node] = '\n'.join(lines)
    return pages


def split_page(text: str) -> tuple[str, str, str]:
    """Return the text of a page before, inside and after its generated part."""
    before, begin, rest = text.partition('<!-- generated -->\n')
    inside, end, after = rest.partition('<!-- end of generated -->')
    return before + begin, inside, end + after


def describe_qos(qos: QoSProfile) -> str:
    """Return a quality of service in words."""
    reliable = qos.reliability != ReliabilityPolicy.BEST_EFFORT
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return (f'{"reliable" if reliable else "best effort"}, '
            f'{"transient local" if latched else "volatile"}, depth {qos.depth}')


def _default(name: str, spec: Spec) -> str:
    jammer = read_specs('uav', '<uav>', 1).get(name, spec)
    return f'`{spec.default!r}`' + (
        '' if jammer.default == spec.default else f', of the others `{jammer.default!r}`')


def main() -> None:
    """Update the pages of the nodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path, help='with a page for each node, such as planner.md')
    folder = parser.parse_args().folder
    for node, text in markdown().items():
        page = folder / f'{node}.md'
        before, _, after = split_page(page.read_text())
        page.write_text(f'{before}{text}\n\n{after}')


if __name__ == '__main__':
    main()
