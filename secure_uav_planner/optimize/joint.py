"""
The joint method: positions and powers together.

Several starts are improved side by side on a coarse grid, the best are kept in stages, and the
winner is refined to the full grid, where a few more Newton steps finish it.
"""

import numpy as np

from .barrier import Barrier, Mission
from .fly_hover_fly import constant_powers, fly_hover_fly_positions
from .run import Run
from .starts import interior, offer_quieter, refined, several_starts
from ..channel.derivatives import SlotModel

_COARSE = 40  # Slots of the coarsest grid.
_FINER = 8  # How much finer the next grid is at most.
_SCOUTS = 4  # One in so many starts goes first.
_STAGES = ((10, 0.7), (5, 0.7), (7, 0.5))  # Steps, then the share of starts to keep.
_SAME = 2e-4  # Relative difference below which two starts count as one.
_LAST = 15  # Steps of those that are left.
_RIVALS = 2  # How many starts are finished at most,
_CLOSE = 0.01  # and how close to the best the second must be.
_COARSE_LEVEL, _FINAL_LEVEL = 1e-3, 1e-8
_STEPS = 150
_OFFERS = 4  # Steps between two offers to the run.
_FEW = 20  # Slots.
_WORTH_TRYING = 0.99
_PROMISING = 0.9  # Powers that are not optimised yet.
_HARDLY_ANY = 0.1  # Rate, in bit/s/Hz.


class _Stop(Exception):
    """The run must end; the argument is the status."""


def joint(run):
    """
    Improve a Run by the joint method until it has converged or must stop; return its status.

    Whatever happens, the run keeps the best feasible iterate.

    :param run: a Run; when `warm`, its present plan is the only start.
    """
    try:
        model = SlotModel.of(run.scenario)
        if run.warm:
            return _from_plan(run, model)
        return _from_several(run, model)
    except _Stop as stop:
        return stop.args[0]
    except np.linalg.LinAlgError:
        return 'numerical_trouble'


def _from_plan(run, model):
    """Improve the present plan."""
    scenario = run.scenario
    x = interior(scenario, model, run.positions, run.powers, scenario.slots, share=0.01)
    barrier = Barrier(model, Mission(scenario, model, scenario.slots), x[None], 1e-3)
    return _finish(run, barrier)


def _from_several(run, model):
    """Find the best of several starts on a coarse grid and finish it, and a close rival."""
    scenario = run.scenario
    slots = min(scenario.slots, _COARSE)
    mission = Mission(scenario, model, slots)
    x, levels = several_starts(scenario, model, slots)
    # A few of every kind first: in an easy mission all of them end in the same place.
    few = np.arange(0, len(x), _SCOUTS)
    barrier = _best_of(run, Barrier(model, mission, x[few], levels[few]))
    if len(barrier.x) > 1:
        rest = np.setdiff1d(np.arange(len(x)), few)
        others = _best_of(run, Barrier(model, mission, x[rest], levels[rest]))
        barrier = Barrier(model, mission, np.concatenate([barrier.x, others.x]),
                          np.concatenate([barrier.level, others.level]))
        _select(run, barrier, 0.5)
        for _ in range(_LAST):
            _advance(run, barrier, _COARSE_LEVEL)
        _select(run, barrier, 0.0)
    values = barrier.objective()
    rivals = np.flatnonzero(values >= (1 - _CLOSE) * values[0])[:_RIVALS]
    statuses = [_finish(run, _on_finer_grids(run, barrier, rival)) for rival in rivals]
    _try_powers_alone(run, model, values[0])
    return 'converged' if 'converged' in statuses else statuses[0]


def _best_of(run, barrier):
    """Improve all starts of a Barrier and keep the best in stages."""
    for steps, share in _STAGES:
        for _ in range(steps):
            _advance(run, barrier, _COARSE_LEVEL)
        _select(run, barrier, share)
        if len(barrier.x) == 1:
            break
    return barrier


def _select(run, barrier, share):
    """Keep a share of the starts of a Barrier, best first, and offer the best."""
    barrier.keep(_distinct(barrier.objective(), share))
    _offer(run, barrier)


