"""The shortest flight that delivers: a bracket of durations, and a proof that 1 s less fails."""

from dataclasses import replace
from itertools import count
import math

import numpy as np

from .method import explain_refusal, upper_bound
from ..errors import InfeasibleMissionError, NumericalError, ScenarioError
from ..mission import Objective
from ..mission.fields import check_argument, find_range, Number
from ..mission.kinematics import DURATION
from ..mission.participants import Propulsion
from ..mission.scenario import Scenario
from ..mission.validation import checked_callback, checked_kind, checked_time_limit, round_down
from ..model.channel.links import make_link
from ..model.problem import Problem
from ..optimize import solve
from ..optimize.deadline import Deadline, OnIteration, run_to_end
from ..optimize.methods import check_objective
from ..plan.plan import Iteration, Plan, Status
from ..plan.results import explain_silence

_BITS = Number(1e-6, 1e12, 'bit/Hz')
_ACCURACY = 0.1  # Accuracy [s] of the duration; with slots shorter than 0.1 s it is one slot.
_GROWTH = 2.0  # Ratio of successive durations until one suffices.
_LEAST_GROWTH = 1.01  # Ratio of durations below which the search for a longer one is given up.
_LEAST_TIME = 1e-3  # Least time limit [s] of a call of solve or upper_bound in the search.
_SHORTER = 1.0  # Time [s] by which the flight that is to be proven too short is shorter.
_PERIOD = 0.05  # Longest time [s] between calls of the callback.


def shortest_duration(scenario: Scenario, bits: float, *, objective: Objective | None = None,
                      time_limit: float | None = None, on_progress: OnIteration | None = None
                      ) -> Plan:
    """
    Plan the shortest flight that delivers a number of bits, by the method 'joint'.

    A flight delivers its mean rate times its duration T. Waiting at the start never delivers
    less, so a bracket of durations is narrowed to 0.1 s, or to one slot if slots are shorter or a
    UAV starts in motion. The message of the plan says that it delivers the bits. It also says that
    no flight shorter by 1 s delivers them if upper_bound proves this. Without this proof a shorter
    flight may exist, because solve may miss the best flight of a duration.

    :param scenario: a Scenario. The number of its slots changes with the duration, and their
        length changes by as much as the rounding of this number needs. If a UAV starts in motion,
        the length stays exactly as it is and T is a number of slots.
    :param bits: amount to be delivered [bit/Hz], above 0.
    :param objective: the rate that delivers, as for solve.
    :param time_limit: time [s] after which the shortest delivering flight so far is returned.
    :param on_progress: called with an Iteration after every step; returning True ends the search
        with the shortest delivering flight so far. The Iteration's `step` begins with the
        duration under trial, such as '122.6 s: joint'.
    :return: a Plan, whose scenario has the duration.
    :raises OptionError: for an unknown objective, or a time limit or bits that are not positive.
    :raises InfeasibleMissionError: with the place ('bits',) when no flight can deliver the bits,
        or when no flight was found that delivers them; with the text of solve when no duration
        could be flown.
    :raises StoppedError: when the search is stopped before a delivering flight was found.
    :raises TimeLimitError: when the time limit is over before a delivering flight was found.
    """
    checked_kind('scenario', scenario, Scenario)
    bits = check_argument('bits', bits, _BITS)
    objective = check_objective('joint', objective)
    time_limit = checked_time_limit(time_limit)
    checked_callback('on_progress', on_progress)
    deadline = Deadline(on_progress, time_limit, _PERIOD, f'flights that deliver {bits:g} bit/Hz')
    check_bits(scenario, bits)
    return _Search(scenario, bits, objective, deadline).find_plan()


def find_longest_duration(scenario: Scenario) -> float:
    """Return the longest duration [s] that slots of this length and the batteries allow."""
    return min(DURATION.high, find_range(Scenario, 'slots').high * scenario.slot_duration,
               *_find_battery_durations(scenario))


def _find_battery_durations(scenario: Scenario) -> list[float]:
    """Return a duration [s] that no flight on each battery of a scenario exceeds."""
    return [uav.max_energy / find_least_power(uav.propulsion) for uav in scenario.uavs
            if uav.max_energy is not None and uav.propulsion is not None]


def find_least_power(propulsion: Propulsion) -> float:
    """Return a power [W] that a propulsion needs at any speed, by speeds up to 1000 km/s."""
    speeds = np.append(0.0, np.geomspace(1e-3, 1e6, 20000))  # The steps are 0.1%.
    return 0.999 * float(propulsion.power(speeds).min())


