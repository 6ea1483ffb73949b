"""
What the bound gives away: slots share groups, eavesdroppers are left out, tolerances are added.

**Tolerances.** A Plan may exceed a step, or miss its ends in every coordinate, by
POSITION_TOLERANCE, and exceed every limit of power by POWER_TOLERANCE. Steps, discs and powers are
widened by that much. A power below zero counts as zero in a Plan.

**Rounding.** Let eps = 2^-52. Lengths are in units of about the mission's extent, so that
receivers and goals are at coordinates of at most about 2, with an absolute error of a few eps, and
d^2 + H^2 has a relative one of a few eps (1 + 1 / H); the logarithms' gradients are at most 1 / H.
Every sum that bounds a box has fewer than 10 terms of each of the following kinds, each of them
wrong by at most a few eps of its size: logarithms (below 200 in size for every scenario that is
legal, weighted by w0 <= 1 and sum v <= 1), and the potentials' terms (at most |u| r + |S| r^2 and
step (|u| + |S| r) in size, r being the farthest that the reachable set reaches). The terms that
`add_disc_multiplier` in bound/kernel/terms.hpp adds are of that size, too: their factors are at
most ten times the slope, and their discs' radii at most twice the place's distance. Second
derivatives are wrong by a few eps of their terms; a negative one of the rates is at most 2 / H^2
and met only where a box is within H of a receiver, so that it is at most of the size of 2 over a
box. `margin` is 64 eps times the sum of these sizes, which is about ten times what the terms can
add up to, and it is added to every box, to every maximum and to every group. It is of the order of
1e-11 nats for a mission like the paper's and grows with the values of its fields; where it is not
finite, neither is the bound. Sums over the groups are exact but for one rounding (math.fsum).
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
"""More slots than that share groups; time and memory are then those of as many slots."""

RAYS = 16
"""Points on every disc's circle, to choose from; its centre is one more."""

EPSILON = 64 * float(np.finfo(float).eps)
"""64 eps: the factor of every margin."""

COORDINATE_ROUNDING = 1e-12
"""Share by which discs are widened, against the rounding of squares that are compared."""


@dataclass(frozen=True, eq=False)
class SlotGroups:
    """
    The slots 1..N in G groups of neighbouring slots, of one slot each where N is small.

    All slots of a group share one reachable set, which holds the reachable sets of all of them,
    and one set of multipliers; so one bound serves for all of them.

    :param edges: number of slots before each group, and N, (G + 1,).
    """

    edges: NDArray[np.int64]

    @classmethod
    def of(cls, slots: int, most: int = MOST_GROUPS) -> SlotGroups:
        """Return the groups of a mission of `slots` slots, at most `most`, as even as can be."""
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
        """Mean weights of the edges before and after a group in its slots, (G,) each."""
        count = self.count.astype(float)
        return (count - 1) / (2 * count), (count + 1) / (2 * count)

    @property
    def slots(self) -> int:
        """N."""
        return int(self.edges[-1])


def unit_circle(count: int) -> Array:
    """Return points on the unit circle at equal angles, (count, 2)."""
    angle = np.arange(count) * 2 * np.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], -1)


@dataclass(frozen=True, eq=False)
class EavesdropperSubset:
    """
    Places of eavesdroppers.

    No leak falls when an eavesdropper joins, so leaving some out lowers no plan's rate. And the
    leak to the worst point of a disc is at least that to any chosen point: for problem (P1)
    eavesdroppers without an error radius at chosen points do as well, and with them the
    objectives of (P1) and (P2) are the same.

    :param places: (E, 2) in m.
    :param radii: (E,) in m.
    :param advantages: by what factor the SNR is larger than at the ground node's receiver, (E,).
    :param owners: index of the eavesdropper of each place, (E,).
    """

    places: Array
    radii: Array
    advantages: Array
    owners: NDArray[np.intp]

    @classmethod
    def of(cls, scenario: Scenario, objective: str) -> EavesdropperSubset:
        """Return all candidates: discs for 'guaranteed', points of them for 'worst_case'."""
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
        Return the SINR at every place by the guarantee's formula, (E, N).

        :param positions: of a plan, (U, N + 2, 2) in m.
        :param powers: of the plan, (U, N) in W.
        """
        link = make_link(scenario, 'eavesdropper', axes=2).for_receivers(self.advantages[:, None])
        return bound_sinrs(link, positions[:, None, 1:-1] - self.places[:, None],
                           self.radii[:, None], powers[:, None])

    def select_loudest(self, sinrs: Array, most: int, colluding: bool) -> EavesdropperSubset:
        """
        Return at most `most` places, one in every disc before a second one in any.

        The first is the place with the largest leak over all slots, each further one raises the
        largest leak most. A plan may leak little into a disc just because its jammer sees to
        that, so no disc is left out for further places in a disc.

        :param sinrs: of the plan, (E, N).
        :param colluding: True if the SINRs of eavesdroppers add up.
        """
        chosen: list[int] = []
        listener = self.owners if colluding else np.zeros_like(self.owners)
        largest = np.zeros((listener[-1] + 1, sinrs.shape[1]))
        for _ in range(min(most, len(sinrs))):
            rest = largest.sum(0) - largest[listener]
            gain = np.log1p(rest + np.maximum(sinrs, largest[listener])).sum(1)
            gain[chosen] = -np.inf
            fresh = ~np.isin(self.owners, self.owners[chosen])
            best = int(np.where(fresh | ~fresh.any(), gain, -np.inf).argmax())
            chosen.append(best)
            largest[listener[best]] = np.maximum(largest[listener[best]], sinrs[best])
        keep = sorted(chosen)
        return EavesdropperSubset(self.places[keep], self.radii[keep], self.advantages[keep],
                                  self.owners[keep])


def end_tolerance(scenario: Scenario) -> float:
    """
    Return the tolerance of an end, in m.

    The tolerance is one of each coordinate, hence the factor; and coordinates that are compared in
    a UAV's own frame are off by a few eps of the mission's extent.
    """
    places = [scenario.ground_node, *(eve.position for eve in scenario.eavesdroppers),
              *(uav.start for uav in scenario.uavs), *(uav.goal for uav in scenario.uavs)]
    extent = float(np.abs(places).max())
    return 1.5 * POSITION_TOLERANCE + 1e-13 * extent


def margin(altitude: float, size: np.ndarray) -> np.ndarray:
    """
    Return the margin of a sum of logarithms and potentials, in nats.

    :param altitude: of the UAV, in units.
    :param size: of the potentials' terms, in nats.
    """
    return np.asarray(EPSILON * (200.0 + 10.0 / altitude + size))


def find_reference_snrs(scenario: Scenario) -> Array:
    """
    Return the reference SNRs of the links to the ground node and an eavesdropper, (2, U).

    Without an advantage. Fading with an outage multiplies the gain of each link by a constant, the
    quantile that counts; no lemma asks how large a link's constant is.
    """
    return np.array([np.broadcast_to(
        np.ravel(make_link(scenario, kind).reference_snr), len(scenario.uavs))
        for kind in ('ground_node', 'eavesdropper')])
