"""A primal-dual interior-point method for problem (P2), for several starts side by side."""

import time

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from ..channel.derivatives import Slots

_BOUNDARY = 0.995  # The share of the way to its boundary that a variable may go in a step.
_FACTOR = 10.0  # By which a power may change in a step.
_ARMIJO = 1e-4
_CLIPPED, _UNIFORM = 3, 17  # Trials of a line search.
_SOFTENING = 0.3
_PATIENCE = 15  # Steps for one mu.
_DUAL_RANGE = 1e4
_NEGLIGIBLE = 1e-8  # Gain of a step in nats a slot.


class Mission:
    """
    The limits of a Scenario in the units of a SlotModel, for any number of slots.

    :param scenario: whose flight is divided into slots; its length stays the scenario's.
    :param model: a SlotModel of it.
    :param slots: into how many.
    """

    def __init__(self, scenario, model, slots):
        self.slots = slots
        self.starts, self.goals = (
            (np.array([getattr(uav, end) for uav in scenario.uavs]) - model.origin) / model.length
            for end in ('start', 'goal'))
        self.steps = scenario.max_step * (scenario.slots + 1) / (slots + 1) / model.length
        self.peaks = np.array([uav.peak_power for uav in scenario.uavs]) / model.power
        # Where there is no slack the straight line is the only flight, and nothing is inside.
        reach = np.linalg.norm(self.goals - self.starts, axis=-1)
        self.fixed = reach > (slots + 1) * self.steps * (1 - 1e-7)


