"""A primal-dual interior-point method for (P1) and (P2), for several starts side by side."""

from collections.abc import Callable
import time

import numpy as np
from numpy.typing import NDArray

from .line_search import line_search
from .newton import BandMatrix
from .schedule import Schedule
from .worst_places import WorstPlaces
from ...channel.derivatives import Receivers, SlotRates
from ...errors import NumericalError
from ...grid import Grid
from ...limits import limits_of
from ...limits.base import ALL_SLOTS, Iterate, Limit, Step, step_to_zero
from ...scenario import Array


class Evaluation:
    """
    The barrier function at one x of several starts, and what it was computed from.

    :ivar value: of the barrier function, (S,), infinite outside the limits.
    :ivar largest: t, the largest leak as the barrier function has it, (S, N).
    :ivar margins: c of every limit.
    :param same: what was evaluated at the same x and mu with other lines.
    """

    def __init__(self, barrier: 'Barrier', iterate: Iterate, mu: Array,
                 same: 'Evaluation | None' = None) -> None:
        self.iterate, x = iterate, iterate.x
        if same is None:
            softening = barrier.schedule.softening * np.sqrt(mu)[:, None]
            self.rates = SlotRates(barrier.receivers, x, softening)
            self.largest = _epigraph(self.rates.leaks, mu)
        else:
            self.rates, self.largest = same.rates, same.largest
        self.margins = [limit.margin(self.iterate) for limit in barrier.limits]
        value = (self.largest - self.rates.ground).sum(axis=1)
        if self.rates.leaks.shape[-1] > 1:
            gap = self.largest[..., None] - self.rates.leaks
            value -= mu * np.log(gap / _spread(mu, gap)).sum(axis=(1, 2))
        with np.errstate(invalid='ignore', divide='ignore'):
            for limit, margin in zip(barrier.limits, self.margins, strict=True):
                value -= limit.weight * mu * np.log(margin).reshape(len(x), -1).sum(axis=1)
        value[~np.isfinite(value)] = np.inf
        self.value: Array = value


