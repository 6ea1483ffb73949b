"""A primal-dual interior-point method for problem (P2), for several starts at once."""

import time

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from .derivatives import Slots

_BOUNDARY = 0.995
_ARMIJO = 1e-4
_SOFTENING = 0.3


class Barrier:
    """
    Newton's method on the barrier function of (P2) in positions and powers together.

    Slots couple only through speed and average power, so that the Hessian is banded but for one
    row for each UAV: a step costs time linear in the number of slots. Several starts (S) are
    advanced side by side, which costs little more than one. Iterates are strictly feasible.

    The objective is the sum over slots in nats of the leak less r_0; every inequality c >= 0 has
    the term -mu log c, that of average power N times. The largest leak is an epigraph variable
    that is eliminated slot by slot.

    :param model: a SlotModel.
    :param mission: a Mission, the limits in the model's units.
    :param x: strictly feasible starts, (S, N, U, 3).
    :param level: mu to begin with.
    """

    def __init__(self, model, mission, x, level, mode='delta'):
        self.model = model
        self.mission = mission
        self.mode = mode
        self.nfail = 0
        self.solver_time = 0.0
        self.x = x
        starts, slots, uavs = x.shape[:3]
        self.level = np.full(starts, float(level))
        self.shift = np.zeros(starts)
        self.error = np.full(starts, np.inf)
        self.stalled = np.zeros(starts, bool)
        self.multipliers = [_spread(self.level, c) / c for c in self._constraints(x)[1]]
        self.multipliers[3] = self.multipliers[3] * slots
        self._share = None
        self._pattern = _pattern(uavs)

    factor=0.2; power=1.5
    def keep(self, chosen):
        """Go on with some of the starts only."""
        for name in ('x', 'level', 'shift', 'error', 'stalled'):
            setattr(self, name, getattr(self, name)[chosen])
        self.multipliers = [y[chosen] for y in self.multipliers]
        if self._share is not None:
            self._share = self._share[chosen]

    def _constraints(self, x):
        """Return the moves (S, N+1, U, 2) and c of speed, low, high and average power."""
        mission = self.mission
        path = np.empty((len(x), x.shape[1] + 2, *x.shape[2:3], 2))
        path[:, 1:-1] = x[..., 1:]
        path[:, 0] = mission.starts
        path[:, -1] = mission.goals
        moves = np.diff(path, axis=1)
        speed = 1.0 - (moves**2).sum(axis=-1) / mission.steps**2
        speed = np.where(mission.fixed, 1.0, speed)
        power = x[..., 0]
        return moves, [speed, power, 1.0 - power / mission.peaks, 1.0 - power.mean(axis=1)]

    def _value(self, x, level):
        """Return the barrier function, (S,); infinite where x is not strictly feasible."""
        slots = Slots(self.model, x, _softening(level))
        constraints = self._constraints(x)[1]
        top = _epigraph(slots.leaks, level)
        value = (top - slots.ground).sum(axis=1)
        if slots.leaks.shape[-1] > 1:
            ratio = (top[..., None] - slots.leaks) / _spread(level, slots.leaks)
            value -= level * np.log(ratio).sum(axis=(1, 2))
        with np.errstate(invalid='ignore', divide='ignore'):
            logs = [np.log(c).reshape(len(x), -1).sum(axis=1) for c in constraints]
        value -= level * (logs[0] + logs[1] + logs[2] + x.shape[1] * logs[3])
        return np.where(np.isfinite(value), value, np.inf)

    def objective(self):
        """Return the mean guaranteed rates in nats without any softening, (S,)."""
        slots = Slots(self.model, self.x)
        return np.maximum(slots.ground - slots.leaks.max(axis=-1), 0.0).mean(axis=1)

    def iterate(self, final, tolerance=10.0):
        """Take one step of every start, lowering mu towards `final` as accuracy allows."""
        starts, count, uavs = self.x.shape[:3]
        x, mission = self.x, self.mission
        moves, constraints = self._constraints(x)
        slots = Slots(self.model, x, _softening(self.level))
        top = _epigraph(slots.leaks, self.level)
        gradients = slots.first_derivatives()
        gap = top[..., None] - slots.leaks
        primal_share = _spread(self.level, gap) / gap
        share = primal_share if self._share is None else self._share
        # How far from the solution for the present mu.
        residual = -gradients[..., 0, :, :] + (
            share[..., None, None] * gradients[..., 1:, :, :]).sum(axis=-3)
        y_speed, y_low, y_high, y_mean = self.multipliers
        scale = -2.0 / mission.steps[:, None]**2
        residual[..., 0] -= y_low - y_high / mission.peaks - (y_mean / count)[:, None]
        force = (y_speed[..., None] * scale) * moves
        residual[..., 1:] -= force[:, :-1] - force[:, 1:]
        residual[..., 1:] *= ~mission.fixed[:, None]
        unit = np.concatenate([(y * c).reshape(starts, -1) / (count if i == 3 else 1)
                               for i, (y, c) in enumerate(zip(self.multipliers, constraints))],
                              axis=1)
        while True:
            off = np.abs(unit - self.level[:, None]).max(axis=1)
            self.error = np.maximum(np.abs(residual).reshape(starts, -1).max(axis=1), off)
            done = (self.error <= tolerance * self.level) & (self.level > final)
            if not done.any():
                break
            self.level = np.where(done, np.maximum(
                final, np.minimum(0.2 * self.level, self.level**1.5)), self.level)
        level = self.level
        # The Newton system.
        if self.level is not None:
            gap = _epigraph(slots.leaks, level)[..., None] - slots.leaks
            primal_share = _spread(level, gap) / gap
        gradient = -gradients[..., 0, :, :] + (
            primal_share[..., None, None] * gradients[..., 1:, :, :]).sum(axis=-3)
        pull = [_spread(level, c) / c for c in constraints]
        gradient[..., 0] -= pull[1] - pull[2] / mission.peaks - pull[3][:, None]
        force = (pull[0][..., None] * scale) * moves
        gradient[..., 1:] -= force[:, :-1] - force[:, 1:]
        gradient[..., 1:] *= ~mission.fixed[:, None]
        weights = np.concatenate([-np.ones_like(share[..., :1]),
                                  share / share.sum(axis=-1, keepdims=True)], axis=-1)
        hessian = slots.second_derivative(weights)
        if share.shape[-1] > 1:
            ratio = share / gap
            leaks = gradients[..., 1:, :, :].reshape(*gap.shape, 3 * uavs)
            mean = (ratio[..., None] * leaks).sum(axis=-2) / ratio.sum(axis=-1)[..., None]
            rows = np.sqrt(ratio)[..., None] * (leaks - mean[..., None, :])
            hessian += np.swapaxes(rows, -1, -2) @ rows
        started = time.perf_counter()
        step = self._direction(moves, constraints, gradient, hessian)
        self.solver_time += time.perf_counter() - started
        slope = (step * gradient).sum(axis=(1, 2, 3))
        # Along the direction: how far, and how the multipliers follow.
        turns = np.diff(np.pad(step[..., 1:], ((0, 0), (1, 1), (0, 0), (0, 0))), axis=1)
        changes = [scale[:, 0] * (moves * turns).sum(axis=-1), step[..., 0],
                   -step[..., 0] / mission.peaks, -step[..., 0].mean(axis=1)]
        longest = np.minimum(1.0, self._longest(moves, turns, constraints, changes))
        length, dual_length = longest.copy(), np.ones(starts)
        old_y = self.multipliers
        new_y = []
        for index, (y, c, p, change) in enumerate(zip(old_y, constraints, pull, changes)):
            weight = count if index == 3 else 1
            dy = weight * p - y - (y / c) * change
            new_y.append(dy)
            with np.errstate(divide='ignore', invalid='ignore'):
                limit = np.where(dy < 0, -_BOUNDARY * y / dy, np.inf)
            dual_length = np.minimum(dual_length, limit.reshape(starts, -1).min(axis=1))
        value = self._value(x, level)
        todo = np.arange(starts)
        accepted = x.copy()
        for _ in range(25):
            trial = x[todo] + length[todo, None, None, None] * step[todo]
            new = self._value(trial, level[todo])
            bound = value[todo] + _ARMIJO * length[todo] * slope[todo] + 1e-11 * np.abs(
                value[todo])
            good = new <= bound
            accepted[todo[good]] = trial[good]
            todo = todo[~good]
            if not len(todo):
                break
            length[todo] *= 0.5
        self.stalled = np.zeros(starts, bool)
        self.stalled[todo] = True
        length[todo] = 0.0
        self.length = length
        self.decrement = -slope / (count * level)
        if tolerance < 0:
            ready = (self.decrement * length <= -tolerance) & (length > 0.5)
            self.level = np.where(ready, np.maximum(final, np.minimum(self.factor * level, level**self.power)), level)
            self.finished = (level <= final) & (self.decrement <= 0.01)
        self.shift = np.where(self.stalled, np.maximum(10 * self.shift, 1e-2), self.shift)
        self.x = accepted
        if share.shape[-1] > 1:
            dt = -((1 - primal_share.sum(axis=-1)) - (
                ratio * (leaks * step.reshape(starts, count, 1, -1)).sum(axis=-1)).sum(axis=-1)
                ) / ratio.sum(axis=-1)
            moved = dt[..., None] - (leaks * step.reshape(starts, count, 1, -1)).sum(axis=-1)
            change = primal_share - share - ratio * moved
            limit = np.where(change < 0, -_BOUNDARY * share / np.minimum(change, -1e-300), np.inf)
            by = np.minimum(dual_length, limit.reshape(starts, -1).min(axis=1))
            share = share + _spread(by, change) * change
            self._share = share / share.sum(axis=-1, keepdims=True)
        constraints = self._constraints(self.x)[1]
        self.multipliers = []
        for index, (y, dy, c) in enumerate(zip(old_y, new_y, constraints)):
            central = _spread(level, c) / c * (count if index == 3 else 1)
            y = y + _spread(dual_length, y) * dy
            self.multipliers.append(np.clip(y, central / 1e4, central * 1e4))

    def _longest(self, moves, turns, constraints, changes):
        """Return how far each start may go until a constraint has lost 99.5%, (S,)."""
        starts = len(moves)
        longest = np.full(starts, np.inf)
        for c, change in zip(constraints[1:], changes[1:]):
            limit = _BOUNDARY * c / np.maximum(-change, 1e-300)
            limit = np.where(change < 0, limit, np.inf)
            longest = np.minimum(longest, limit.reshape(starts, -1).min(axis=1))
        squared = self.mission.steps**2
        a = (turns**2).sum(axis=-1) / squared
        b = -0.5 * changes[0]
        root = np.sqrt(b**2 + a * _BOUNDARY * constraints[0])
        # The positive root of a s^2 + 2 b s = 0.995 c, without cancellation for either sign.
        down = np.where(b > 0, _BOUNDARY * constraints[0] / np.maximum(root + b, 1e-300),
                        (root - b) / np.maximum(a, 1e-300))
        down = np.where(self.mission.fixed, np.inf, down)
        return np.minimum(longest, down.reshape(starts, -1).min(axis=1))

    def _direction(self, moves, constraints, gradient, hessian):
        """Return minus the inverse of the (made positive) Hessian times the gradient."""
        starts, count, uavs = gradient.shape[:3]
        mission = self.mission
        y_speed, y_low, y_high, y_mean = self.multipliers
        size = 3 * uavs
        power = np.arange(0, size, 3)
        extra = np.zeros((starts, count, uavs, 3, 3))
        extra[..., 0, 0] = y_low / constraints[1] + y_high / (
            mission.peaks**2 * constraints[2])
        squared = mission.steps**2
        outer = (4 * y_speed / (constraints[0] * squared**2))[..., None, None] * (
            moves[..., :, None] * moves[..., None, :])
        tension = 2 * y_speed / squared
        outer[..., 0, 0] += tension
        outer[..., 1, 1] += tension
        outer *= ~mission.fixed[:, None, None]
        extra[..., 1:, 1:] = outer[:, :-1] + outer[:, 1:]
        if mission.fixed.any():
            for uav in np.flatnonzero(mission.fixed):
                at = slice(3 * uav + 1, 3 * uav + 3)
                hessian[..., at, :] = 0.0
                hessian[..., :, at] = 0.0
                extra[..., uav, 1, 1] += 1.0
                extra[..., uav, 2, 2] += 1.0
        pattern, inside = self._pattern

        def band_of(blocks):
            blocks = blocks.copy()
            view = np.einsum('...ujuk->...ujk', blocks.reshape(starts, count, uavs, 3, uavs, 3))
            view += extra
            band = np.where(inside, blocks.reshape(starts, count, -1)[..., pattern], 0.0)
            for a in (1, 2):
                for b in (1, 2):
                    band[:, :-1, b::3, size + a - b] -= outer[:, 1:-1, :, a - 1, b - 1]
            return band.reshape(starts, count * size, -1)

        band = band_of(hessian)
        convex = None
        stiffness = y_mean / constraints[3] / count**2
        result = np.empty((starts, count * size))
        for start in range(starts):
            rhs = np.zeros((count * size, 1 + uavs))
            rhs[:, 0] = -gradient[start].reshape(-1)
            for uav in range(uavs):
                rhs[3 * uav::size, 1 + uav] = 1.0
            shift = 0.0
            for attempt in range(30):
                if attempt and self.mode == 'convex':
                    if convex is None:
                        convex = band_of(_projected(hessian))
                    this = convex[start].copy()
                    shift = 0.0 if attempt == 1 else max(1e-6, 10 * shift)
                else:
                    this = band[start].copy()
                    if attempt == 1:
                        shift = max(1e-4, self.shift[start] / 3)
                    elif attempt > 1:
                        shift *= 8.0
                this[:, 0] += shift + 1e-12
                factor, info = dpbtrf(this.T, lower=1, overwrite_ab=1)
                if info == 0:
                    solved = dpbtrs(factor, rhs, lower=1)[0]
                    along = solved[:, 1:]
                    sums = np.stack([solved[3 * u::size].sum(axis=0) for u in range(uavs)])
                    inner = np.diag(1.0 / stiffness[start]) + sums[:, 1:]
                    step = solved[:, 0] - along @ np.linalg.solve(inner, sums[:, 0])
                    if np.isfinite(step).all() and step @ rhs[:, 0] > 0:
                        break
                self.nfail += 1
            else:
                step = rhs[:, 0]
            self.shift[start] = shift
            result[start] = step
        return result.reshape(gradient.shape)


