"""The web page of a plan: one HTML file with a time slider, which needs no network."""

import html
from textwrap import wrap

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from .drawing import GEOFENCE, map_extent, rate_label, scheme_name
from .traces import label_charts, PlanTraces, power_range
from ..mission.files import atomic_file

_MOST_FRAMES = 400
_PLAYING_TIME = 20.0  # Duration of the whole animation [s].
_TITLE = 'Secure UAV plan'
_STYLE = ('<meta name="viewport" content="width=device-width, initial-scale=1"><style>'
          'body { margin: 0; font-family: sans-serif; color: #2a3f5f } '
          'h1 { margin: 10px 20px 0; font-size: 17px; font-weight: normal }</style>')
_ARRANGE = """
const plot = document.getElementById('{plot_id}');
plot.style.height = plot.parentElement.style.height = 'auto';
function arrange() {
  // Charts beside a map that is as wide as its shape asks for; where that is narrow, below it.
  const width = document.documentElement.clientWidth, inner = width - 80, isNarrow = width < 700;
  const top = isNarrow ? 170 : 120;
  const bottom = 60 + plot.querySelector('.legend').getBoundingClientRect().height;
  const room = Math.max(
    300, window.innerHeight - document.querySelector('h1').offsetHeight - 30 - top - bottom);
  let map = Math.min(ASPECT * room, 0.6 * inner), height = room, charts, share = 1;
  const layout = {};
  if (isNarrow || map / ASPECT < room / 2) {
    map = Math.min(inner / ASPECT, 0.9 * window.innerHeight);
    height = map + 550;
    share = 480 / height;
    charts = [0, 1];
    Object.assign(layout, {'xaxis.domain': charts, 'yaxis.domain': [1 - map / height, 1]});
  } else {
    charts = [(map + 90) / inner, 1];
    Object.assign(layout, {'xaxis.domain': [0, map / inner], 'yaxis.domain': [0, 1]});
  }
  for (const row of [0, 1, 2]) {
    layout[`xaxis${row + 2}.domain`] = charts;
    layout[`yaxis${row + 2}.domain`] = [share * (2 - row) / 2.9, share * (2.9 - row) / 2.9];
  }
  return Plotly.relayout(plot, Object.assign(layout, {
    width: width, height: top + height + bottom, 'margin.t': top, 'margin.b': bottom,
    'sliders[0].x': isNarrow ? 0 : 130 / inner, 'sliders[0].len': isNarrow ? 1 : 1 - 130 / inner,
    'sliders[0].pad.b': isNarrow ? 60 : 10}));
}
// The second time, the legend has its height.
const arrangeTwice = () => arrange().then(arrange);
window.addEventListener('resize', arrangeTwice);
arrangeTwice();
"""
_READOUT_WIDTH = 40  # Letters in a line of the slider's text.
_JUMP = {'mode': 'immediate', 'transition': {'duration': 0},
         'frame': {'duration': 0, 'redraw': False}}


def save_page(plan, path, baselines=(), comparison=None):
    """
    Write the web page of a Plan and its baselines to an HTML file that needs no other file.

    :param baselines: Plans of the same mission, which are drawn in grey.
    :param comparison: a Comparison of the plan with a flight, which is drawn as well.
    :raises OSError: as atomic_file does.
    """
    figure = draw_page(plan, baselines, comparison)
    title = figure.layout.title.text
    figure.layout.title = None  # The document wraps the title; Plotly would not.
    # Plotly draws the page first at this height [px], which leaves room beside any legend and
    # slider text; _ARRANGE sets the height of the screen.
    figure.update_layout(height=2000)
    (left, right), (low, high) = figure.layout.xaxis.range, figure.layout.yaxis.range
    content = figure.to_html(
        full_html=False, include_plotlyjs=True, auto_play=False, div_id='plan',
        post_script=_ARRANGE.replace('ASPECT', f'{(right - left) / (high - low):.4f}'),
        config={'displaylogo': False, 'displayModeBar': False})
    document = (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{_TITLE}'
                f'</title><link rel="icon" href="data:,">{_STYLE}</head>'
                f'<body><h1>{title}</h1>\n{content}\n</body></html>\n')
    with atomic_file(path) as file:
        file.write(document)