def _distinct(values, share):
    """Return the best starts, one of each value, best first, and at least two of several."""
    order = np.argsort(-values)
    values = values[order]
    new = np.append(True, -np.diff(values) > _SAME * abs(values[0]))
    order = order[new]
    return order[:max(_RIVALS, int(np.ceil(share * len(order))))]


def _on_finer_grids(run, barrier, start):
    """Return one start of a Barrier on the full grid, by way of grids in between."""
    scenario, model = run.scenario, barrier.model
    coarse = Barrier(model, barrier.mission, barrier.x[[start]], barrier.level[start])
    slots = coarse.mission.slots
    while slots < scenario.slots:
        if slots > barrier.mission.slots:
            for _ in range(_STEPS):
                _advance(run, coarse, 1e-4)
                if coarse.finished[0]:
                    break
        parts = int(np.ceil(np.log(scenario.slots / slots) / np.log(_FINER)))
        slots = round(slots * (scenario.slots / slots)**(1 / parts))
        mission = Mission(scenario, model, slots)
        x = refined(coarse.mission, coarse.x[0], slots)
        coarse = Barrier(model, mission, x[None], coarse.level)
    return coarse


def _finish(run, barrier):
    """Converge on the full grid; return the status."""
    for step in range(1, _STEPS + 1):
        _advance(run, barrier, _FINAL_LEVEL, offer=True)
        if barrier.finished[0]:
            return 'converged'
        if step % _OFFERS == 0:
            _offer(run, barrier)
    return 'iteration_limit'


def _try_powers_alone(run, model, joint_value):
    """
    Offer fly-hover-fly with optimised powers where that may be better than what was found.

    With hardly any slack in time flights do not matter, with few slots who talks when does.

    :param joint_value: of the best start on the coarse grid, where the two are compared.
    """
    scenario = run.scenario
    positions = fly_hover_fly_positions(scenario)
    slots = min(scenario.slots, _COARSE)
    mission = Mission(scenario, model, slots)
    mission.fixed[:] = True
    x = []
    for jamming in (0.5, 0.05):
        powers = constant_powers(scenario, 0.9, jamming)
        x.append(interior(scenario, model, positions, powers, slots, share=0.0))
        x[-1][..., 0] *= 0.99
    barrier = Barrier(model, mission, np.array(x), 0.02)
    for _ in range(10):
        _advance(run, barrier, _COARSE_LEVEL)

    powers = constant_powers(scenario)
    quieter = Run(scenario, positions, powers)
    offer_quieter(quieter)
    if (slots > _FEW and run.rate > _HARDLY_ANY
            and barrier.objective().max() < _WORTH_TRYING * joint_value
            and quieter.rate < _PROMISING * run.rate):
        return

    def passed_on(_):
        run.report('power')
        return run.stop_reason() is not None

    from .alternating import optimise_powers  # Only now: CVXPY takes a second to import.
    # From the very start of the baseline, so that the result is no worse.
    alone = Run(scenario, positions, powers, passed_on, run.time_left)
    optimise_powers(alone)
    run.solver_time += alone.solver_time
    if run.offer(alone.positions, alone.powers):
        run.report('power')
    if run.stop_reason() is not None:
        raise _Stop(run.stop_reason())


def _advance(run, barrier, level, offer=False):
    """Take a step, report it, and raise _Stop where the run must end."""
    before = barrier.solver_time
    barrier.iterate(level)
    run.solver_time += barrier.solver_time - before
    if offer and barrier.finished[0] or run.stop_reason() is not None:
        _offer(run, barrier)
    run.report('joint')
    reason = run.stop_reason()
    if reason is not None:
        raise _Stop(reason)


def _offer(run, barrier):
    """Offer the best start of a Barrier to the run, on the full grid."""
    scenario, model = run.scenario, barrier.model
    x = barrier.x[barrier.objective().argmax()]
    if len(x) != scenario.slots:
        x = refined(barrier.mission, x, scenario.slots)
    ends = np.array([(uav.start, uav.goal) for uav in scenario.uavs])
    run.offer(np.concatenate([ends[:, :1], model.positions(x), ends[:, 1:]], axis=1),
              model.powers(x))
