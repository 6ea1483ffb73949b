"""
What the bound gives away: slots share groups, eavesdroppers are left out, tolerances are added.

**Tolerances.** A Plan may exceed a step, or miss its ends in every coordinate, by
POSITION_TOLERANCE, and exceed every limit of power by POWER_TOLERANCE. Steps, discs and powers are
widened by these tolerances. A power below zero is zero in a Plan.

**Rounding.** Let eps = 2^-52. Lengths are in units of about the mission's extent. So receivers and
goals are at coordinates of at most about 2, with an absolute error of a few eps. The relative
error of d^2 + H^2 is a few eps (1 + 1 / H), and the logarithms' gradients are at most 1 / H. Every
sum that bounds a box has fewer than 10 terms of each of two kinds, and a term is wrong by at most
a few eps of its size. The first kind are logarithms, below 200 in size for every legal scenario,
with weights w0 <= 1 and sum v <= 1. The second kind are the potentials' terms. Their size is at
most |u| r + |S| r^2 and step (|u| + |S| r), where r is the farthest that the reachable set
reaches. `add_disc_multiplier` in bound/kernel/reachable_set.hpp adds terms of the second kind's
size: their factors are at most ten times the slope, and their discs' radii at most twice the
place's distance. Second derivatives are wrong by a few eps of their terms. A negative second
derivative of the rates is at most 2 / H^2 in size and occurs only where a box is within H of a
receiver, so its term is at most about 2 in size over a box. `margin` is 64 eps times the sum of
these sizes, which is about ten times the possible error of the terms together. It is added to
every box, to every maximum and to every group. It is of the order of 1e-11 nats for a mission like
the paper's and grows with the values of the scenario's fields. An infinite margin makes the bound
infinite. Sums over the groups are exact except for one rounding (math.fsum).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...mission.scenario import Array, Scenario
from ...model.channel.links import make_link
from ...model.channel.rates import bound_sinrs
from ...plan.plan import POSITION_TOLERANCE

MOST_GROUPS = 400
"""Largest number of slot groups, which limits time and memory for missions of more slots."""

RAYS = 16
"""Number of candidate points on every disc's circle; the centre is one more candidate."""

EPSILON = 64 * float(np.finfo(float).eps)
"""64 eps: the factor of every margin."""

COORDINATE_ROUNDING = 1e-12
"""Fraction of the radius by which discs are widened, against rounding of compared squares."""


@dataclass(frozen=True, eq=False)
class SlotGroups:
    """
    The slots 1..N in G groups of neighbouring slots, of one slot each where N is small.

    All slots of a group share one reachable set, which contains the slots' reachable sets, and one
    set of multipliers. So the bound of a group is a bound for each of its slots.

    :param edges: number of slots before each group, then N, (G + 1,).
    """

    edges: NDArray[np.int64]

    @classmethod
    def of(cls, slots: int, most: int = MOST_GROUPS) -> SlotGroups:
        """Return at most `most` groups, of nearly equal size, of a mission of `slots` slots."""
        count = min(slots, most)
        return cls(np.arange(count + 1) * slots // count)

    @property
    def first(self) -> NDArray[np.int64]:
        """First slot of every group, (G,)."""
        return self.edges[:-1] + 1

    @property
    def last(self) -> NDArray[np.int64]:
        """Last slot of every group, (G,)."""
        return self.edges[1:]

    @property
    def count(self) -> NDArray[np.int64]:
        """Return the number of slots of every group, (G,)."""
        return np.diff(self.edges)

    @property
    def means(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """
        Mean weights of the edges before and after a group of n slots, (G,) each.

        Multipliers are interpolated linearly between the edges: slot k = 1..n has the weights
        1 - k / n and k / n. Their means are (n - 1) / (2 n) and (n + 1) / (2 n).
        """
        count = self.count.astype(float)
        return (count - 1) / (2 * count), (count + 1) / (2 * count)

    @property
    def slots(self) -> int:
        """Return the number N of all slots."""
        return int(self.edges[-1])


def unit_circle(count: int) -> Array:
    """Return points on the unit circle at equal angles, (count, 2)."""
    angle = np.arange(count) * 2 * np.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], -1)


