"""
The numbers of the method `joint`.

`studies/numerics.md` says how each was chosen, and `benchmarks/sweep.py` measures what it does.
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple, TypeAlias

Range: TypeAlias = tuple[float, float]
"""Smallest and largest value of a number that is drawn log-uniformly or uniformly."""


class Hops(NamedTuple):
    """
    Rounds of hops; each round begins at the best starts.

    :param starts: largest number of starts at which the first round begins. It falls by 1 after a
        round in which the best rate rises by less than `distinct`; the rounds end when it is 0.
    :param rounds: largest number of rounds.
    :param steps: Newton steps of each hop.
    """

    starts: int
    rounds: int
    steps: int


class Search(NamedTuple):
    """
    How starts are searched on the coarse grid.

    :param whole_slots: the most slots of a full grid that is searched itself; larger grids have a
        coarse grid of DESCENT.coarse_slots.
    :param ranking: pairs of a share of the starts, the best, and a number of Newton steps that
        they take; each pair follows on the one before.
    :param gap: relative distance below the best rate within which starts are polished.
    :param polish_mus: barrier parameters that polishes begin with, in shares of the rate.
    :param polish_steps: Newton steps of each polish.
    :param lowered: ratio of the last barrier parameter of these steps and the least first one.
    :param finished: the most starts that are finished on the full grid.
    :param hops: hops on the coarse grid.
    :param full_hops: hops on a full grid of few slots.
    """

    whole_slots: int
    ranking: tuple[tuple[float, int], ...]
    gap: float
    polish_mus: tuple[float, ...]
    polish_steps: int
    lowered: float
    finished: int
    hops: Hops = Hops(starts=0, rounds=0, steps=0)
    full_hops: Hops = Hops(starts=0, rounds=0, steps=0)


class Beginning(NamedTuple):
    """
    What Newton's method begins with.

    A high barrier parameter leads past the nearest optimum. A high price keeps loiter circles, and
    at a low price UAVs hover again.

    :param mu: barrier parameter.
    :param price: first price of every energy in units of rates per limit.
    """

    mu: float
    price: float


def _list_numbers(value: Any) -> list[float]:
    """Return the numbers in nested tuples."""
    return [value] if not isinstance(value, tuple) else [
        number for part in value for number in _list_numbers(part)]


class _Numbers:
    """Numbers that are not negative, and ranges that increase; verified when they are made."""

    def __post_init__(self) -> None:
        """Raise ValueError for a field with a negative number or NaN, or a wrong Range."""
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if not min(_list_numbers(value)) >= 0 or field.type is Range and value[0] >= value[1]:
                raise ValueError(f'{field.name} is {value}; it must not be negative, and a range '
                                 'must increase')


@dataclass(frozen=True)
class _Descent(_Numbers):
    """Newton steps on a grid, and from a coarse grid to the full one."""

    coarse_slots: int = 40  # Slots of the coarse grid.
    coarse_mu: float = 1e-3  # Barrier parameter that ends the coarse grid.
    final_mu: float = 1e-8  # Barrier parameter that ends the full grid.
    # Least first barrier parameter on a finer grid if interpolation is not centred.
    refined_mu: float = 0.03
    most_steps: int = 150  # Largest number of Newton steps on one grid.
    try_every: int = 16  # Steps between proposals; a proposal takes as long as several steps.
    first_price: float = 0.03  # First price of a limited energy, in units of rates per limit.
    warm_share: float = 0.01  # Fraction by which an earlier plan is moved into the interior.
    warm_mu: float = 1e-3  # First barrier parameter for an earlier plan.
    refinement: int = 8  # Largest ratio of the numbers of slots of two successive grids.
    # Barrier parameter that ends a grid between the coarse and the full one.
    middle_mu: float = 1e-4


@dataclass(frozen=True)
class _Multistart(_Numbers):
    """The search from several starts for problem (P2)."""

    steps: int = 37  # Newton steps from each of the first starts on the coarse grid.
    distinct: float = 2e-4  # Relative difference in rate between distinct optima.
    agreed: float = 0.7  # Share of the first starts in the best optimum that ends the multistart.
    gap: float = 0.1  # Relative distance below the best rate within which starts are finished.
    polished: int = 12  # The most starts that are polished.
    # Share, or units of rates, below the best up to which fly-hover-fly is finished.
    close: float = 0.02
    hops_at_once: int = 4  # Hops in a round.
    hop_slots: int = 120  # The most slots of a full grid on which there are hops.
    # First barrier parameter on the full grid with several ground nodes, in shares of the rate.
    nodes_mu: float = 0.003
    # The search with one ground node and few UAVs, whose starts are not ranked.
    single_node: Search = Search(
        whole_slots=_Descent.coarse_slots, ranking=((1.0, steps),), gap=gap,
        polish_mus=(0.05, 0.01), polish_steps=15, lowered=1.0, finished=2)
    many: int = 4  # Least number of UAVs that are many.
    # The search with one ground node and many UAVs.
    many_uavs: Search = single_node._replace(
        ranking=((1.0, 20), (0.3, 17)), hops=Hops(starts=4, rounds=4, steps=80))
    # The search with several ground nodes.
    several_nodes: Search = Search(
        whole_slots=60, ranking=((1.0, 12), (0.4, 10), (0.2, 12)), gap=0.5,
        polish_mus=(0.03,), polish_steps=25, lowered=0.02, finished=3,
        hops=Hops(starts=4, rounds=10, steps=55),
        full_hops=Hops(starts=1, rounds=3, steps=55))
    # Jamming levels of power control, in shares of limit_powers.
    levels: tuple[float, ...] = (1.0, 0.1, 0.01, 0.001)
    level_steps: int = 20  # Newton steps from each level on the coarse grid.
    level_mu: float = 0.03  # Barrier parameter to begin with at each level.
    level_share: float = 0.01  # Share by which powers are moved into the interior at each level.
    # Elevation offsets of links early in the search [degrees]; see make_links.
    elevation_offsets: tuple[float, ...] = (8.0, 4.0, 2.0)
    offset_steps: int = 25  # The most Newton steps with each elevation offset on the full grid.
    offset_mu: float = 1e-4  # Barrier parameter that ends the steps with an elevation offset.


@dataclass(frozen=True)
class _Starts(_Numbers):
    """Random starts, and starts that visit several ground nodes."""

    per_uav: int = 15  # Number of starts for each UAV.
    most: int = 60  # The most starts for all UAVs.
    first_batch: int = 8  # Starts of the first batch. If they agree, it is the only one.
    places: int = 13  # Hovering places where flights around obstacles or UAVs must be found first.
    enough: float = 0.5  # Share of the first flights that a coarse grid must have room for.
    # The most starts on alternative routes, which are in the first batch, too.
    alternatives: int = 8
    # Distances of hovering places from their targets, log-uniform [mean altitudes].
    distance: Range = (0.03, 1.0)
    jamming: Range = (1e-4, 1e-2)  # Jamming powers in units of the average power, log-uniform.
    mu: Range = (0.006, 0.05)  # Barrier parameters to begin with, log-uniform.
    most_power: float = 10.0  # Most power of jammers in starts [transmitter's average power].
    # Jamming power of every fourth start, in units of the average power.
    more_jamming: float = 0.05
    close_mu: float = 3e-3  # Barrier parameter of every second start.
    # Number of random places around a ground node that a short way chooses from.
    way_places: int = 128
    # Distances of these random places from the ground node, log-uniform [mean altitudes].
    way_distance: Range = (0.03, 4.0)
    visiting: float = 2.0  # Ratio of numbers of starts with several ground nodes and with one.
    # Barrier parameter of starts that visit ground nodes, in shares of their rates.
    visit_mu: float = 0.03
    # Least barrier parameter of starts that visit ground nodes: a node may have no rate.
    least_mu: float = 3e-4
    # Share of each slack that starts keep free if they visit ground nodes.
    visit_share: float = 0.01
    baseline_mu: float = 0.02  # Barrier parameter of the baseline as a start.
    # Range of the scale of barrier parameters with several ground nodes.
    scales: Range = (0.1, 1.0)
    hop_width: Range = (0.04, 1.0)  # Width of a hop's part of the flight, log-uniform [flights].
    # Length by which a hop moves one UAV, log-uniform [mean altitudes].
    hop_size: Range = (0.03, 1.0)
    # Standard deviation of the logarithms by which a hop scales jamming powers.
    hop_jamming: float = 1.5
    hop_mu: Range = (0.02, 0.15)  # Barrier parameters of hops in shares of the rate, log-uniform.
    on: float = 0.9  # Power of a UAV that transmits, in units of its average power.
    silent: float = 1e-5  # Power of a silent UAV, in units of its average power.
    margin: float = 0.01  # Share of a limit of acceleration that is left where it can be.
    share: float = 0.05  # Share of each slack that a start keeps free.
    power_margin: float = 0.2  # Ratio of the share for limits of powers and that for flights.
    refined_share: float = 1e-3  # Share of each slack that refined flights keep free.


@dataclass(frozen=True)
class _Visits(_Numbers):
    """Configurations of UAVs that serve a ground node, and flights through them."""

    samples: int = 1200  # Number of random configurations for each visit of an order.
    drawn: int = 4  # Each start is drawn from one in `drawn` samples, chosen at random.
    kept: int = 16  # Number of best samples of a visit that each start chooses from.
    # Distances of jammers from eavesdroppers, log-uniform [mean altitudes].
    distance: Range = (0.03, 1.5)
    # Distances of the transmitter from the ground node, log-uniform [mean altitudes].
    away: Range = (0.03, 4.0)
    # Powers of jammers, log-uniform, in shares of the powers of starts.
    jamming: Range = (1e-4, 1.0)
    reach: Range = (0.7, 1.0)  # Share of the largest speed at which places are in reach, uniform.
    # Share of the time between the middles of two visits in which UAVs fly on.
    flying: float = 0.6
    # Penalty of a flight between visits that takes twice its time, in logarithms of rates.
    late: float = 3.0
    equal: float = 0.5  # Share of the flight that is divided equally; the rest is divided by need.
    jitter: float = 0.5  # Standard deviation of the logarithms of the durations of visits.
    # Share of the largest rate of a visit that counts for every visit at least.
    least_rate: float = 0.01


@dataclass(frozen=True)
class _VisitSearch(_Numbers):
    """Random changes of visits, before any Newton step."""

    drawn: int = 2  # Number of random visits for each start that is asked for.
    changes: int = 60  # Changes that are tried for each random visit.
    # Changes that are tried for each random visit while few starts serve all nodes.
    most_changes: int = 240
    served: float = 1e-3  # Estimate [bit/s/Hz] from which a start is taken to serve all nodes.
    serving: float = 0.1  # Share of the starts that must serve all nodes after `changes`.
    slots: int = 24  # Slots of the grid on which changes are judged.
    shift: Range = (0.03, 1.0)  # Length by which a place is moved, log-uniform [mean altitudes].
    stretch: float = 0.3  # Standard deviation of the logarithms of durations in a change.
    lack: float = 1e-4  # Mean rate [bit/s/Hz] that counts for a node that nearly has one.
    rounds: int = 10  # Rounds in which the prices of the nodes are adapted for an estimate.
    price_step: float = 0.5  # Step of the logarithms of prices in the first round.


@dataclass(frozen=True)
class _Exchange(_Numbers):
    """The exchange of worst places for problem (P1)."""

    # Least excess of a leak, in the grid's unit of rates, of a place that is worse.
    worse: float = 1e-7
    places_mu: float = 0.02  # First barrier parameter of the exchange.
    places_final_mu: float = 1e-7  # Last barrier parameter of the exchange.
    final_steps: int = 8  # Largest number of steps with the last barrier parameter.
    worth: float = 0.01  # Relative gain of the first round from which a second round pays.
    more_steps: int = 40  # Largest number of steps of the second round.
    # Largest number of optima of (P2) that are compared for (P1) on the coarse grid.
    explored: int = 6
    exploring_steps: int = 15  # Steps from each optimum that is compared.
    exploring_mu: float = 0.01  # First barrier parameter of the comparison of optima.
    exploring_final_mu: float = 1e-4  # Last barrier parameter of the comparison of optima.
    # First barrier parameter on the full grid of the best optimum compared.
    explored_mu: float = 2e-3
    # Angles [rad] of a disc's first places from the worst place.
    angles: tuple[float, ...] = (0.0, 2.0, 4.0)
    # Largest distance, in radii of the disc, of a place that the worst place replaces.
    near: float = 0.5


@dataclass(frozen=True)
class _Energy(_Numbers):
    """Starts for limits of energy."""

    # Beginnings of the best flights without limits of energy; other optima have the first one.
    as_they_are: tuple[Beginning, ...] = (
        Beginning(0.01, 0.3), Beginning(0.03, 0.3), Beginning(0.03, 3.0))
    # Beginnings of the best flights with each of CIRCLES; other optima have the last one.
    with_circles: tuple[Beginning, ...] = (
        Beginning(0.03, 3.0), Beginning(0.03, 0.3), Beginning(0.03, 3.0))
    # Beginning of direct flights with loiter circles all the way, which take little energy.
    direct: Beginning = Beginning(0.03, 0.03)
    # Beginnings of the flights of least energy, if no start has kept all limits of energy.
    least: tuple[Beginning, ...] = (
        Beginning(0.03, 10.0), Beginning(0.1, 30.0), Beginning(1.0, 300.0))
    slow: float = 0.25  # Share of max_speed below which a UAV hovers.
    circle_speed: float = 0.7  # Largest speed on circles, as a share of max_speed.
    turning: float = 0.6  # Largest acceleration across circles, as a share of max_acceleration.
    speeding: float = 0.5  # Acceleration along circles, as a share of max_acceleration.
    optima: int = 3  # Largest number of further optima that are starts.
    coarse_slots: int = 100  # Least number of slots of the grid on which starts are ranked.
    slot_duration: float = 1.5  # Longest slots of that grid [s]. In long slots no circle is flown.
    share: float = 0.01  # Share of each slack that a start keeps free.
    steps: int = 40  # Newton steps from each start before they are ranked.
    gap: float = 0.2  # Relative distance below the best rate beyond which starts are not finished.
    finished: int = 4  # Largest number of starts that are finished on the full grid.


DESCENT = _Descent()
MULTISTART = _Multistart()
STARTS = _Starts()
VISITS = _Visits()
VISIT_SEARCH = _VisitSearch()
EXCHANGE = _Exchange()
ENERGY = _Energy()
