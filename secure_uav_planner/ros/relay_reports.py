"""What relays do with the setpoints of each UAV, as they report it on `<uav>/relay`."""

from collections import defaultdict
from collections.abc import Callable, Iterable
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus

from .messages import diagnostic_status
from ..errors import brief

REPORT_PERIOD = 0.2
"""Time [s] between two reports of a relay."""

_LOST_AFTER_S = 1.0  # Time [s] without a report after which a relay is lost.
_PASSING_HOLD_S = 0.5  # A shorter hold does not stop a vehicle: a busy machine delays setpoints.

_TEXTS = {
    'passing': 'passes setpoints on',
    'holding': 'has held the last place for {for_:.1f} s: {reason}',
    'refused': 'has refused setpoints for {for_:.1f} s: {reason}',
    'disabled': 'sends nothing until ~/enable is called with true',
    'silent': 'has sent nothing for {for_:.1f} s, because no setpoints come',
    'lost': 'has not reported for {for_:.1f} s, so nothing passes setpoints on; start it again'}


class RelayState(NamedTuple):
    """
    What a relay does with the setpoints of a UAV.

    :param relay: name of the node.
    :param name: 'passing', 'holding', 'refused', 'disabled' or 'silent'; 'lost' if the relay has
        ceased to report.
    :param duration: time since the state began [s].
    :param reason: why setpoints are held back, with the numbers.
    """

    relay: str
    name: str
    duration: float
    reason: str = ''

    @property
    def is_passing(self) -> bool:
        """Whether the vehicle gets its setpoints."""
        return self.name == 'passing'

    @property
    def holds_back(self) -> bool:
        """Whether setpoints come that the vehicle does not get."""
        return self.name in ('holding', 'refused', 'disabled')

    @property
    def stops_vehicle(self) -> bool:
        """Whether setpoints are held back for so long that the vehicle brakes to rest."""
        return self.holds_back and (self.name != 'holding' or self.duration >= _PASSING_HOLD_S)

    @property
    def text(self) -> str:
        """State in words that follow the name of the relay in a sentence."""
        return _TEXTS[self.name].format(for_=self.duration, reason=self.reason)

    def to_message(self, uav: str) -> DiagnosticStatus:
        """Return the message for `<uav>/relay` and /diagnostics; only passing is OK."""
        level = DiagnosticStatus.OK if self.is_passing else DiagnosticStatus.WARN
        return diagnostic_status(
            f'{self.relay}: {uav}', level, self.text,
            {'state': self.name, 'duration': self.duration, 'reason': self.reason})


def read_relay_state(message: DiagnosticStatus) -> RelayState | None:
    """Return the RelayState in a message, or None if it has none."""
    values = {entry.key: entry.value for entry in message.values}
    try:
        return RelayState(brief(message.name.rpartition(': ')[0], 100),
                          {name: name for name in _TEXTS}[values['state']],  # Only known names.
                          float(values['duration']), brief(values['reason']))
    except (KeyError, ValueError):
        return None


class RelayReports:
    """
    The last report of each relay on each UAV.

    Several relays may report on a UAV. A relay that passes setpoints on counts first, because
    then the vehicle gets its setpoints.

    :param clock: returns a time in s that is never set back.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        # State and its arrival [s] by UAV and relay.
        self._last = defaultdict[str, dict[str, tuple[RelayState, float]]](dict)
        self._lost = set[str]()  # UAVs whose relay has ceased to report.

    def take(self, topic: str, message: DiagnosticStatus) -> bool:
        """Keep a report from `<uav>/relay`; return True if it is the first or a new state."""
        state, uav = read_relay_state(message), topic.partition('/')[0]
        if state is None:
            return False
        before = self.state(uav)
        self._last[uav][state.relay] = state, self._clock()
        after = self.state(uav)
        return before is None or after is None or before.name != after.name

    def state(self, uav: str) -> RelayState | None:
        """Return a UAV's state, or 'lost' if all reports are old; None without any."""
        if uav not in self._last:
            return None
        now, reports = self._clock(), self._last[uav].values()
        recent = [state for state, arrival in reports if now - arrival <= _LOST_AFTER_S]
        if recent:
            return max(recent, key=lambda state: (state.is_passing, state.name in (
                'holding', 'refused')))
        state, arrival = max(reports, key=lambda report: report[1])
        return RelayState(state.relay, 'lost', now - arrival)

    def names(self, uavs: Iterable[str]) -> dict[str, str]:
        """Return the name of the state of each UAV whose relay has reported."""
        return {uav: state.name for uav in uavs if (state := self.state(uav))}

    def problem(self, uav: str, is_under_way: bool) -> str:
        """
        Return in words what keeps setpoints from a UAV; empty if nothing does or is reported.

        :param is_under_way: True for a flight that is flying or held, in which every state except
            'passing' is a problem. If False, only 'holding' and 'refused' are problems.
        """
        state = self.state(uav)
        if state is None or state.is_passing or not (
                is_under_way or state.holds_back and state.name != 'disabled'):
            return ''
        return f'the relay of {uav}, {state.relay}, {state.text}'

    def find_newly_lost(self) -> list[str]:
        """Return in words which relays have ceased to report since the last call."""
        lost = {uav for uav in self._last if (state := self.state(uav)) and state.name == 'lost'}
        new, self._lost = lost - self._lost, lost
        return [self.problem(uav, is_under_way=True) for uav in sorted(new)]
