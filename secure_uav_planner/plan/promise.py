"""The slots of a plan whose rates are promised, and the mean rates of these slots."""

from dataclasses import dataclass
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .results import RatedFlight
from ..mission.validation import Array, find_runs
from ..model.channel.rates import find_least_rate

_ROUNDING = 1e-9  # Tolerance of a time, in slots.

Mask: TypeAlias = NDArray[np.bool_]
"""Whether each slot has a property, (N,)."""


def find_promised_slots(plan: RatedFlight) -> Mask:
    """
    Return whether each slot of a plan is promised, (N,).

    Slot n is promised if point n lies no later than promised_until and not inside a gap.
    """
    step, points = plan.scenario.slot_duration, np.arange(1, plan.scenario.slots + 1)
    until = math.inf if plan.promised_until is None else plan.promised_until
    promised = points <= until / step + _ROUNDING
    for begin, end in plan.gaps:
        promised &= (points <= begin / step + _ROUNDING) | (points >= end / step - _ROUNDING)
    promised.setflags(write=False)
    return promised


def _select_slots(rates: Array, mask: Mask) -> Array:
    """
    Return the columns of rates (G, N) that a mask (N,) selects; `rates` itself if it has all True.

    rates[:, mask] would have another memory order than rates, in which NumPy's means of rows
    differ in their last digits from the means of the plan.
    """
    return rates if mask.all() else np.compress(mask, rates, axis=1)


class _PromisedRate:
    """The property of a Promise that is the least mean over weight of rates of its slots."""

    def __init__(self, name: str) -> None:
        self._name = name  # Attribute of a plan with rates of nodes times their shares, (G, N).

    def __get__(self, promise: 'Promise', _: object = None) -> float:
        """Return the least (mean of promised slots + node_offset) / node_weight; NaN if none."""
        if not promise.slots:
            return math.nan
        rates: Array = getattr(promise.plan, self._name)
        return find_least_rate(
            promise.plan.scenario, _select_slots(rates, promise.mask).mean(axis=1))


@dataclass(frozen=True, eq=False)
class Promise:
    """
    The slots of a plan whose rates are promised.

    :ivar mask: whether each slot is promised, (N,).
    """

    plan: RatedFlight
    mask: Mask

    @property
    def slots(self) -> int:
        """Return the number of promised slots."""
        return int(self.mask.sum())

    @property
    def is_partial(self) -> bool:
        """Whether a slot is not promised."""
        return not self.mask.all()

    guaranteed_rate = _PromisedRate('guaranteed_shares')
    """Mean guaranteed rate of the promised slots in bit/s/Hz; NaN without any."""

    worst_case_rate = _PromisedRate('worst_case_shares')
    """Mean worst-case rate of the promised slots in bit/s/Hz; NaN without any."""

    rate = _PromisedRate('node_shares')
    """Mean rate of the objective in the promised slots in bit/s/Hz; NaN without any."""

    curve_rate = _PromisedRate('curve_shares')
    """Mean guaranteed rate along the curve in the promised slots; NaN without any."""

    @property
    def node_rates(self) -> Array:
        """Mean rate of each ground node in the promised slots, (G,); NaN without any."""
        rates = _select_slots(self.plan.node_shares, self.mask)
        return rates.mean(axis=1) if self.slots else np.full(len(rates), math.nan)

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Return the times (begin, end) [s] of each run of slots that are not promised."""
        points = find_runs(~self.mask) + 1  # The slot with index n begins at point n + 1.
        return [(begin, end)
                for begin, end in (points * self.plan.scenario.slot_duration).tolist()]

    @property
    def text(self) -> str:
        """Text that says which slots are promised; empty if all are."""
        plan = self.plan
        if not self.is_partial:
            return ''
        until, step = plan.promised_until, plan.scenario.slot_duration
        if not self.slots and until and until < step:  # Below 0 in a tail, or by a short horizon.
            return (f'no slot is promised: receivers are predicted until {until:.1f} s and '
                    f'slot 1 begins at {step:.1f} s; plan again or raise prediction_horizon')
        if not self.slots:
            return 'no slot is promised: the promise ended before slot 1; plan again'
        return f'{self.slots} of {plan.scenario.slots} slots promised' + (
            '' if self.mask[-1] or until is None else
            f', until {until:.1f} s')
