"""The web page of a plan: one HTML file with a time slider, which needs no network."""

import html

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from .drawing import GEOFENCE, map_extent, rate_label
from .traces import label_charts, PlanTraces
from ..mission.files import atomic_file

_MOST_FRAMES = 400
_PLAYING_TIME = 20.0  # In s.
_TITLE = 'Secure UAV plan'
# A phone shows the map at full size and scrolls to the rest beside it.
_STYLE = ('<meta name="viewport" content="width=device-width, initial-scale=1"><style>'
          'body { margin: 0 } #plan { min-width: 880px; min-height: 600px }</style>')
_JUMP = {'mode': 'immediate', 'transition': {'duration': 0},
         'frame': {'duration': 0, 'redraw': False}}


def save_page(plan, path):
    """Write the web page of a Plan to a self-contained HTML file, as atomic_file does."""
    # With a relative height, plotly resizes the figure with the window.
    figure = draw_page(plan).to_html(
        full_html=False, include_plotlyjs=True, auto_play=False, default_height='96vh',
        div_id='plan', config={'displaylogo': False, 'responsive': True})
    document = (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{_TITLE}'
                f'</title><link rel="icon" href="data:,">{_STYLE}</head>'
                f'<body>\n{figure}\n</body></html>\n')
    with atomic_file(path) as file:
        file.write(document)


def draw_page(plan):
    """Return the plotly Figure of a plan, with a frame for each point, at most _MOST_FRAMES."""
    content = PlanTraces(plan)
    figure = make_subplots(
        3, 2, specs=[[{'rowspan': 3}, {}], [None, {}], [None, {}]], shared_xaxes='columns',
        column_widths=[0.42, 0.58], vertical_spacing=0.05, horizontal_spacing=0.08)
    for trace in (*content.map_traces(), *content.path_traces()):
        figure.add_trace(trace, 1, 1)
    for trace, row in content.chart_traces():
        figure.add_trace(trace, row, 2)
    first = len(figure.data)
    for trace in content.moving_traces(0):
        figure.add_trace(trace, 1, 1)
    for trace, row in content.cursor_traces(0):
        figure.add_trace(trace, row, 2)
    numbers = list(range(first, len(figure.data)))
    last = plan.scenario.slots + 1
    points = sorted({*np.linspace(0, last, min(last + 1, _MOST_FRAMES)).round().astype(int)})
    figure.frames = [
        go.Frame(name=str(point), traces=numbers, data=[
            *content.moving_traces(point),
            *(trace for trace, _ in content.cursor_traces(point))]) for point in points]
    _label_axes(figure, map_extent(plan.scenario, [plan]).T.tolist(), content.peak)
    _add_controls(figure, content, points)
    return figure


def _label_axes(figure, ranges, peak):
    figure.update_xaxes(title_text='east (m)', range=ranges[0], constrain='domain', row=1, col=1)
    figure.update_yaxes(title_text='north (m)', range=ranges[1], constrain='domain',
                        scaleanchor='x', row=1, col=1)
    label_charts(figure, peak, 2)


def _add_controls(figure, content, points):
    plan = content.plan
    if plan.promise.is_partial:
        for row in (1, 2, 3):
            figure.add_vline(plan.promised_until, row=row, col=2, line={
                'color': GEOFENCE, 'width': 1.5, 'dash': 'dash'})
    title = f'{plan.method} plan: {rate_label(plan)}'
    if plan.bound is not None:
        title += f'<br><sup>{html.escape(plan.claim)}</sup>'
    play = {'mode': 'immediate', 'fromcurrent': True, 'transition': {'duration': 0},
            'frame': {'duration': 1000 * _PLAYING_TIME / len(points), 'redraw': False}}
    figure.update_layout(
        template='plotly_white', hovermode='closest', margin={'l': 60, 'r': 20, 't': 130, 'b': 80},
        title={'text': title, 'x': 0.01, 'yref': 'container', 'y': 1, 'yanchor': 'top',
               'pad': {'t': 25}},
        dragmode=False,  # A finger scrolls the page.
        legend={'orientation': 'h', 'yref': 'container', 'y': 0, 'yanchor': 'bottom'},
        sliders=[{
            'active': 0, 'x': 0.18, 'len': 0.82, 'y': 1, 'yanchor': 'bottom', 'pad': {'b': 10},
            # The labels of the steps are the readout; there is no room for them below the slider.
            'font': {'color': 'rgba(0,0,0,0)', 'size': 1},
            'ticklen': 0, 'tickcolor': 'rgba(0,0,0,0)',
            'currentvalue': {'font': {'color': '#222222', 'size': 14}},
            'steps': [{'label': content.readout(point), 'method': 'animate',
                       'args': [[str(point)], _JUMP]} for point in points]}],
        updatemenus=[{
            'type': 'buttons', 'direction': 'left', 'showactive': False, 'x': 0, 'y': 1,
            'xanchor': 'left', 'yanchor': 'bottom', 'pad': {'b': 10}, 'buttons': [
                {'label': '▶ play', 'method': 'animate', 'args': [None, play]},
                {'label': '❚❚', 'method': 'animate', 'args': [[None], _JUMP]}]}])
