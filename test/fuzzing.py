"""
Messages, parameters and calls of every kind, thrown at a running node.

Nodes may refuse anything, but they answer and they live.
"""

from collections import Counter
from importlib import import_module
import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from hypothesis import given, HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
import numpy as np
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
import rclpy
from std_msgs.msg import Header

UAVS = ('uav1', 'uav2')

# Messages of every kind; a stamp is a Time, or seconds from when it is sent.

ANY = st.floats()
COORDINATE = st.one_of(st.floats(-1000, 1000), st.floats(-1000, 1000), ANY)
TEXT = st.one_of(
    st.sampled_from(['map'] * 6 + ['', 'odom', '/map', 'map ', 'x' * 5000]),
    st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20))
STAMP = st.one_of(
    st.sampled_from([0.0, 0.0, 0.0, -5.0, 5.0, -100.0, 1e6]),
    st.builds(Time, sec=st.sampled_from([0, 1, -1, -2**31, 2**31 - 1]),
              nanosec=st.sampled_from([0, 1, 10**9, 2**32 - 1])))
POSE = st.builds(
    Pose, position=st.builds(Point, x=COORDINATE, y=COORDINATE, z=COORDINATE),
    orientation=st.one_of(st.just(Quaternion(w=1.0)),
                          st.builds(Quaternion, x=ANY, y=ANY, z=ANY, w=ANY)))
HEADER = st.builds(Header, frame_id=TEXT)
STAMPED = st.builds(PoseStamped, header=HEADER, pose=POSE)

# Parameters of every kind: (name, ParameterValue).

WILD = st.one_of(
    st.one_of(st.none(), st.booleans(), st.integers(-2**63, 2**63 - 1), ANY, TEXT,
              st.lists(ANY, max_size=4), st.lists(st.integers(-9, 9), max_size=3),
              st.lists(TEXT, max_size=3), st.lists(st.booleans(), max_size=3),
              st.binary(max_size=3).map(lambda text: [bytes([one]) for one in text])
              ).map(lambda value: rclpy.Parameter('any', value=value).get_parameter_value()),
    st.builds(ParameterValue, type=st.integers(0, 9)))
PLACE = st.lists(st.floats(-500, 500), min_size=2, max_size=2)


def parameter_sets(near, names):
    """Return strategies of lists of Parameters, most of one, some of several."""
    good = st.sampled_from(sorted(near)).flatmap(lambda name: near[name].map(
        lambda value: Parameter(
            name=name, value=rclpy.Parameter(name, value=value).get_parameter_value())))
    wild = st.builds(Parameter, name=st.one_of(st.sampled_from(names), TEXT), value=WILD)
    one = st.one_of(good, good, wild).filter(
        # Simulated time would stop the clock that the fuzz itself reads; with a delay plans start
        # where nobody has been.
        lambda made: made.name not in ('use_sim_time', 'plan_file', 'start_delay'))
    return st.lists(one, min_size=1, max_size=3)


class Target:
    """
    A node under test: sends messages, asks services and checks that the node still runs.

    :ivar counts: of what was sent and how it was answered.
    """

    def __init__(self, client, node, process):
        self.client, self.node, self.process = client, node, process
        self.counts = Counter()

    def send(self, topic, message, stamp, qos=10):
        if not isinstance(stamp, Time):
            now = self.client.node.get_clock().now().nanoseconds + round(stamp * 1e9)
            stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
        for header in [getattr(message, 'header', None),
                       *(pose.header for pose in getattr(message, 'poses', []))]:
            if header is not None:
                header.stamp = stamp
        self.client.publisher(type(message), topic, qos).publish(message)
        self.counts['messages'] += 1

    def ask(self, service, *kind_and_request):
        self.check_alive()
        answer = self.client.call(f'{self.node}/{service}', *kind_and_request)
        self.check_alive()
        return answer

    def call(self, service):
        answer = self.ask(service)
        assert answer.message
        self.counts[f'{service} {"done" if answer.success else "refused"}'] += 1
        return answer

    def change(self, parameters, atomically=False):
        kind, service = ((SetParametersAtomically, 'set_parameters_atomically') if atomically
                         else (SetParameters, 'set_parameters'))
        answer = self.ask(service, kind, kind.Request(parameters=parameters))
        results = [answer.result] if atomically else answer.results
        assert atomically or len(results) == len(parameters)
        for result in results:
            assert result.successful or result.reason
            self.counts['parameters set' if result.successful else 'parameters refused'] += 1
        self.counts['parameter sets'] += 1

    def check_alive(self):
        assert self.process.poll() is None, ''.join(self.process.lines[-30:])
        assert not any('Traceback' in line for line in self.process.lines), ''.join(
            self.process.lines[-30:])


