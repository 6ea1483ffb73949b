"""The page of a plan on a narrow screen, such as a phone's: everything in one column."""

import html
import math
from textwrap import wrap

from plotly.utils import PlotlyJSONEncoder

WIDTH = 1000  # Of a window in pixels, below which it is narrow.
HEIGHT = 560  # That the page has at least, in pixels.
_LINE = 46  # Characters that fit into a line of a phone.
_MAP, _PLOT, _TITLE, _GAP, _ENTRY = 350, 170, 55, 25, 29  # Heights in pixels.
STYLE = (
    '<meta name="viewport" content="width=device-width, initial-scale=1"><style>'
    f'#plan {{ min-height: {HEIGHT}px; }} '
    # The tools beside the title are for a mouse.
    f'@media (max-width: {WIDTH - 1}px) {{ body {{ margin: 0; }} '
    '.modebar-container { display: none; } }</style>')
"""What the head of the page needs."""

_SCRIPT = """
<script>
(() => {
  const plan = document.getElementById('plan'), layouts = %s;
  let narrow = false;
  const fit = () => {
    const now = window.innerWidth < %d;
    if (now === narrow) return;
    narrow = now;
    plan.style.height = now ? '%dpx' : '96vh';
    Plotly.relayout(plan, layouts[now ? 'narrow' : 'wide'])
      .then(() => Plotly.Plots.resize(plan))
      .then(() => { plan.dataset.screen = now ? 'narrow' : 'wide'; });
  };
  window.addEventListener('resize', fit);
  fit();
})();
</script>"""


def script(figure, claim):
    """Return a script that arranges the page's figure anew for a narrow or a wide window."""
    narrow, height = _narrow(figure, claim)
    wide = {name: figure.layout[name] for name in narrow}
    layouts = PlotlyJSONEncoder().encode({'narrow': narrow, 'wide': wide})
    # A name of a UAV must not end the script.
    return _SCRIPT % (layouts.replace('</', '<\\/'), WIDTH, height)


def _narrow(figure, claim):
    """Return what changes of the layout on a narrow screen, and the height of the figure."""
    title = figure.layout.title.text.partition('<br>')[0]
    lines = [*wrap(title, _LINE), *(f'<sup>{html.escape(line)}</sup>'
                                    for line in wrap(claim, _LINE + 8))]
    steps = [{**step.to_plotly_json(), 'label': '<br>'.join(wrap(step.label, _LINE + 4))}
             for step in figure.layout.sliders[0].steps]
    readout = 16 * max(step['label'].count('<br>') + 1 for step in steps)
    entries = sum(trace.showlegend is not False for trace in figure.data)
    # From above: the title, the buttons, the readout with its slider, map, plots and legend.
    top, bottom = 18 * len(lines) + 112 + readout, 70 + _ENTRY * math.ceil(entries / 2)
    plots = _MAP + _TITLE + 3 * _PLOT + 2 * _GAP
    domains, end = {}, float(plots)
    for number, height in zip(('', 2, 3, 4), (_MAP, *[_PLOT] * 3)):
        domains[f'xaxis{number}.domain'] = [0.0, 1.0]
        domains[f'yaxis{number}.domain'] = [(end - height) / plots, end / plots]
        end -= height + (_GAP if number else _TITLE)
    height = plots + top + bottom
    return {
        **domains, 'title.text': '<br>'.join(lines), 'title.font.size': 14, 'title.yanchor': 'top',
        'title.y': 1 - 22 / height,
        'margin': {'l': 58, 'r': 12, 't': top, 'b': bottom},
        'dragmode': False,  # So that a finger scrolls the page.
        'legend': {'orientation': 'h', 'font': {'size': 11}, 'xref': 'container', 'x': 0,
                   'yref': 'container', 'y': 0, 'yanchor': 'bottom'},
        'sliders[0].steps': steps, 'sliders[0].x': 0, 'sliders[0].len': 1, 'sliders[0].y': 1,
        'sliders[0].yanchor': 'bottom', 'sliders[0].pad': {'t': 0, 'b': 10},
        'sliders[0].currentvalue.font.size': 12,
        'updatemenus[0].y': 1, 'updatemenus[0].yanchor': 'bottom',
        'updatemenus[0].pad': {'b': 60 + readout},
    }, height