def check_bits(scenario: Scenario, bits: float) -> None:
    """
    Refuse bits that provably no flight of a scenario delivers, by formulas without a search.

    They are refused if explain_silence has a reason for the longest flight. Otherwise node g needs
    rate_g T + head start_g >= weight_g bits. The sum of the rates is at most log2(1 + SNR) with
    the transmitter straight above a node at peak power. Bits that pass may still be out of reach.

    :raises InfeasibleMissionError: with the place ('bits',).
    """
    longest = find_longest_duration(scenario)
    slots = max(1, round(longest / scenario.slot_duration)) if scenario.has_tracks else 1
    if reason := explain_silence(scenario, bits, slots):
        raise InfeasibleMissionError(f'bits is {bits:g} bit/Hz; {reason}', ('bits',))
    gain = make_link(scenario, 'ground_node').gain(np.zeros((len(scenario.uavs), 1)))[0, 0]
    rate = math.log2(1.0 + gain * scenario.uavs[0].peak_power)
    most = (rate * longest + sum(scenario.head_starts or ())) / sum(scenario.node_weights)
    if bits > most * (1 + 1e-6):
        raise InfeasibleMissionError(
            f'bits is {bits:g} bit/Hz; the longest flight, {longest:g} s in slots of '
            f'{scenario.slot_duration:g} s, delivers at most {round_down(most):g} bit/Hz, '
            'straight above a ground node at peak power; ask for less, or for ' + (
                'a larger max_energy' if longest in _find_battery_durations(scenario)
                else 'longer slots'), ('bits',))