@dataclass(frozen=True, eq=False)
class EavesdropperSubset:
    """
    Places of eavesdroppers, which the bound uses in place of the scenario's discs.

    A leak does not fall when an eavesdropper joins, so leaving some out lowers no plan's rate. The
    leak to the worst point of a disc is at least the leak to any chosen point. So for problem (P1)
    each disc is replaced by eavesdroppers of radius 0 at chosen points of the disc. For these the
    objectives of problems (P1) and (P2) are equal.

    :param places: centres, (E, 2) in m.
    :param radii: error radii, (E,) in m.
    :param advantages: factor by which the SNR exceeds the ground node's at equal gain, (E,).
    :param owners: index of the scenario's eavesdropper to which each place belongs, (E,).
    """

    places: Array
    radii: Array
    advantages: Array
    owners: NDArray[np.intp]

    @classmethod
    def of(cls, scenario: Scenario, objective: str) -> EavesdropperSubset:
        """Return all candidates: discs for 'guaranteed', points of the discs for 'worst_case'."""
        centres = np.array([eve.position for eve in scenario.eavesdroppers])
        radii = np.array([eve.error_radius for eve in scenario.eavesdroppers])
        if objective == 'guaranteed':
            return cls(centres, radii, scenario.receiver_advantages, np.arange(len(centres)))
        offsets = np.concatenate([[[0.0, 0.0]], unit_circle(RAYS)])
        # A little inside, so that rounding puts no point outside.
        within = np.maximum(radii * (1 - 1e-9) - 1e-15 * np.abs(centres).max(1), 0.0)
        points = [centre + reach * offsets if reach > 0 else centre[None]
                  for centre, reach in zip(centres, within)]
        places = np.concatenate(points)
        owners = np.repeat(np.arange(len(points)), [len(several) for several in points])
        return cls(places, np.zeros(len(places)), scenario.receiver_advantages[owners], owners)

    def compute_sinrs(self, scenario: Scenario, positions: Array, powers: Array) -> Array:
        """
        Return upper bounds of the SINR in this subset's discs by the formula of (P2), (E, N).

        :param positions: positions of a plan, (U, N + 2, 2) in m.
        :param powers: powers of the plan, (U, N) in W.
        """
        link = make_link(scenario, 'eavesdropper', axes=2).for_receivers(self.advantages[:, None])
        return bound_sinrs(link, positions[:, None, 1:-1] - self.places[:, None],
                           self.radii[:, None], powers[:, None])

    def select_loudest(self, sinrs: Array, most: int, colluding: bool) -> EavesdropperSubset:
        """
        Return the `most` places that leak most in a plan, or all if there are fewer, in order.

        They are chosen one after the other, each time the place that raises the plan's leak,
        summed over the slots, by most. Every disc gets a place before any gets two, because a
        plan may leak little into a disc only because its jammer is there.

        :param sinrs: SINRs of a plan at all places, (E, N).
        :param colluding: True if the SINRs of eavesdroppers add up.
        """
        chosen: list[int] = []
        adversary = self.owners if colluding else np.zeros_like(self.owners)
        largest = np.zeros((adversary[-1] + 1, sinrs.shape[1]))
        for _ in range(min(most, len(sinrs))):
            rest = largest.sum(0) - largest[adversary]
            gain = np.log1p(rest + np.maximum(sinrs, largest[adversary])).sum(1)
            gain[chosen] = -np.inf
            fresh = ~np.isin(self.owners, self.owners[chosen])
            best = int(np.where(fresh | ~fresh.any(), gain, -np.inf).argmax())
            chosen.append(best)
            largest[adversary[best]] = np.maximum(largest[adversary[best]], sinrs[best])
        keep = sorted(chosen)
        return EavesdropperSubset(self.places[keep], self.radii[keep], self.advantages[keep],
                                  self.owners[keep])


def end_tolerance(scenario: Scenario) -> float:
    """
    Return the largest distance [m] by which a plan may miss a start or a goal.

    A Plan tolerates an error in each coordinate, so the distance has the factor 1.5 > sqrt(2).
    Coordinates in a UAV's own frame are wrong by a few eps of the mission's extent.
    """
    places = [scenario.ground_node, *(eve.position for eve in scenario.eavesdroppers),
              *(uav.start for uav in scenario.uavs), *(uav.goal for uav in scenario.uavs)]
    extent = float(np.abs(places).max())
    return 1.5 * POSITION_TOLERANCE + 1e-13 * extent


def margin(altitude: float, size: np.ndarray) -> np.ndarray:
    """
    Return 64 eps (200 + 10 / H + size), a bound of a sum's rounding error, (...) in nats.

    The sum is of logarithms and potentials. The head of this module derives 200 and 10 / H.

    :param altitude: altitude H of the UAV, in units.
    :param size: size of the potentials' terms, (...) in nats.
    """
    return np.asarray(EPSILON * (200.0 + 10.0 / altitude + size))


def find_reference_snrs(scenario: Scenario) -> Array:
    """
    Return each UAV's SNR per W at 1 m to the ground node and to an eavesdropper, (2, U).

    An eavesdropper's receiver advantage is not included. Fading with an outage multiplies the gain
    of each link by a constant, its quantile; the lemmas hold for any such constant.
    """
    return np.array([np.broadcast_to(
        np.ravel(make_link(scenario, kind).reference_snr), len(scenario.uavs))
        for kind in ('ground_node', 'eavesdropper')])
