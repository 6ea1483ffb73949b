"""The figure of environments: what plans for free space and for the model are worth in each."""

from dataclasses import dataclass

from matplotlib.figure import Figure
import numpy as np

from ...assessment import assess
from ...plan.plan import Plan

_SIZE = (9.0, 4.6)
_DRAWS = 2000
_SCHEMES = {'planned for free space': ('#E69F00', -0.14),
            'planned for the model': ('#0072B2', 0.14)}
HEADER = ('environment', 'scheme', 'planned_rate', 'guaranteed_rate', 'found_mean', 'found_5',
          'found_50', 'found_95', 'outage', 'delivered', 'promised_delivery')


@dataclass(frozen=True)
class Found:
    """
    A plan in an environment; rates in bit/s/Hz, deliveries in bit/Hz.

    :param environment: its name.
    :param scheme: one of 'planned for free space' and 'planned for the model'.
    :param planned: the guaranteed rate that the plan was made with.
    :param guaranteed: its guaranteed rate by the model of the environment, which counts with mean
        gains; [x]^+ of each slot.
    :param mean: of the mission's secrecy rate, by assess, with lines of sight drawn.
    :param quantiles: 5%, 50% and 95% of it.
    :param outage: mean over the slots.
    :param delivered: in secret, at the rate of the model, in the mean.
    """

    environment: str
    scheme: str
    planned: float
    guaranteed: float
    mean: float
    quantiles: tuple[float, float, float]
    outage: float
    delivered: float
    promised_delivery: float

    @property
    def row(self):
        """Return the values by HEADER."""
        return (self.environment, self.scheme, self.planned, self.guaranteed, self.mean,
                *self.quantiles, self.outage, self.delivered, self.promised_delivery)


def found_in_environments(plans):
    """
    Return a Found for each environment and scheme.

    Both plans see the same places and lines of sight.

    :param plans: the result of study.plans_of.
    """
    chosen = [plan for point, plan in sorted(plans.items(), key=lambda entry: entry[0].x)
              if point.experiment == 'environment']
    free, found = chosen[0], []
    for plan in chosen:
        name = (plan.scenario.channel.los or 'free space').replace('_', ' ')
        there = Plan(plan.scenario, free.positions, free.powers)
        for scheme, made, flown in zip(_SCHEMES, (free, plan), (there, plan)):
            answer = assess(flown, _DRAWS)
            found.append(Found(
                name, scheme, made.guaranteed_rate, answer.promised_rate, answer.mean,
                tuple(answer.quantile(share) for share in (0.05, 0.5, 0.95)),
                float(answer.outages.mean()), float(answer.delivered.mean()),
                answer.promised_delivery))
    return found


def draw_environments(found):
    """Return a matplotlib Figure of the Founds: the rates planned, guaranteed and found."""
    figure = Figure(figsize=_SIZE, layout='constrained')
    axes = figure.subplots()
    names = list(dict.fromkeys(one.environment for one in found))
    for scheme, (color, aside) in _SCHEMES.items():
        mine = [one for one in found if one.scheme == scheme]
        x = np.arange(len(names)) + aside
        low, _, high = np.array([one.quantiles for one in mine]).T
        mean = np.array([one.mean for one in mine])
        axes.bar(x, mean, width=0.26, color=color, alpha=0.35, label=f'{scheme}: found, mean')
        axes.errorbar(x, mean, yerr=(mean - low, high - mean), color=color, linestyle='none',
                      capsize=4, label=f'{scheme}: found, 5% to 95%')
        for field, marker, text in (('guaranteed', 's', 'by the model there'),
                                    ('planned', 'x', 'planned')):
            axes.plot(x, [getattr(one, field) for one in mine], marker, color=color, markersize=7,
                      markerfacecolor='white', label=f'{scheme}: {text}')
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel('mean secrecy rate (bit/s/Hz)')
    axes.grid(axis='y', color='0.9', linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)
    # Above the axes, where no bar can be.
    axes.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8, frameon=False)
    return figure