class _Search:
    """
    The search for the shortest flight.

    Its methods raise StoppedError or TimeLimitError when the deadline is over.

    :ivar last: the last plan that was found, from which the next solve starts.
    :ivar best: the shortest plan that delivers the bits, or None.
    """

    def __init__(self, scenario: Scenario, bits: float, objective: Objective,
                 deadline: Deadline) -> None:
        self._scenario, self._bits, self._objective = scenario, bits, objective
        self._deadline, self._numbers = deadline, count()
        self._tried = scenario.duration
        self._refusal: ScenarioError  # Why the last duration that cannot be flown is refused.
        self.last: Plan | None = None
        self.best: Plan | None = None
        # The start of a UAV in motion is given by two points of its path half a slot before and
        # after it, so another slot length would mean another start.
        self._keeps_slots = any(
            uav.max_acceleration is not None and uav.start_velocity not in (None, (0.0, 0.0))
            for uav in scenario.uavs)
        step = scenario.slot_duration
        self._accuracy = step if self._keeps_slots else min(_ACCURACY, step)

    @property
    def _time_left(self) -> float:
        """Time limit [s] for a call of solve or upper_bound."""
        return max(self._deadline.time_left, _LEAST_TIME)

    def find_plan(self) -> Plan:
        """
        Return the shortest flight that was found to deliver the bits demanded.

        Its `too_short` is a duration [s] that is proven not to suffice, or None without a proof.
        Its `status` tells whether the search ended early. An early end without a flight raises.
        """
        status = run_to_end(self._narrow)
        if self.best is None:
            self._deadline.raise_if_over()
            raise NumericalError('no flight could be planned')
        return replace(self.best, bits=self._bits, solve_time=self._deadline.elapsed,
                       status=self.best.status if status == 'converged' else status)

    def _narrow(self) -> Status:
        """Narrow the bracket of durations; then try to prove that one shorter by 1 s fails."""
        best, low, delivered = self._bracket()
        # The next duration interpolates the bits of both ends. It is the middle if the lower end
        # is 0 or cannot be flown.
        while (high := best.scenario.duration) - low > self._accuracy * (1 + 1e-6):
            share = 0.5 if delivered is None else (
                (self._bits - delivered) / (_count_bits(best) - delivered))
            tried = min(max(low + share * (high - low), low + self._accuracy),
                        high - self._accuracy)
            plan = self._plan_flight(tried)
            if plan is not None and plan is self.best:
                best = plan
            else:
                low, delivered = tried, None if plan is None else _count_bits(plan)
        self._prove(best)
        return 'converged'

    def _bracket(self) -> tuple[Plan, float, float | None]:
        """
        Return a flight that delivers the bits and a shorter duration [s] that does not, or 0.

        The third value is what the shorter flight delivers [bit/Hz], or None if it cannot be
        flown. Durations are doubled until one is too long, which is one that cannot be flown
        although a shorter one can or takes less energy, and halved until one is too short. Then
        the geometric mean of both follows. If no duration that is tried delivers the bits,
        InfeasibleMissionError is raised.
        """
        longest = find_longest_duration(self._scenario)
        low, high, delivered = 0.0, math.inf, None
        duration = min(self._scenario.duration, longest)
        while True:
            plan = self._plan_flight(duration)
            if self.best is not None:
                return self.best, low, delivered
            if plan is not None:
                low, delivered = duration, _count_bits(plan)
            elif delivered is not None or self._takes_more_energy(duration):
                high = duration
            else:
                low = duration
            if low >= longest or high <= max(_LEAST_GROWTH * low, self._accuracy):
                if self.last is None:
                    raise self._refusal
                raise InfeasibleMissionError(
                    f'bits is {self._bits:g} bit/Hz; no flights were found that deliver so much',
                    ('bits',))
            if math.isinf(high):
                duration = min(_GROWTH * low, longest)
            else:
                duration = math.sqrt(low * high) if low else high / _GROWTH

    def _takes_more_energy(self, duration: float) -> bool:
        """
        Return True if a refused duration [s] is beyond a battery, and a shorter one takes less.

        Energies are compared for flights of the refused UAV at constant speed on its shortest way.
        """
        place = self._refusal.place
        if place[-1:] != ('max_energy',):
            return False
        index = int(place[1])
        uav = self._scenario.uavs[index]
        ends = np.array([uav.start, uav.goal])
        _, [routes] = Problem(self._scenario).find_routes(index, list(ends), 1)
        way = np.diff(routes[0] if routes else ends, axis=0)
        speed = float(np.linalg.norm(way, axis=1).sum()) / duration
        assert uav.propulsion is not None
        slow, fast = uav.propulsion.power([speed, _LEAST_GROWTH * speed]).tolist()
        return bool(fast / _LEAST_GROWTH < slow)

    def _plan_flight(self, duration: float) -> Plan | None:
        """
        Return a plan of a duration [s], or None if it cannot be flown.

        The plan is kept in `last`, and in `best` if it delivers the bits.
        """
        self._tried = duration
        self._report(Iteration(0, 'start', 0.0, 0.0, 0.0))
        self._deadline.raise_if_over()
        try:
            self.last = plan = solve(
                self._change_duration(duration), on_iteration=self._report, initial=self.last,
                time_limit=self._time_left, objective=self._objective)
        except ScenarioError as error:
            self._refusal = error
            return None
        if _count_bits(plan) >= self._bits:
            self.best = plan
        self._deadline.raise_if_over()
        return plan

    def _change_duration(self, duration: float) -> Scenario:
        """Return the scenario with another duration [s], in slots of about the same length."""
        # If the slots' length must not change at all, the duration is rounded.
        step = self._scenario.slot_duration
        slots = max(1, round(duration / step))
        return replace(self._scenario, slots=slots,
                       duration=slots * step if self._keeps_slots else duration)

    def _report(self, iteration: Iteration) -> bool:
        """Report an iteration of solve or upper_bound; return True if the search must end."""
        self._deadline.report(replace(
            iteration, number=next(self._numbers), elapsed=self._deadline.elapsed,
            step=f'{self._tried:.1f} s: {iteration.step}'))
        return self._deadline.poll()

    def _prove(self, best: Plan) -> None:
        """Set `too_short` of `best` if upper_bound proves that a flight shorter by 1 s fails."""
        duration = best.scenario.duration - _SHORTER
        if duration <= 0 or explain_refusal(self._scenario):
            return
        try:
            shorter = self._change_duration(duration)
        except InfeasibleMissionError:
            return
        self._tried = shorter.duration
        bound = upper_bound(
            shorter, objective=self._objective, time_limit=self._time_left,
            on_progress=lambda bound: (
                self._report(bound) or bound.rate * shorter.duration < self._bits))
        if bound.rate * shorter.duration < self._bits:
            self.best = replace(best, too_short=shorter.duration)


def _count_bits(plan: Plan) -> float:
    """Return what a plan delivers [bit/Hz]: its mean rate times its duration."""
    return plan.rate * plan.scenario.duration