def draw_page(plan, baselines=(), comparison=None):
    """Return a plotly Figure: map left, charts right, animation of up to _MOST_FRAMES points."""
    content = PlanTraces(plan)
    figure = make_subplots(
        3, 2, specs=[[{'rowspan': 3}, {}], [None, {}], [None, {}]], shared_xaxes='columns')
    legend_entry = go.Scatter(
        x=[None], y=[None], mode='markers', name='UAV, larger with more power',
        marker={'size': 15, 'color': GEOFENCE, 'line': {'color': 'white', 'width': 1.5}})
    on_map = [*content.map_traces(), *content.path_traces()]
    static = [*content.baseline_traces(baselines), *((trace, None) for trace in on_map),
              *content.chart_traces(), (legend_entry, None)]
    if comparison is not None:
        static += content.flown_traces(comparison)
    for trace, row in (*static, *content.moving_traces(0)):
        figure.add_trace(trace, row or 1, 2 if row else 1)
    moving = list(range(len(static), len(figure.data)))  # Indices of the traces of a frame.
    last = plan.scenario.slots + 1
    points = sorted({*np.linspace(0, last, min(last + 1, _MOST_FRAMES)).round().astype(int)})
    figure.frames = [
        go.Frame(name=str(point), traces=moving,
                 data=[trace for trace, _ in content.moving_traces(point)]) for point in points]
    east, north = map_extent(plan.scenario, [plan, *baselines]).T.tolist()
    figure.update_xaxes(title_text='east (m)', range=east, constrain='domain', row=1, col=1)
    figure.update_yaxes(title_text='north (m)', range=north, constrain='domain',
                        constraintoward='top', scaleanchor='x', row=1, col=1)
    label_charts(figure, 2)
    figure.update_yaxes(range=power_range(plan), row=1, col=2)
    _add_controls(figure, content, points)
    return figure


def _add_controls(figure, content, points):
    """Add title, legend, unpromised intervals and the controls of the animation."""
    plan = content.plan
    for begin, end in plan.promise.gaps:
        for row in (1, 2, 3):
            figure.add_vrect(begin, end, row=row, col=2, fillcolor=GEOFENCE, opacity=0.15,
                             line_width=0, annotation_text='not promised' if row == 1 else '')
    title = f'{html.escape(scheme_name(plan.method))}: {rate_label(plan)}'
    if plan.bound is not None:
        title += f'<br><small>{html.escape(plan.claim)}</small>'
    play = {'mode': 'immediate', 'fromcurrent': True, 'transition': {'duration': 0},
            'frame': {'duration': 1000 * _PLAYING_TIME / len(points), 'redraw': False}}
    figure.update_layout(
        template='plotly_white', hovermode='closest', margin={'l': 60, 'r': 20},
        title={'text': title},
        dragmode=False,  # Without dragging, a finger scrolls the page.
        legend={'orientation': 'h', 'yref': 'container', 'y': 0, 'yanchor': 'bottom'},
        sliders=[{
            'active': 0, 'y': 1, 'yanchor': 'bottom', 'pad': {'b': 10},
            # The label of the present step is the readout. Labels below the slider have no room,
            # so they are transparent.
            'font': {'color': 'rgba(0,0,0,0)', 'size': 1},
            'ticklen': 0, 'tickcolor': 'rgba(0,0,0,0)',
            'currentvalue': {'font': {'color': '#222222', 'size': 14}},
            'steps': [{'label': '<br>'.join(wrap(content.readout(point), _READOUT_WIDTH)),
                       'method': 'animate',
                       'args': [[str(point)], _JUMP]} for point in points]}],
        updatemenus=[{
            'type': 'buttons', 'direction': 'left', 'showactive': False, 'x': 0, 'y': 1,
            'xanchor': 'left', 'yanchor': 'bottom', 'pad': {'b': 10}, 'buttons': [
                {'label': '▶ play', 'method': 'animate', 'args': [None, play]},
                {'label': '❚❚', 'method': 'animate', 'args': [[None], _JUMP]}]}])
