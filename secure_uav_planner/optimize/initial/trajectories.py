"""Fly-hover-fly with constant powers, Section IV: the baseline, and where the methods start."""

from functools import lru_cache
from itertools import chain

import numpy as np

from .flights import direct_flights, flights_to
from .infeasibility import refuse
from .projection import flights_near
from .visibility_graph import Check, free_places
from ...mission.scenario import Array, Scenario
from ...model.limits import is_open


def fly_hover_fly_positions(scenario: Scenario, check: Check = lambda: None) -> Array:
    """
    Return straight flights at full speed to a hovering place and on to the goal, (U, N+2, 2) in m.

    The transmitter hovers above the ground node, the jammers above the eavesdroppers in turn. A
    UAV without the time to reach its hovering place flies towards it and turns back at the last
    moment that still reaches the goal. Flights go around what may not be entered, and keep their
    separation.

    :param check: called now and then in a search around what is in the way; what it raises is
        passed on.
    :raises InfeasibleMissionError: when no flights are found that keep the limits.
    """
    eves = scenario.eavesdropper_positions
    jammers = np.arange(len(scenario.uavs) - 1)
    hover = np.concatenate([[scenario.ground_node], eves[jammers % len(eves)]])
    if is_open(scenario):
        return flights_to(scenario, hover)
    known = _known_flights(scenario)
    if not known:
        known.append(_flights_around(scenario, hover, check))
    return known[0].copy()


@lru_cache(maxsize=16)
def _known_flights(_scenario: Scenario) -> list[Array]:
    """Return the list that remembers the flights of a scenario."""
    return []


def _flights_around(scenario: Scenario, hover: Array, check: Check) -> Array:
    places = free_places(scenario, hover, check)
    wanted = flights_to(scenario, places, check=check)
    for flights in chain([wanted], direct_flights(scenario, check)):
        found = flights_near(scenario, flights, check)
        if found is not None:
            return found
    refuse(scenario, check)


def constant_powers(scenario: Scenario, transmitting: float = 1.0,
                    jamming: float = 1.0) -> Array:
    """Return shares of the average powers in every slot, (U, N) in W."""
    shares = np.full(len(scenario.uavs), jamming)
    shares[0] = transmitting
    return np.repeat((shares * scenario.average_powers)[:, None], scenario.slots, axis=1)
