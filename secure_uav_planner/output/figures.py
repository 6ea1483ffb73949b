"""Figures with the settings of this package, and the picture of an assessment."""

from contextlib import contextmanager
from io import BytesIO
import math
from textwrap import wrap
import warnings

from matplotlib import rcParams, style
from matplotlib.figure import Figure
import numpy as np

from .drawing import add_legend, EAVESDROPPER, RATE, style_axes
from ..mission.validation import rate_text

_SIZE = (9.0, 7.6)
_DOTS_PER_INCH = 200
_BANDS = ((0, 4, 0.18, '5% to 95%'), (1, 3, 0.3, '25% to 75%'))  # Low, high in FAN; opacity.
_PROMISED = {'color': 'black', 'linewidth': 1.3, 'linestyle': '--'}
_TITLE_WIDTH = 90  # Letters in a line of the title.
_LEGEND_WIDTH = 14  # Letters in a line of a legend.
_LEAST_RANGE = 1e-9  # Range of rates [bit/s/Hz] below which the histogram is 1 bit/s/Hz wide.


@contextmanager
def own_settings():
    """Use Matplotlib's default settings with the user's fonts, for names in other alphabets."""
    fonts = {name: rcParams[name] for name in ('font.family', 'font.sans-serif', 'font.serif')}
    with style.context(['default', fonts]), warnings.catch_warnings():
        # If a font lacks the letters of a name, Matplotlib draws boxes and warns.
        warnings.filterwarnings('ignore', message='Glyph .* missing')
        yield


class Picture(Figure):
    """A Figure that notebooks show without pyplot."""

    @own_settings()
    def savefig(self, *arguments, **options):
        super().savefig(*arguments, **options)

    def _repr_png_(self):
        with BytesIO() as file:
            self.savefig(file, format='png')
            return file.getvalue()


def save_assessment(assessment, path):
    """Draw an Assessment into a file; the suffix, such as .png, gives the format."""
    draw_assessment(assessment).savefig(path, dpi=_DOTS_PER_INCH)


@own_settings()
def draw_assessment(assessment) -> Picture:
    """Return a Figure: rate and outage of each slot over the draws, and rates of the mission."""
    figure = Picture(figsize=_SIZE, layout='constrained')
    slots, outages, missions = figure.subplots(3, 1, height_ratios=(2.2, 1.0, 1.6))
    title = (f'{assessment.draws} draws: {assessment.mean:.3f} bit/s/Hz in the mean, '
             f'{assessment.quantile(0.05):.3f} at 5%; '
             f'{rate_text(assessment.promised_rate, 3)} {assessment.claim}')
    slots.set_title('\n'.join(wrap(title, _TITLE_WIDTH)), fontsize=11, loc='left')
    promise_style = {**_PROMISED, 'label': '\n'.join(wrap(assessment.claim, _LEGEND_WIDTH))}
    _draw_slots(slots, assessment, promise_style)
    _draw_outages(outages, assessment)
    _draw_missions(missions, assessment, promise_style)
    for axes in (slots, outages, missions):
        style_axes(axes)
        add_legend(axes)
    return figure


def _draw_slots(axes, assessment, promise_style):
    """Draw the median and quantiles of each slot's rate over the draws, and its promised rate."""
    edges = assessment.plan.times[1:]
    for low, high, alpha, label in _BANDS:
        axes.stairs(assessment.fan[high], edges, baseline=assessment.fan[low], fill=True,
                    color=RATE, alpha=alpha, linewidth=0, label=label)
    axes.stairs(assessment.fan[2], edges, baseline=None, color=RATE, linewidth=1.8,
                label='50%')
    axes.stairs(assessment.promised_rates, edges, baseline=None, **promise_style)
    axes.set_xlim(0, edges[-1])
    axes.set_ylim(bottom=0)
    axes.set_ylabel('secrecy rate of a slot\n(bit/s/Hz)')
    axes.tick_params(labelbottom=False)


def _draw_outages(axes, assessment):
    """Draw the outage (share of draws) of each slot; with a guarantee, also the promised one."""
    edges = assessment.plan.times[1:]
    axes.stairs(assessment.outages, edges, fill=True, color=EAVESDROPPER, alpha=0.6, label='found')
    if assessment.plan.scenario.channel.is_guarantee:
        axes.axhline(assessment.promised_outage, label='promised', **_PROMISED)
    axes.set_xlim(0, edges[-1])
    axes.set_ylim(0, max(0.01, 1.15 * max(assessment.outage, assessment.promised_outage)))
    axes.yaxis.set_major_formatter(lambda share, _: f'{share:.3g}')
    axes.set_ylabel('outage')
    axes.set_xlabel('time (s)')


def _draw_missions(axes, assessment, promise_style):
    """Draw a histogram of the mission's rates, their 5% and 50% quantiles, the promised rate."""
    rates = assessment.rates
    low, high = rates.min(), rates.max()
    if high - low < _LEAST_RANGE:  # All draws have one rate.
        low, high = low - 0.5, low + 0.5
    axes.hist(rates, bins=min(60, math.ceil(2 * len(rates)**(1 / 3))), range=(low, high),
              color=RATE, alpha=0.5, weights=np.full(len(rates), 1 / len(rates)), label='found')
    for share, dash in ((0.05, ':'), (0.5, '-')):
        axes.axvline(assessment.quantile(share), color=RATE, linewidth=1.6, linestyle=dash,
                     label=f'{share:.0%}')
    axes.axvline(assessment.promised_rate, **promise_style)
    axes.set_xlabel('secrecy rate of the mission (bit/s/Hz)')
    axes.set_ylabel('share of draws')
