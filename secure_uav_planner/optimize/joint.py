"""The joint method: positions and powers together, from several starts on a coarse grid."""

import numpy as np

from .barrier import Barrier, Mission
from .derivatives import SlotModel
from .fly_hover_fly import fly_hover_fly_positions
from .starts import hovering_places

_COARSE = 40


def joint(run):
    """
    Improve a Run by the joint method until it has converged or must stop; return its status.
    """
    scenario = run.scenario
    model = SlotModel.of(scenario)
    if getattr(run, 'warm', False):
        x = _interior(scenario, model, run.positions, run.powers, scenario.slots)
        return _finish(run, model, x[None], 1e-3)
    slots = min(scenario.slots, _COARSE)
    mission = Mission(scenario, model, slots)
    x = np.stack([_interior(scenario, model, fly_hover_fly_positions(scenario, places), None,
                            slots) for places in hovering_places(scenario)])
    barrier = Barrier(model, mission, x, 0.1)
    for iteration in range(16):
        barrier.iterate(1e-3)
        run.report('joint')
        if run.stop_reason():
            return run.stop_reason()
    best = barrier.objective().argmax()
    x = _refined(mission, barrier.x[best], scenario.slots)
    run.solver_time += barrier.solver_time
    return _finish(run, model, x[None], barrier.level[best])


def _finish(run, model, x, level):
    scenario = run.scenario
    barrier = Barrier(model, Mission(scenario, model, scenario.slots), x, level)
    for iteration in range(100):
        barrier.iterate(1e-6)
        run.offer(_positions(scenario, model, barrier.x[0]), model.powers(barrier.x[0]))
        run.report('joint')
        if run.stop_reason():
            return run.stop_reason()
        if barrier.finished[0]:
            return 'converged'
    return 'iteration_limit'


def _positions(scenario, model, x):
    ends = np.array([(uav.start, uav.goal) for uav in scenario.uavs])
    return np.concatenate([ends[:, :1], model.positions(x), ends[:, 1:]], axis=1)


def _interior(scenario, model, positions, powers, slots, share=0.05):
    """Return the strictly feasible x (slots, U, 3) near a plan."""
    points = np.linspace(0, 1, slots + 2)
    old = np.linspace(0, 1, positions.shape[1])
    line = positions[:, :1] + points[:, None] * (positions[:, -1:] - positions[:, :1])
    path = np.stack([[np.interp(points, old, p[:, k]) for k in range(2)] for p in positions])
    path = np.swapaxes(path, 1, 2)
    path += share * (line - path)
    average = np.array([uav.average_power for uav in scenario.uavs])[:, None]
    peak = np.array([uav.peak_power for uav in scenario.uavs])[:, None]
    if powers is None:
        power = np.repeat(0.9 * average, slots, axis=1)
    else:
        power = np.stack([np.interp(points[1:-1], old[1:-1], p) for p in powers])
        power = np.clip(power, 0.01 * average, 0.99 * peak)
        power *= np.minimum(1, 0.99 * average / power.mean(axis=1, keepdims=True))
    return model.variables(path[:, 1:-1], power)


def _refined(mission, x, slots):
    points = np.linspace(0, 1, slots + 2)[1:-1]
    old = np.linspace(0, 1, len(x) + 2)
    full = np.concatenate([x[:1], x, x[-1:]])
    full[0, :, 1:] = mission.starts
    full[-1, :, 1:] = mission.goals
    flat = full.reshape(len(full), -1)
    fine = np.stack([np.interp(points, old, column) for column in flat.T], axis=-1)
    fine = fine.reshape(slots, *x.shape[1:])
    mean = fine[..., 0].mean(axis=0)
    fine[..., 0] *= np.minimum(1, np.minimum(x[..., 0].mean(axis=0), 0.999) / mean)
    return fine