class Barrier:
    """
    Newton's method on the barrier function of (P2) in positions and powers together.

    The objective is the sum over slots of the largest leak less r_0, in nats. Every inequality
    c >= 0 of a limit has the term -mu log c, times the limit's weight. The largest leak t has
    -mu log(t - leak) for every eavesdropper; t is eliminated slot by slot. Limits couple few
    neighbouring slots, or all slots by one row, so the Hessian is a band and a few rows, and a
    step costs time linear in the number of slots.

    Iterates are strictly feasible. S starts are advanced at once, which costs little more than
    one as long as slots are few.

    :param grid: of the variables.
    :param x: strictly feasible starts, (S, N, U, 3).
    :param mu: the barrier parameter to begin with, for all starts or for each, (S,).
    :param schedule: the tuned numbers.
    :param check: called between parts of a step that may take long; what it raises ends the
        step and leaves x as it was.
    :param places: of the eavesdroppers in every slot; by default the guarantee counts.
    """

    def __init__(self, grid: Grid, x: Array, mu: float | Array, schedule: Schedule,
                 check: Callable[[], None] = lambda: None,
                 places: WorstPlaces | None = None) -> None:
        self.grid = grid
        self.schedule = schedule
        self.check = check
        self._places = places
        self.receivers = Receivers.of(grid) if places is None else places.receivers
        self._limits = limits_of(grid.scenario, grid)
        self.solver_time = 0.0
        self.x = x
        self.mu: Array = np.full(len(x), 1.0) * mu
        self.finished: NDArray[np.bool_] = np.zeros(len(x), bool)
        self._age = np.zeros(len(x), int)
        self._base = Iterate(grid, x)
        self._duals = [limit.weight * _quotient(self.mu, limit.margin(self._base))
                       for limit in self.limits]
        self._has_lines = bool(self._base.lines)
        self._leak_shares: Array | None = None
        self._known: Evaluation | None = None
        size = 3 * x.shape[2]
        self._height = max(limit.height(size) for limit in self.limits)
        rows = [limit.dense_rows() for limit in self.limits if limit.reach == ALL_SLOTS]
        self._rows = np.concatenate([row for row in rows if row is not None])

    @property
    def limits(self) -> tuple[Limit, ...]:
        """Limits of the grid's scenario, whose terms the function has."""
        return self._limits

    def keep(self, chosen: NDArray[np.intp]) -> None:
        """Go on with some of the starts only, given as an index array."""
        for name in ('x', 'mu', 'finished', '_age'):
            setattr(self, name, getattr(self, name)[chosen])
        self._duals = [dual[chosen] for dual in self._duals]
        if self._leak_shares is not None:
            self._leak_shares = self._leak_shares[chosen]
        self._known = None

    def exchange(self, places: WorstPlaces, worse: bool) -> None:
        """Go on with places that have been exchanged; `worse` ones need further steps."""
        self._places, self.receivers = places, places.receivers
        self._known = None
        if worse:
            self.finished = np.zeros_like(self.finished)

    def rates(self) -> Array:
        """Return the mean rates against the receivers, losing slots silenced, in nats, (S,)."""
        rates = SlotRates(self.receivers, self.x)
        found: Array = np.maximum(rates.ground - rates.leaks.max(axis=-1), 0.0).mean(axis=1)
        return found

    def iterate(self, final: float) -> None:
        """
        Take one step from every start, then lower its mu towards `final` where it may be.

        A start is `finished` when it has converged for that mu, or makes no more progress.

        :raises NumericalError: when no step can be computed from any start.
        """
        x, mu = self.x, self.mu
        here = self._known
        if here is None or self._has_lines:  # which are chosen anew for every step
            here = Evaluation(self, Iterate(self.grid, x), mu, here)
            if self._has_lines:
                self._clip_duals(here.margins)
        self._base = here.iterate
        self.check()
        gradient, hessian, leaks = self._model_of_slots(here)
        self.check()
        central = [limit.weight * _quotient(mu, margin)
                   for limit, margin in zip(self.limits, here.margins, strict=True)]
        for limit, force in zip(self.limits, central, strict=True):
            limit.add_gradient(here.iterate, force, gradient)
        gradient[..., 1:] *= ~self.grid.fixed[:, None]
        started = time.perf_counter()
        step = Step(self._newton_step(here, gradient, hessian))
        self.solver_time += time.perf_counter() - started

        changes = [limit.change(here.iterate, step) for limit in self.limits]
        reaches = [
            limit.longest_step(here.iterate, step, margin, change, self.schedule.boundary)
            for limit, margin, change in zip(self.limits, here.margins, changes, strict=True)]
        length = line_search(self, here, step, gradient, reaches)
        self._move_duals(here, changes, central, leaks, step)
        decrement = -(step.x * gradient).sum(axis=(1, 2, 3)) / (x.shape[1] * mu)
        self._update_mu(length, decrement, final)

    def advance(self, steps: int, final: float) -> int:
        """
        Take up to `steps` steps, as many as are short together, and return how many.

        Between them nobody looks at the starts, and `finished` ones go on as well. See iterate.
        """
        self.iterate(final)
        return 1

    def try_from(self, x: Array, starts: NDArray[np.intp]) -> Evaluation:
        """Return the barrier function of some of the starts at another x."""
        self.check()
        return Evaluation(self, self._base.moved(x, starts), self.mu[starts])

    def move(self, x: Array, known: Evaluation | None) -> None:
        """Go to another x, with its Evaluation if that is known for all starts."""
        self.x, self._known = x, known

    def _model_of_slots(self, here: Evaluation) -> tuple[Array, Array, '_Leaks | None']:
        """Return gradient and Hessian of the objective, and what the leaks' duals need."""
        derivatives = here.rates.derivatives()
        ground = derivatives.gradients[..., 0, :, :]
        leaks = derivatives.gradients[..., 1:, :, :]
        if leaks.shape[-3] == 1:
            weights = np.broadcast_to([-1.0, 1.0], (*here.largest.shape, 2))
            return leaks[..., 0, :, :] - ground, derivatives.hessian(weights), None
        gap = here.largest[..., None] - here.rates.leaks
        central = _quotient(self.mu, gap)
        gradient = (central[..., None, None] * leaks).sum(axis=-3) - ground
        shares = central if self._leak_shares is None else self._leak_shares
        hessian = derivatives.hessian(
            np.concatenate([np.full_like(shares[..., :1], -1.0), shares], axis=-1))
        if self._places is not None:
            hessian += self._places.curvature(derivatives, shares)
        ratio = shares / gap
        flat = leaks.reshape(*gap.shape, -1)
        mean = (ratio[..., None] * flat).sum(axis=-2) / ratio.sum(axis=-1)[..., None]
        rows = np.sqrt(ratio)[..., None] * (flat - mean[..., None, :])
        hessian += np.swapaxes(rows, -1, -2) @ rows
        return gradient, hessian, _Leaks(flat, central, shares, ratio)

    def _newton_step(self, here: Evaluation, gradient: Array, hessian: Array) -> Array:
        """
        Return minus the inverse of the Hessian, made positive, times the gradient.

        A start for which that fails stays where it is.

        :raises NumericalError: when it fails for all.
        """
        matrix = BandMatrix(hessian, self._height, self.grid.fixed)
        softness = []
        for limit, dual, margin in zip(self.limits, self._duals, here.margins, strict=True):
            if limit.reach == ALL_SLOTS:
                softness.append(margin / dual)
            else:
                limit.add_curvature(here.iterate, dual, margin, matrix)
        step = matrix.solve(-gradient.reshape(len(gradient), -1), self._rows,
                            np.concatenate(softness, axis=1), self.check)
        failed = ~np.isfinite(step).all(axis=1)
        if failed.all():
            raise NumericalError('no Newton step could be computed')
        step[failed] = 0.0
        return step.reshape(gradient.shape)

    def _move_duals(self, here: Evaluation, changes: list[Array], central: list[Array],
                    leaks: '_Leaks | None', step: Step) -> None:
        """Move the duals along with the step, as far as they stay positive."""
        starts, boundary = len(step.x), self.schedule.boundary
        moves = [target - dual - dual / margin * change for target, dual, margin, change in zip(
            central, self._duals, here.margins, changes, strict=True)]
        by = np.ones(starts)
        for dual, move in zip(self._duals, moves, strict=True):
            by = np.minimum(by, step_to_zero(dual, move, boundary).reshape(starts, -1).min(axis=1))
        if leaks is not None:
            move = leaks.change_of_shares(step)
            by = np.minimum(
                by, step_to_zero(leaks.shares, move, boundary).reshape(starts, -1).min(axis=1))
            shares = leaks.shares + _spread(by, move) * move
            self._leak_shares = shares / shares.sum(axis=-1, keepdims=True)
        for index, dual in enumerate(self._duals):
            self._duals[index] = dual + _spread(by, dual) * moves[index]
        if self._known is None:
            iterate = self._base.moved(self.x)
            self._clip_duals([limit.margin(iterate) for limit in self.limits])
        else:
            self._clip_duals(self._known.margins)

    def _clip_duals(self, margins: list[Array]) -> None:
        """Keep the duals near their central values for some margins."""
        most = self.schedule.dual_range
        for index, (limit, margin) in enumerate(zip(self.limits, margins, strict=True)):
            target = limit.weight * _quotient(self.mu, margin)
            self._duals[index] = np.clip(self._duals[index], target / most, target * most)

    def _update_mu(self, length: Array, decrement: Array, final: float) -> None:
        """Decide which starts have finished, and lower the barrier parameter of others."""
        schedule, mu = self.schedule, self.mu
        self._age += 1
        stalled = (self._age >= schedule.patience) | (length == 0.0)
        centred = (decrement <= schedule.centred * self.x.shape[2]) & (length > 0.5)
        # What another step gains is a small share of what mu costs, or nothing that matters.
        still = decrement <= np.maximum(schedule.still, schedule.negligible / mu)
        self.finished = (mu <= final) & (still | stalled)
        lower = (centred | stalled) & (mu > final)
        self._age[lower] = 0
        if lower.any():
            self.mu = np.where(lower, np.maximum(final, np.minimum(
                schedule.mu_factor * mu, mu**schedule.mu_power)), mu)
            self._known = None