ROUNDS = 40  # At most, for a node that refuses everything.


def fuzz(actions, act, examples, chance, is_enough):
    """
    Do lists of actions, round after round until it is enough.

    A running node has a history, so examples are not shrunk.

    :param examples: how many lists a round has.
    :param chance: a random.Random that the actions come from.
    :param is_enough: asked after each round.
    """
    for _ in range(ROUNDS):
        @seed(chance.getrandbits(64))
        @settings(max_examples=examples, deadline=None, database=None,
                  phases=[Phase.explicit, Phase.generate],
                  suppress_health_check=list(HealthCheck))
        @given(st.lists(actions, min_size=4, max_size=12))
        def run(found):
            act(found)
        run()
        if is_enough():
            return
    raise AssertionError(f'it was not enough after {ROUNDS} rounds of {examples} lists of actions')


def reached(counts, least):
    """Return what tells whether all counts have reached what is the least."""
    return lambda: all(counts[what] >= number for what, number in least.items())


# Abnormal messages of any type, for the topics of a node.


def abnormal(kind):
    """Return abnormal messages of a type by what is wrong with them."""
    broken = {what: kind() for what in (
        'empty', 'not finite', 'unlike frames', 'wrong sizes', 'huge')}
    fill(broken['not finite'], lambda value: math.nan if isinstance(value, float) else value, 3)
    fill(broken['unlike frames'],
         lambda value: 'elsewhere' if isinstance(value, str) else value, 3)
    fill(broken['wrong sizes'], lambda value: value, 1)
    fill(broken['huge'], lambda value: 1e300 if isinstance(value, float) else value, 30_000)
    return broken


def fill(message, change, count):
    """Change all plain values in a message, after its lists have become so long."""
    for field, kind in message.get_fields_and_field_types().items():
        value = getattr(message, field)
        if kind.startswith('sequence<'):
            kind = kind.removeprefix('sequence<').removesuffix('>')
            if '/' not in kind:
                setattr(message, field, [change(0.0 if kind == 'double' else 'name')] * count)
                continue
            package, _, name = kind.partition('/')
            item = getattr(import_module(f'{package}.msg'), name)()
            fill(item, change, min(count, 3))
            setattr(message, field, [item] * count)
        elif hasattr(value, 'get_fields_and_field_types'):
            fill(value, change, count)
        elif isinstance(value, str) or kind == 'double':
            setattr(message, field, change(value))
        elif isinstance(value, np.ndarray):
            value[:] = [change(float(number)) for number in value]


def check_abnormal(process, publish, topics, call):
    """
    Send abnormal messages on topics; fail unless each is told at most once and calls are answered.

    :param publish: sends a message on a topic.
    :param topics: types by name.
    :param call: calls a service of the node, and returns its answer.
    """
    count, before = 0, len(process.lines)
    for topic, kind in topics.items():
        for what, message in abnormal(kind).items():
            count += 1
            for _ in range(3):
                publish(topic, message)
            answer = call().message
            assert answer and len(answer) < 2000, (topic, what)
    lines = process.lines[before:]
    told = [line for line in lines if '[WARN' in line and any(
        topic.partition('/')[0] in line for topic in topics) and 'no new plan' not in line]
    assert len(told) <= count, told
    assert process.poll() is None and max(map(len, lines), default=0) < 1000
    assert not any('[ERROR' in line or 'Traceback' in line for line in lines), lines