class Barrier:
    """
    Newton's method on the barrier function of (P2) in positions and powers together.

    The objective is the sum over slots of the largest leak less r_0, in nats. Every inequality
    c >= 0 has the term -mu log c, that of average power N times. The largest leak t has
    -mu log(t - leak) for every eavesdropper; t is eliminated slot by slot. Slots couple only
    through speed and average power, so the Hessian is a band and one row for each UAV, and a
    step costs time linear in the number of slots. Where the band is not positive definite, the
    Hessian of the slots to blame is projected on the semidefinite cone.

    Iterates are strictly feasible. S starts are advanced at once, which costs little more than
    one as long as slots are few.

    :param model: a SlotModel.
    :param mission: a Mission.
    :param x: strictly feasible starts, (S, N, U, 3), as Slots has them.
    :param level: mu to begin with.
    """

    def __init__(self, model, mission, x, level):
        self.model = model
        self.mission = mission
        self.solver_time = 0.0
        self.x = x
        starts, slots, uavs = x.shape[:3]
        self.level = np.full(starts, 1.0) * level
        self.finished = np.zeros(starts, bool)
        self._age = np.zeros(starts, int)
        self._weights = (1, 1, 1, slots)
        self._multipliers = [weight * _spread(self.level, c) / c for weight, c in zip(
            self._weights, self._constraints(x)[1])]
        self._share = None
        self._known = None
        self._pattern = _pattern(uavs)

    def keep(self, chosen):
        """Go on with some of the starts only, given as an index array."""
        for name in ('x', 'level', 'finished', '_age'):
            setattr(self, name, getattr(self, name)[chosen])
        self._multipliers = [y[chosen] for y in self._multipliers]
        self._share = None if self._share is None else self._share[chosen]
        self._known = None

    def objective(self):
        """Return the mean guaranteed rates, losing slots silenced, in nats, (S,)."""
        slots = Slots(self.model, self.x)
        return np.maximum(slots.ground - slots.leaks.max(axis=-1), 0.0).mean(axis=1)

    def iterate(self, final):
        """
        Take one step from every start, then lower its mu towards `final` where it may be.

        A start is `finished` when it has converged for that mu, or makes no more progress.

        :raises numpy.linalg.LinAlgError: when no step can be computed.
        """
        x, level, mission = self.x, self.level, self.mission
        if self._known is None:
            self._known = self._evaluate(x, level)
        value, slots, top, moves, constraints = self._known
        gradient, hessian, leaks = self._model_of_slots(slots, top, level)
        push = [weight * _spread(level, c) / c for weight, c in zip(self._weights, constraints)]
        gradient[..., 0] -= push[1] - push[2] / mission.peaks - push[3][:, None] / x.shape[1]
        slant = -2.0 / mission.steps[:, None]**2
        force = push[0][..., None] * slant * moves
        gradient[..., 1:] -= force[:, :-1] - force[:, 1:]
        gradient[..., 1:] *= ~mission.fixed[:, None]
        started = time.perf_counter()
        step = self._newton_step(moves, constraints, gradient, hessian)
        self.solver_time += time.perf_counter() - started

        path = np.zeros((len(x), x.shape[1] + 2, *x.shape[2:3], 2))
        path[:, 1:-1] = step[..., 1:]
        turns = np.diff(path, axis=1)
        changes = [(slant * moves * turns).sum(axis=-1), step[..., 0],
                   -step[..., 0] / mission.peaks, -step[..., 0].mean(axis=1)]
        slope = (step * gradient).sum(axis=(1, 2, 3))
        if not np.isfinite(slope).any():
            raise np.linalg.LinAlgError('no start has a finite step')
        length = self._line_search(
            step, gradient, slope, value, *self._reach(turns, constraints, changes))
        self._follow(changes, push, constraints, leaks, step)
        decrement = -slope / (x.shape[1] * level)
        self._age += 1
        tired = (self._age >= _PATIENCE) | (length == 0.0)
        near = (decrement <= 0.5 * x.shape[2]) & (length > 0.5)
        # What another step gains is below a hundredth of what mu costs, or below 1e-8 nats a slot.
        still = decrement <= np.maximum(0.01, _NEGLIGIBLE / level)
        self.finished = (level <= final) & (still | tired)
        lower = (near | tired) & (level > final)
        self._age[lower] = 0
        if lower.any():
            self.level = np.where(lower, np.maximum(
                final, np.minimum(0.2 * level, level**1.5)), level)
            self._known = None

    def _constraints(self, x):
        """Return the moves (S, N+1, U, 2) and c of speed, low, high and average power."""
        mission = self.mission
        path = np.empty((len(x), x.shape[1] + 2, *x.shape[2:3], 2))
        path[:, 1:-1] = x[..., 1:]
        path[:, 0] = mission.starts
        path[:, -1] = mission.goals
        moves = np.diff(path, axis=1)
        speed = 1.0 - (moves**2).sum(axis=-1) / mission.steps**2
        speed[..., mission.fixed] = 1.0
        power = x[..., 0]
        return moves, [speed, power, 1.0 - power / mission.peaks, 1.0 - power.mean(axis=1)]

    def _evaluate(self, x, level):
        """Return the barrier function (S,), infinite outside, and what it was computed from."""
        slots = Slots(self.model, x, _SOFTENING * np.sqrt(level)[:, None])
        moves, constraints = self._constraints(x)
        top = _epigraph(slots.leaks, level)
        value = (top - slots.ground).sum(axis=1)
        if slots.leaks.shape[-1] > 1:
            ratio = (top[..., None] - slots.leaks) / _spread(level, slots.leaks)
            value -= level * np.log(ratio).sum(axis=(1, 2))
        with np.errstate(invalid='ignore', divide='ignore'):
            for weight, c in zip(self._weights, constraints):
                value -= weight * level * np.log(c).reshape(len(x), -1).sum(axis=1)
        value[~np.isfinite(value)] = np.inf
        return value, slots, top, moves, constraints

    def _model_of_slots(self, slots, top, level):
        """Return gradient and Hessian of the objective, and what _follow needs of the leaks."""
        rates = slots.first_derivatives()
        ground, leaks = rates[..., 0, :, :], rates[..., 1:, :, :]
        if leaks.shape[-3] == 1:
            weights = np.broadcast_to([-1.0, 1.0], rates.shape[:3])
            return leaks[..., 0, :, :] - ground, slots.second_derivative(weights), None
        gap = top[..., None] - slots.leaks
        central = _spread(level, gap) / gap
        gradient = (central[..., None, None] * leaks).sum(axis=-3) - ground
        share = central if self._share is None else self._share
        hessian = slots.second_derivative(
            np.concatenate([np.full_like(share[..., :1], -1.0), share], axis=-1))
        ratio = share / gap
        flat = leaks.reshape(*gap.shape, -1)
        mean = (ratio[..., None] * flat).sum(axis=-2) / ratio.sum(axis=-1)[..., None]
        rows = np.sqrt(ratio)[..., None] * (flat - mean[..., None, :])
        hessian += np.swapaxes(rows, -1, -2) @ rows
        return gradient, hessian, (flat, central, share, ratio)

    def _newton_step(self, moves, constraints, gradient, hessian):
        """Return minus the inverse of the Hessian, made positive, times the gradient."""
        starts, count, uavs = gradient.shape[:3]
        mission, size = self.mission, 3 * gradient.shape[2]
        speed, low, high, mean = self._multipliers
        # Of the barrier: 2 x 2 blocks for a move, the powers' diagonal.
        squared = mission.steps**2
        tension = (4 * speed / (constraints[0] * squared**2))[..., None, None] * (
            moves[..., :, None] * moves[..., None, :])
        tension[..., 0, 0] += 2 * speed / squared
        tension[..., 1, 1] += 2 * speed / squared
        tension[..., mission.fixed, :, :] = 0.0
        extra = np.zeros((starts, count, uavs, 3, 3))
        extra[..., 0, 0] = low / constraints[1] + high / (mission.peaks**2 * constraints[2])
        extra[..., 1:, 1:] = tension[:, :-1] + tension[:, 1:]
        for uav in np.flatnonzero(mission.fixed):
            hessian[..., 3 * uav + 1:3 * uav + 3, :] = 0.0
            hessian[..., :, 3 * uav + 1:3 * uav + 3] = 0.0
            extra[..., uav, [1, 2], [1, 2]] = 1.0
        pattern, inside = self._pattern
        whole = hessian.copy()
        diagonal = np.einsum('...ujuk->...ujk', whole.reshape(starts, count, uavs, 3, uavs, 3))
        diagonal += extra
        band = whole.reshape(starts, count, -1)[..., pattern] * inside
        for a in (1, 2):
            for b in (1, 2):
                band[:, :-1, b::3, size + a - b] -= tension[:, 1:-1, :, a - 1, b - 1]

        right = np.zeros((count * size, 1 + uavs))
        for uav in range(uavs):
            right[3 * uav::size, 1 + uav] = 1.0
        steps = np.empty_like(gradient)
        softness = count**2 * constraints[3] / mean
        for start in range(starts):
            right[:, 0] = -gradient[start].ravel()
            factor = self._factorised(band[start], hessian[start])
            solved = dpbtrs(factor, right, lower=1)[0]
            # The rows of average power, by Woodbury's formula.
            sums = np.stack([solved[3 * uav::size].sum(axis=0) for uav in range(uavs)])
            step = solved[:, 0] - solved[:, 1:] @ np.linalg.solve(
                np.diag(softness[start]) + sums[:, 1:], sums[:, 0])
            steps[start] = step.reshape(gradient.shape[1:])
        return steps

    def _factorised(self, band, hessian):
        """Return the Cholesky factor of a band (N, 3 U, 3 U + 2) with its slots' Hessians."""
        pattern, inside = self._pattern
        count, size, height = band.shape
        projected = np.zeros(count, bool)
        width, shift = 1, 1e-12
        for attempt in range(40):
            band[..., 0] += shift
            factor, info = dpbtrf(band.reshape(-1, height).T, lower=1)
            if info == 0:
                return factor
            if projected.all():
                shift = 1e-8 * 10**(attempt % 20)
                continue
            slot = (info - 1) // size
            chosen = np.zeros(count, bool)
            chosen[max(0, slot - width):slot + width + 1] = True
            if attempt >= 12:
                chosen[:] = True
            chosen &= ~projected
            if not chosen.any():
                chosen = ~projected
            width = 2 * width if attempt >= 3 else width
            projected |= chosen
            change = _negative_part(hessian[chosen])
            band[chosen] += change.reshape(len(change), -1)[:, pattern] * inside
        return factor

    def _reach(self, turns, constraints, changes):
        """Return how far the whole (S,), and the places of each UAV (S, U), may be moved."""
        starts = len(turns)
        bend = (turns**2).sum(axis=-1) / self.mission.steps**2
        half = -0.5 * changes[0]
        room = _BOUNDARY * constraints[0]
        root = np.sqrt(half**2 + bend * room)
        # The positive root of bend s^2 + 2 half s = room, without cancellation.
        speed = np.where(half > 0, room / np.maximum(root + half, 1e-300),
                         (root - half) / np.maximum(bend, 1e-300))
        speed[..., self.mission.fixed] = 1.0
        places = np.minimum(1.0, speed.min(axis=1))
        whole = places.min(axis=1)
        for c, change in zip(constraints[1:], changes[1:]):
            whole = np.minimum(whole, _steps_to_zero(c, change).reshape(starts, -1).min(axis=1))
        return whole, places

    def _line_search(self, step, gradient, slope, value, whole, places):
        """
        Move x, and return how far of the step each start went, 0 where no trial was better.

        First every power is stopped at its own limit and every flight at its own, which goes
        much farther than stopping all at the first limit; then plainly along the step.
        """
        x = self.x
        power = x[..., 0]
        low = power * max(1 - _BOUNDARY, 1 / _FACTOR)
        high = np.minimum(power * _FACTOR, power + _BOUNDARY * (self.mission.peaks - power))
        length = np.zeros(len(x))
        todo = np.arange(len(x))
        self.x = x.copy()
        self._known = None
        for attempt in range(_CLIPPED + _UNIFORM):
            if attempt < _CLIPPED:
                by = np.full(len(todo), 0.5**attempt)
                move = by[:, None, None, None] * step[todo]
                move[..., 1:] *= places[todo][:, None, :, None]
                trial = x[todo] + move
                trial[..., 0] = np.clip(trial[..., 0], low[todo], high[todo])
                expected = (gradient[todo] * (trial - x[todo])).sum(axis=(1, 2, 3))
            else:
                by = whole[todo] * 0.5**(attempt - _CLIPPED)
                trial = x[todo] + by[:, None, None, None] * step[todo]
                expected = by * slope[todo]
            known = self._evaluate(trial, self.level[todo])
            good = (known[0] <= value[todo] + _ARMIJO * expected + 1e-12 * np.abs(value[todo])) & (
                expected < 0)
            self.x[todo[good]] = trial[good]
            length[todo[good]] = by[good]
            if len(todo) == len(x) and good.all():
                self._known = known
            todo = todo[~good]
            if not len(todo):
                break
        return length

    def _follow(self, changes, push, constraints, leaks, step):
        """Move the multipliers along with the step, as far as they stay positive."""
        starts = len(step)
        dual = [p - y - y / c * change for y, p, c, change in zip(
            self._multipliers, push, constraints, changes)]
        by = np.ones(starts)
        for y, dy in zip(self._multipliers, dual):
            by = np.minimum(by, _steps_to_zero(y, dy).reshape(starts, -1).min(axis=1))
        if leaks is not None:
            flat, central, share, ratio = leaks
            rise = (flat @ step.reshape(*step.shape[:2], -1, 1))[..., 0]
            top = (central.sum(axis=-1) - 1 + (ratio * rise).sum(axis=-1)) / ratio.sum(axis=-1)
            change = central - share - ratio * (top[..., None] - rise)
            by = np.minimum(by, _steps_to_zero(share, change).reshape(starts, -1).min(axis=1))
            share = share + _spread(by, share) * change
            self._share = share / share.sum(axis=-1, keepdims=True)
        constraints = self._constraints(self.x)[1] if self._known is None else self._known[4]
        for index, (weight, c) in enumerate(zip(self._weights, constraints)):
            central = weight * _spread(self.level, c) / c
            y = self._multipliers[index]
            self._multipliers[index] = np.clip(
                y + _spread(by, y) * dual[index], central / _DUAL_RANGE, central * _DUAL_RANGE)


