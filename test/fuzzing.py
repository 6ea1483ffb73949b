"""
Messages, parameters and calls of every kind, thrown at a running node.

Nodes may refuse anything, but they answer and they live.
"""

from collections import Counter
import math

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion
from hypothesis import given, HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
import numpy as np
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
import rclpy
from secure_uav_planner.ros.messages import message_class

# Messages of every kind; a stamp is a Time, or seconds from when it is sent.

ANY = st.floats()
NUMBER = st.one_of(st.floats(-1000, 1000), st.floats(-1000, 1000), ANY)
TEXT = st.one_of(
    st.sampled_from(['map'] * 6 + ['', 'odom', '/map', 'map ', 'x' * 5000]),
    st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20))
STAMP = st.one_of(
    st.sampled_from([0.0, 0.0, 0.0, -5.0, 5.0, -100.0, 1e6]),
    st.builds(Time, sec=st.sampled_from([0, 1, -1, -2**31, 2**31 - 1]),
              nanosec=st.sampled_from([0, 1, 10**9, 2**32 - 1])))
COVARIANCE = st.one_of(
    st.just(np.zeros(36)), st.floats(0, 400).map(lambda value: np.eye(6).ravel() * value),
    ANY.map(lambda value: np.full(36, value)),
    st.lists(ANY, min_size=36, max_size=36).map(np.array))
VALUES = {
    'double': NUMBER, 'string': TEXT, 'octet': st.binary(min_size=1, max_size=1),
    'int32': st.integers(-9, 9), 'uint32': st.integers(0, 9),
    'double[36]': COVARIANCE, 'builtin_interfaces/Time': st.builds(Time),
    'geometry_msgs/Quaternion': st.one_of(
        st.just(Quaternion(w=1.0)), st.builds(Quaternion, x=ANY, y=ANY, z=ANY, w=ANY))}


def values_of_type(name):
    """Return a strategy of values of a field by its type, most of them not far from sensible."""
    if name in VALUES:
        return VALUES[name]
    if name.startswith('sequence<'):
        item = name.removeprefix('sequence<').removesuffix('>')
        return st.lists(values_of_type(item), max_size=5)
    return messages_of(message_class(name))


def messages_of(kind):
    """Return a strategy of messages of a type."""
    return st.builds(kind, **{field: values_of_type(name) for field, name in (
        kind.get_fields_and_field_types().items())})


# Parameters of every kind: (name, ParameterValue).

WILD = st.one_of(
    st.one_of(st.none(), st.booleans(), st.integers(-2**63, 2**63 - 1), ANY, TEXT,
              st.lists(ANY, max_size=4), st.lists(st.integers(-9, 9), max_size=3),
              st.lists(TEXT, max_size=3), st.lists(st.booleans(), max_size=3),
              st.binary(max_size=3).map(lambda text: [bytes([byte]) for byte in text])
              ).map(lambda value: rclpy.Parameter('any', value=value).get_parameter_value()),
    st.builds(ParameterValue, type=st.integers(0, 9)))
PLACE = st.lists(st.floats(-500, 500), min_size=2, max_size=2)


def parameter(name, value):
    return rclpy.Parameter(name, value=value).to_parameter_msg()


def parameter_sets(near, names):
    """Return strategies of lists of Parameters, most of one, some of several."""
    good = st.sampled_from(sorted(near)).flatmap(
        lambda name: near[name].map(lambda value: parameter(name, value)))
    wild = st.builds(Parameter, name=st.one_of(st.sampled_from(names), TEXT), value=WILD)
    either = st.one_of(good, good, wild).filter(
        # Simulated time would stop the clock that the fuzz itself reads; with a delay plans start
        # where nobody has been.
        lambda made: made.name not in ('use_sim_time', 'plan_file', 'start_delay'))
    return st.lists(either, min_size=1, max_size=3)


