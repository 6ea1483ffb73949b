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
    """

    count: int
    jamming: float
    mu: float


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

    `python -m secure_uav_planner.bench.sweep` solves the benchmark's missions with each of them
    smaller and larger and writes what that costs in rate and in time.

    :param kinds: of starts. With jammers on; with jammers all but silent, so that the transmitter
        finds its flight first; the same closer to the boundary, for the few slots that win in a
        mission that is nearly lost; with jammers off, closer still.
    :param lone_jammer: factor of the power of all jammers but one in a second start of each kind,
        for jammers can be too many.
    :param beside: distance of hovering places beside a target, in altitudes.
    :param far: distance of the farthest hovering places, in distances beside.
    :param coarse_slots: slots of the coarsest grid, on which starts compete.
    :param refinement: how much finer the next grid is at most.
    :param scouts: one in so many starts goes first; where they agree the others are left out.
    :param stages: of the competition.
    :param last_steps: steps of the starts that are left after it.
    :param distinct: relative difference in rate below which two starts count as one.
    :param rivals: how many starts are finished on the full grid at most.
    :param rival_gap: how much lower than the best the second may be, as a share, to be finished.
    :param coarse_mu: barrier parameter at which the competition ends.
    :param middle_mu: barrier parameter at which a grid in between ends.
    :param refined_mu: barrier parameter with which a finer grid begins at least, where a limit of
        acceleration keeps interpolation from staying centred. At T = 102 s, 1e-3 stopped 6 to
        11% below the best, and 0.01 1.2% below.
    :param final_mu: barrier parameter at which the method has converged.
    :param steps: the most Newton steps on one grid.
    :param try_every: steps between two proposals to the search.
    :param warm_share: by which a plan goes into the interior to be started from,
    :param warm_mu: and the barrier parameter it is started with.
    :param powers_jamming: shares of their average power with which jammers begin on fixed flights,
    :param powers_mu: and the barrier parameter of these starts.
    :param powers_probe_steps: steps on the coarse grid that decide whether powers alone are worth
        finishing.
    :param powers_few_slots: with so few slots they always are,
    :param powers_low_rate: as in a mission with a rate below this, in bit/s/Hz.
    :param powers_near: they are where the probe comes as near to the joint optimum as this share,
    :param powers_near_at_once: or, before any step, as near as this.
    :param boundary: share of the way to its boundary that a variable may go in a step.
    :param power_factor: by which a power may change in a step.
    :param sufficient_decrease: Armijo's share of the expected decrease.
    :param clipped_trials: trials of a line search that stop every variable at its own limit,
    :param uniform_trials: and those that then go along the step as it is.
    :param softening: rounding of the kink above an eavesdropper, in sqrt(mu).
    :param patience: steps for one barrier parameter.
    :param dual_range: how far a dual may leave its central value, as a factor.
    :param mu_factor: by which the barrier parameter falls, or
    :param mu_power: the power it is raised to, whichever is less.
    :param centred: Newton decrement for each UAV below which the barrier parameter falls.
    :param still: Newton decrement below which a barrier parameter is done,
    :param negligible: or the gain of a step in nats a slot.
    """

    kinds: tuple[StartKind, ...] = (
        StartKind(count=4, jamming=0.9, mu=0.02), StartKind(count=8, jamming=0.05, mu=0.02),
        StartKind(count=4, jamming=0.05, mu=0.003), StartKind(count=3, jamming=0.0, mu=1e-4))
    lone_jammer: float = 1e-3
    beside: float = 0.7
    far: float = 3.0
    coarse_slots: int = 40
    refinement: int = 8
    scouts: int = 4
    stages: tuple[Stage, ...] = (
        Stage(steps=10, keep=0.7), Stage(steps=5, keep=0.7), Stage(steps=7, keep=0.5))
    last_steps: int = 15
    distinct: float = 2e-4
    rivals: int = 2
    rival_gap: float = 0.01
    coarse_mu: float = 1e-3
    middle_mu: float = 1e-4
    refined_mu: float = 0.03
    final_mu: float = 1e-8
    steps: int = 150
    try_every: int = 4
    warm_share: float = 0.01
    warm_mu: float = 1e-3
    powers_jamming: tuple[float, ...] = (0.5, 0.05)
    powers_mu: float = 0.02
    powers_probe_steps: int = 10
    powers_few_slots: int = 20
    powers_low_rate: float = 0.1
    powers_near: float = 0.99
    powers_near_at_once: float = 0.9
    boundary: float = 0.995
    power_factor: float = 10.0
    sufficient_decrease: float = 1e-4
    clipped_trials: int = 3
    uniform_trials: int = 17
    softening: float = 0.3
    patience: int = 15
    dual_range: float = 1e4
    mu_factor: float = 0.2
    mu_power: float = 1.5
    centred: float = 0.5
    still: float = 0.01
    negligible: float = 1e-8


SCHEDULE = Schedule()
"""What the joint method uses unless it is told otherwise."""
