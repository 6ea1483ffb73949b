"""Every tuned number of the joint method, in one place."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StartKind:
    """
    One kind of start, spread over the hovering places.

    :param count: the most starts of this kind.
    :param jamming: share of their average power with which the jammers begin; 0 transmits only
        where that wins without jamming.
    :param mu: barrier parameter to begin with.
    :param other_ways: the most starts that pass what is in the way on other sides.
    """

    count: int
    jamming: float
    mu: float
    other_ways: int = 0


@dataclass(frozen=True, kw_only=True)
class Stage:
    """
    Some steps from several starts, after which only the best go on.

    :param steps: Newton steps.
    :param keep: share of the distinct starts that go on.
    """

    steps: int
    keep: float


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """
    The tuned numbers of the joint method.

    What each is worth was measured on three missions of the paper and twelve random ones of 60
    slots, by halving and doubling it, or by leaving out one of several: the mean change of the
    rate, and that of the worst mission. `python -m secure_uav_planner.bench.sweep` repeats that,
    with times. The largest changes are those of single missions that end in another local
    optimum.
    """

    kinds: tuple[StartKind, ...] = (
        StartKind(count=4, jamming=0.9, mu=0.02),
        StartKind(count=8, jamming=0.05, mu=0.02, other_ways=8),
        StartKind(count=8, jamming=0.05, mu=0.003), StartKind(count=3, jamming=0.0, mu=1e-4))
    """
    The kinds of start: with jammers on; with jammers all but silent, so that the transmitter finds
    its flight first; the same closer to the boundary, for the few slots that win in a mission that
    is nearly lost; with jammers off, closer still. Measured: without member 0, -0.10% in the mean,
    -1.52% in the worst; without member 1, -0.12% in the mean, -1.41% in the worst; without member
    2, -0.24% in the mean, -3.74% in the worst; without member 3, 0% in the mean, 0% in the worst;
    member 2 with 4 starts instead of 8, -0.05% in the mean of 24 random missions and -2.1% in that
    of 16 with one jammer and two eavesdroppers, -33% in the worst of these. Other ways of member
    1: without them a circle of 80 m on the transmitter's way costs 0.5% at T = 120 s, as all
    scouts agree on the wrong side of it.
    """

    lone_jammer: float = 1e-3
    """
    Factor of the power of all jammers but one in a second start of each kind, because there can be
    too many jammers. Measured: 0.001 to 0.0005, -0.26% in the mean, -3.74% in the worst; 0.001 to
    0.002, 0% in the mean, -0.02% in the worst.
    """

    beside: float = 0.7
    """
    Distance of hovering places beside a target, in altitudes. Measured: 0.7 to 0.35, -0.08% in the
    mean, -0.95% in the worst; 0.7 to 0.85, -0.17% in the mean, -1.41% in the worst.
    """

    far: float = 3.0
    """
    Distance of the farthest hovering places, in distances beside. Measured: 3 to 1.5, -0.04% in
    the mean, -0.57% in the worst; 3 to 6, +0.02% in the mean, 0% in the worst.
    """

    coarse_slots: int = 40
    """
    Slots of the coarsest grid, on which starts compete. Measured: 40 to 20, -0.15% in the mean,
    -2.54% in the worst; 40 to 80, -0.30% in the mean, -2.34% in the worst.
    """

    refinement: int = 8
    """How much finer the next grid is at most. Measured: no mission changes."""

    scouts: int = 4
    """
    One in so many starts goes first; where they agree the others are not begun. Measured: 4 to 2,
    0% in the mean, 0% in the worst; 4 to 8, -0.24% in the mean, -3.74% in the worst.
    """

    agreed: float = 0.5
    """
    Share of them that must have met the best, if no other comes within `rival_gap` of it, for all
    to agree. No rate of 284 random missions changes by 1e-4, and T = 102 s takes half the time.
    """

    stages: tuple[Stage, ...] = (
        Stage(steps=10, keep=0.7), Stage(steps=5, keep=0.7), Stage(steps=7, keep=0.5))
    """
    The stages of the competition. Measured: without member 0, -0.08% in the mean, -0.95% in the
    worst; without member 1, -0.01% in the mean, -0.22% in the worst; without member 2, -0.34% in
    the mean, -3.74% in the worst.
    """

    last_steps: int = 15
    """
    Steps of the starts that are left after it. Measured: 15 to 8, -0.18% in the mean, -2.34% in
    the worst; 15 to 30, -0.25% in the mean, -3.74% in the worst.
    """

    distinct: float = 2e-4
    """
    Relative difference in rate below which two starts count as one. Measured: 0.0002 to 0.0001,
    +0.01% in the mean, 0% in the worst; 0.0002 to 0.0004, 0% in the mean, -0.01% in the worst.
    """

    rivals: int = 2
    """
    How many starts are finished on the full grid at most. Measured: 2 to 1, -1.01% in the mean,
    -11.88% in the worst; 2 to 4, 0% in the mean, -0.13% in the worst.
    """

    rival_gap: float = 0.01
    """
    How much lower than the best the second may be, as a share, to be finished. Measured: no
    mission changes.
    """

    coarse_mu: float = 1e-3
    """
    Barrier parameter at which the competition ends. Measured: 0.001 to 0.0005, -0.27% in the mean,
    -3.74% in the worst; 0.001 to 0.002, -0.27% in the mean, -3.74% in the worst.
    """

    middle_mu: float = 1e-4
    """Barrier parameter at which a grid in between ends. Measured: no mission changes."""

    refined_mu: float = 0.03
    """
    Barrier parameter with which a finer grid begins at least, where a limit of acceleration
    keeps interpolation from staying centred. At T = 102 s, 1e-3 stopped 6 to 11% below the best,
    and 0.01 1.2% below. The same with zones, fence or separation: with a circle of 80 m, 1e-3
    stopped 0.1% lower at T = 102 s.
    """

    final_mu: float = 1e-8
    """
    Barrier parameter at which the method has converged. Measured: 1e-08 to 5e-09, -0.01% in the
    mean, -0.13% in the worst; 1e-08 to 2e-08, -0.01% in the mean, -0.19% in the worst.
    """

    steps: int = 150
    """The most Newton steps on one grid. Measured: no mission changes."""

    try_every: int = 16
    """
    Steps between two proposals to the search, which repairs and evaluates each: that takes as long
    as a few compiled steps, and the proof of a worst case up to a hundred times as long. Measured:
    4 takes 1.06 times as long for (P2) and 1.2 times for (P1); no rate changes by more than 3e-6.
    """

    warm_share: float = 0.01
    """
    Share of the way into the interior that a plan is moved before it is improved further.
    Measured: 0.01 to 0.005, -0.08% in the mean, -1.18% in the worst; 0.01 to 0.02, -0.01% in the
    mean, -0.15% in the worst.
    """

    warm_mu: float = 1e-3
    """
    Barrier parameter with which an earlier plan begins. The sweep, which starts cold, does not
    measure it.
    """

    low_rate: float = 0.1
    """
    A mission with a rate below this, in bit/s/Hz, is hard: the best plan is improved once more
    and powers on a fixed flight are finished, even where all starts agree. No mission of the
    sweep changes; missions of fewer slots do.
    """

    again_mus: tuple[float, ...] = (0.05, 0.01)
    """
    Barrier parameters, as shares of the rate in nats, with which the best plan is improved once
    more, one after the other, where not all starts ended in the same place. Measured on 100 random
    missions of 100 slots: +0.48% in the mean, never lower, in 1.2 times the time; 0.2 and 0.04,
    +0.44%; 0.02 and 0.002, +0.45%. In the 16 of them whose starts agreed it gained nothing. In the
    sweep: without member 0, -0.29% in the mean, -3.74% in the worst; without member 1, -0.01% in
    the mean, -0.13% in the worst.
    """

    left_out_steps: int = 22
    """
    Steps of the starts that the competition left out, for which it goes on where jammers and
    eavesdroppers can be matched in several ways. All of it brings 0.29% in the mean of 100 random
    missions of 60 slots, and 9% in one of them, in 1.9 times the time; with it all 194 of 200 that
    have a rate are within 1% of the best of 100 random starts. Measured: 22 to 11, -0.27% in the
    mean, -3.74% in the worst; 22 to 44, +0.01% in the mean, -0.01% in the worst.
    """

    left_out_starts: int = 6
    """
    How many of all starts are then improved once more on the coarse grid. Measured: 6 to 3, -0.25%
    in the mean, -3.74% in the worst; 6 to 12, 0% in the mean, -0.07% in the worst. With 1, -0.21%
    in the mean of the 100 missions.
    """

    left_out_gap: float = 0.1
    """
    How much lower than the best they may be, as a share. Measured: 0.1 to 0.05, -0.25% in the
    mean, -3.74% in the worst; 0.1 to 0.2, 0% in the mean, 0% in the worst.
    """

    powers_jamming: tuple[float, ...] = (0.5, 0.05)
    """
    Shares of their average power with which jammers begin on fixed flights. Measured: no mission
    changes.
    """

    powers_mu: float = 0.02
    """
    Barrier parameter with which powers on fixed flights begin. No mission of the sweep changes;
    missions of fewer slots do.
    """

    powers_low_mu: float = 5e-4
    """
    Barrier parameter with which powers on fixed flights begin once more. Two hard missions of four
    UAVs were 0.001 and 0.2% below the alternating method without it, and with 0.002 the first of
    them still in most starts. No mission of the sweep changes.
    """

    powers_low_share: float = 0.01
    """
    The most that it may be, as a share of the rate in nats. A mission of four UAVs with a rate of
    0.0034 was 6% below the alternating method without it, and 0 to 6% with 0.1. No mission of the
    sweep changes.
    """

    powers_low_jamming: tuple[float, ...] = (1e-3, 1e-5)
    """
    Shares of their average power with which jammers begin then. In that mission, shares from 0 to
    1e-3 lead to the best, and 0.01 to 0.5 to 5% less. No mission of the sweep changes.
    """

    powers_probe_steps: int = 10
    """
    Steps on the coarse grid that decide whether powers alone are worth finishing. Measured: no
    mission changes.
    """

    powers_steps: int = 15
    """
    Steps after which only the best powers on a fixed flight are finished. No mission of the sweep
    changes.
    """

    powers_few_slots: int = 20
    """
    With at most so many slots, powers on a fixed flight are always finished. No mission of the
    sweep changes; missions of fewer slots do.
    """

    powers_near: float = 0.99
    """
    They also are where the probe reaches this share of the joint optimum. No mission of the
    sweep changes; missions of fewer slots do.
    """

    powers_near_at_once: float = 0.9
    """
    They also are where, before any step, they reach this share of it. No mission of the sweep
    changes; missions of fewer slots do.
    """

    worse: float = 1e-7
    """Leak, in nats, by which a place of a disc must be worse than all that count to count."""

    places_mu: float = 0.02
    """
    Barrier parameter with which (P1) begins from the plan of (P2). Measured with the numbers
    below on 24 random missions of 60 to 100 slots, as the mean of the worst-case rate: 0.02 to
    0.01, -0.04%; 0.02 to 0.05, -0.11%; 0.001, -0.9%. The sweep, of (P2), measures none of them.
    """

    places_final_mu: float = 1e-7
    """
    Barrier parameter at which (P1) has converged. Measured: 1e-07 to 1e-06, -0.003%; 1e-07 to
    1e-08, +0.01% in 1.03 times the time.
    """

    places_patience: int = 8
    """
    The most steps with it: places may go on moving to and fro. Measured: 8 to 5, -0.001%; 8 to
    15, no mission changes by 0.01%.
    """

    places_worth: float = 0.01
    """
    Share by which (P1) must have raised the worst-case rate for a second round, with places_mu
    again, where places went on moving in the first. Measured on 24 random missions of two UAVs
    with 100 slots and 24 of 60 to 100: without it -0.05% in the mean, -0.9% in the worst, in 0.9
    times the time of a solve; 0.01 to 0.005, no mission changes; to 0.02, -0.02% in the mean.
    """

    places_steps: int = 40
    """The most steps of the second round. Measured likewise: 40 to 60, +0.006% in the mean."""

    boundary: float = 0.995
    """
    Share of the way to its boundary that a variable may go in a step. Measured: 0.995 to 0.99,
    -0.02% in the mean, -0.22% in the worst; 0.995 to 0.9975, -0.08% in the mean, -0.95% in the
    worst.
    """

    power_factor: float = 10.0
    """
    Factor by which a power may change in a step. Measured: 10 to 5, -0.01% in the mean, -0.22% in
    the worst; 10 to 20, -0.17% in the mean, -2.35% in the worst.
    """

    sufficient_decrease: float = 1e-4
    """Armijo's share of the expected decrease. Measured: no mission changes."""

    clipped_trials: int = 3
    """
    Trials of a line search that stop every variable at its own limit. Measured: 3 to 2, -0.19% in
    the mean, -3.01% in the worst; 3 to 6, -0.14% in the mean, -2.49% in the worst.
    """

    uniform_trials: int = 17
    """
    Further trials, which go plainly along the step. Measured: 17 to 8, -0.01% in the mean, -0.09%
    in the worst; 17 to 34, -0.01% in the mean, -0.12% in the worst.
    """

    softening: float = 0.3
    """
    Rounding of the kink above an eavesdropper, in sqrt(mu). Measured: 0.3 to 0.15, -0.42% in the
    mean, -3.74% in the worst; 0.3 to 0.6, -0.36% in the mean, -3.74% in the worst.
    """

    patience: int = 15
    """
    Steps for one barrier parameter. Measured: 15 to 8, -0.53% in the mean, -3.82% in the worst; 15
    to 30, -0.26% in the mean, -3.74% in the worst.
    """

    dual_range: float = 1e4
    """
    How far a dual may leave its central value, as a factor. Measured: 10000 to 5000, -0.11% in the
    mean, -1.48% in the worst; 10000 to 20000, -0.26% in the mean, -3.74% in the worst.
    """

    mu_factor: float = 0.2
    """
    Factor by which the barrier parameter falls at least. Measured: 0.2 to 0.1, -0.08% in the mean,
    -1.33% in the worst; 0.2 to 0.4, 0% in the mean, 0% in the worst.
    """

    mu_power: float = 1.5
    """
    Power to which the barrier parameter is raised, where that lowers it further. Measured: 1.5 to
    0.75, -0.26% in the mean, -3.74% in the worst; 1.5 to 3, -0.36% in the mean, -4.15% in the
    worst.
    """

    centred: float = 0.5
    """
    Newton decrement for each UAV below which the barrier parameter falls. Measured: 0.5 to 0.25,
    0% in the mean, -0.22% in the worst; 0.5 to 1, -0.01% in the mean, -0.16% in the worst.
    """

    still: float = 0.01
    """Newton decrement below which a barrier parameter is done. Measured: no mission changes."""

    negligible: float = 1e-8
    """
    Gain of a step, in nats a slot, below which a barrier parameter is done as well. Measured: no
    mission changes.
    """


SCHEDULE = Schedule()
"""What the joint method uses unless it is told otherwise."""