def _projected(blocks):
    values, vectors = np.linalg.eigh(blocks)
    values = np.maximum(values, 0.0)
    return (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _spread(per_start, like):
    return np.asarray(per_start).reshape(-1, *[1] * (like.ndim - 1))


def _softening(level):
    return _SOFTENING * np.sqrt(level)[:, None]


def _epigraph(leaks, level):
    """Return the t that minimises t - mu sum_e log(t - leak_e), for all slots, (S, N)."""
    largest = leaks.max(axis=-1)
    level = _spread(level, largest)
    if leaks.shape[-1] == 1:
        return largest + level
    below = (largest[..., None] - leaks) / level[..., None]
    t = np.ones_like(largest)
    for _ in range(12):
        inverse = 1.0 / (t[..., None] + below)
        # Newton on sum 1 / (t + below) = 1 from the left of its root, so without overshooting.
        t = t + (inverse.sum(axis=-1) - 1.0) / (inverse**2).sum(axis=-1)
    return largest + level * t


def _pattern(uavs):
    """Return where in a slot's Hessian each entry of the lower band is, and which are inside."""
    size = 3 * uavs
    column, offset = np.meshgrid(np.arange(size), np.arange(size + 2), indexing='ij')
    row = column + offset
    inside = row < size
    return np.where(inside, row, 0) * size + column, inside


class Mission:
    """
    The limits of a Scenario in the units of a SlotModel, for any number of slots.

    :param model: a SlotModel of the scenario.
    :param slots: into which to divide the flight; its length stays the scenario's.
    """

    def __init__(self, scenario, model, slots):
        self.slots = slots
        self.starts = (np.array([uav.start for uav in scenario.uavs]) - model.origin) / model.length
        self.goals = (np.array([uav.goal for uav in scenario.uavs]) - model.origin) / model.length
        self.steps = scenario.max_step * (scenario.slots + 1) / (slots + 1) / model.length
        self.peaks = np.array([uav.peak_power for uav in scenario.uavs]) / model.power
        reach = np.linalg.norm(self.goals - self.starts, axis=-1)
        self.fixed = reach > (slots + 1) * self.steps * (1 - 1e-6)