class Target:
    """
    A node under test: sends messages, asks services and checks that the node still runs.

    :param topics: kinds of messages by topic.
    :ivar counts: of what was sent and how it was answered.
    """

    def __init__(self, client, node, process, topics, qos=10):
        self.client, self.node, self.process = client, node, process
        self.topics, self._qos, self.counts = topics, qos, Counter()

    def send(self, topic, message, stamp):
        if not isinstance(stamp, Time):
            now = self.client.node.get_clock().now().nanoseconds + round(stamp * 1e9)
            stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
        for header in [getattr(message, 'header', None),
                       *(pose.header for pose in getattr(message, 'poses', []))]:
            if header is not None:
                header.stamp = stamp
        self.publish(topic, message)
        self.counts['messages'] += 1

    def publish(self, topic, message):
        self.client.publisher(type(message), topic, self._qos).publish(message)

    publish_with_rest = publish

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

    def check_abnormal(self, service):
        """Send abnormal messages on all topics: each is told at most once, calls are answered."""
        count, before = 0, len(self.process.lines)
        for topic, kind in self.topics.items():
            for what, message in abnormal(kind).items():
                count += 1
                for _ in range(3):
                    self.publish_with_rest(topic, message)
                answer = self.ask(*service).message
                assert answer and len(answer) < 2000, (topic, what)
        lines = self.process.lines[before:]
        told = [line for line in lines if '[WARN' in line and 'is not ' in line
                and 'no new plan' not in line]
        assert len(told) <= count, told
        assert max(map(len, lines), default=0) < 1000
        assert not any('[ERROR' in line for line in lines), lines


ROUNDS = 40  # At most, for a node that refuses everything.


def fuzz(target, calls, parameters, examples, chance, **least):
    """
    Do lists of actions, round after round until all counts of the target reach what is the least.

    A running node has a history, so examples are not shrunk.

    :param calls: names of methods of the target without arguments.
    :param examples: how many lists a round has.
    :param chance: a random.Random that the actions come from.
    """
    message = st.sampled_from(sorted(target.topics)).flatmap(lambda topic: st.tuples(
        st.just(topic), messages_of(target.topics[topic]), STAMP))
    actions = st.one_of(
        *[st.tuples(st.just('burst'), st.lists(message, min_size=5, max_size=20))] * 2,
        st.tuples(st.just('change'), parameters, st.booleans()),
        st.sampled_from([(name,) for name in calls]))
    for _ in range(ROUNDS):
        @seed(chance.getrandbits(64))
        @settings(max_examples=examples, deadline=None, database=None,
                  phases=[Phase.explicit, Phase.generate],
                  suppress_health_check=list(HealthCheck))
        @given(st.lists(actions, min_size=4, max_size=12))
        def run(drawn):
            for name, *arguments in drawn:
                if name == 'burst':
                    for sent in arguments[0]:
                        target.send(*sent)
                else:
                    getattr(target, name)(*arguments)
            target.check()
        run()
        if all(target.counts[what] >= number for what, number in least.items()):
            return
    raise AssertionError(f'it was not enough after {ROUNDS} rounds of {examples} lists of actions')


# Abnormal messages of any type, for the topics of a node.


def abnormal(kind):
    """Return abnormal messages of a type by what is wrong with them."""
    return {'empty': kind(), 'not finite': build(kind, math.nan, '', 3),
            'unlike frames': build(kind, 0.0, 'elsewhere', 3),
            'wrong sizes': build(kind, 0.0, 'name', 1),
            'huge': build(kind, 1e300, '', 30_000)}


def build(kind, number, text, count):
    """Return a message with the same number, the same text and lists of the same length."""
    def value(name, count):
        if name.startswith('sequence<'):
            item = name.removeprefix('sequence<').removesuffix('>')
            return [value(item, 1)] * count
        if '/' in name:
            return build(message_class(name), number, text, count)
        return {'double': number, 'double[36]': np.full(36, number), 'string': text,
                'octet': b'\0'}.get(name, 0)
    return kind(**{field: value(name, count)
                   for field, name in kind.get_fields_and_field_types().items()})