def _spread(per_start, like):
    """Return a number for each start in a shape that broadcasts with another array."""
    return per_start.reshape(-1, *[1] * (like.ndim - 1))


def _steps_to_zero(amount, change):
    """Return after how many steps a positive amount has all but vanished, at most 1."""
    most = _BOUNDARY * amount
    return most / np.maximum(-change, most)


def _negative_part(blocks):
    """Return what symmetric matrices lack to be positive semidefinite."""
    values, vectors = np.linalg.eigh(blocks)
    return (vectors * np.maximum(-values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _epigraph(leaks, level):
    """Return the t that minimises t - mu sum_e log(t - leak_e), for all slots, (S, N)."""
    largest = leaks.max(axis=-1)
    level = _spread(level, largest)
    if leaks.shape[-1] == 1:
        return largest + level
    below = (largest[..., None] - leaks) / level[..., None]
    t = np.ones_like(largest)
    for _ in range(8):
        inverse = 1.0 / (t[..., None] + below)
        # Newton on sum 1 / (t + below) = 1 from the left of its root, so without overshooting.
        t = t + (inverse.sum(axis=-1) - 1.0) / (inverse**2).sum(axis=-1)
    return largest + level * t


def _pattern(uavs):
    """Return where in a slot's Hessian each entry of the lower band is, and which are inside."""
    size = 3 * uavs
    column, offset = np.meshgrid(np.arange(size), np.arange(size + 2), indexing='ij')
    row = column + offset
    return np.where(row < size, row, 0) * size + column, row < size