class _Leaks:
    """
    The leaks to several eavesdroppers in a Newton step.

    :param gradients: (S, N, E, 3 U).
    :param central: mu / (t - leak), (S, N, E).
    :param shares: the duals of t >= leak, which sum to 1 in every slot, (S, N, E).
    :param ratio: shares / (t - leak), (S, N, E).
    """

    def __init__(self, gradients: Array, central: Array, shares: Array, ratio: Array) -> None:
        self._gradients, self._central = gradients, central
        self.shares, self._ratio = shares, ratio

    def change_of_shares(self, step: Step) -> Array:
        """Return the Newton step of the shares, (S, N, E)."""
        rise = (self._gradients @ step.x.reshape(*step.x.shape[:2], -1, 1))[..., 0]
        largest = (self._central.sum(axis=-1) - 1 + (self._ratio * rise).sum(axis=-1)
                   ) / self._ratio.sum(axis=-1)
        change: Array = self._central - self.shares - self._ratio * (largest[..., None] - rise)
        return change


def _spread(per_start: Array, like: Array) -> Array:
    """Return a number for each start in a shape that broadcasts with another array."""
    return per_start.reshape(-1, *[1] * (like.ndim - 1))


def _quotient(per_start: Array, divisor: Array) -> Array:
    """Return a number for each start divided by another array."""
    return _spread(per_start, divisor) / divisor


def _epigraph(leaks: Array, mu: Array) -> Array:
    """Return the t that minimises t - mu sum_e log(t - leak_e), for all slots, (S, N)."""
    largest: Array = leaks.max(axis=-1)
    mu = _spread(mu, largest)
    if leaks.shape[-1] == 1:
        return largest + mu
    below = (largest[..., None] - leaks) / mu[..., None]
    t = np.ones_like(largest)
    for _ in range(8):
        inverse = 1.0 / (t[..., None] + below)
        # Newton on sum 1 / (t + below) = 1 from the left of its root, so without overshooting.
        t = t + (inverse.sum(axis=-1) - 1.0) / (inverse**2).sum(axis=-1)
    return largest + mu * t
