"""The layout of the page `explore`: its parts, their fields and their style."""

from functools import partial
from typing import Any

from dash import dcc, html
import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from .editing import list_handles, Mission, read_field
from ..mission.propagation import ENVIRONMENTS
from ..mission.scenario import Scenario
from ..mission.validation import rate_text
from ..output.drawing import map_extent, RATE, uav_color
from ..output.traces import label_charts, LINE_STYLES
from ..plan.plan import Plan

MISSION, PLAN = 'mission.yaml', 'plan.json'
ADDED = ('eavesdropper', 'jammer', 'zone')
_ROOM = 1 / 3  # Room around the mission on its map, as a share of its larger side.

_slider = partial(dcc.Slider, marks=None)
GROUPS: dict[str, dict[str, tuple[str, str, partial[Any]]]] = {
    'Time': {'duration (s)': ('mission', 'duration', partial(_slider, 1, 1000, 1))},
    'Powers': {
        'mean, transmitter (W)': ('transmitter', 'average_power', partial(_slider, 0.05, 5, 0.05)),
        'peak, transmitter (W)': ('transmitter', 'peak_power', partial(_slider, 0.05, 20, 0.05)),
        'mean, jammers (W)': ('jammers', 'average_power', partial(_slider, 0.05, 5, 0.05)),
        'peak, jammers (W)': ('jammers', 'peak_power', partial(_slider, 0.05, 20, 0.05))},
    'Vehicle': {
        'acceleration (m/s², 0: no limit)': (
            'uavs', 'max_acceleration', partial(_slider, 0, 10, 0.1)),
        'tracking margin (m)': ('mission', 'tracking_margin', partial(_slider, 0, 20, 0.5))},
    'Channel': {
        'SNR at 1 m and 1 W (dB)': ('mission', 'reference_snr_db', partial(_slider, 40, 120, 0.5)),
        'path loss exponent': ('channel', 'exponent', partial(_slider, 2, 6, 0.1)),
        'outage (0: none)': ('channel', 'outage', partial(_slider, 0, 0.5, 0.01)),
        'lines of sight': ('channel', 'los', partial(
            dcc.Dropdown, [*ENVIRONMENTS], placeholder='everywhere')),
        'Rician factor (dB)': ('channel', 'rician_k_db', partial(
            dcc.Input, type='number', debounce=True, placeholder='no fading')),
        'eavesdroppers': ('mission', 'colluding', partial(dcc.RadioItems, [
            {'label': 'alone', 'value': False}, {'label': 'colluding', 'value': True}],
            inline=True))}}
FIELDS = {label: field for fields in GROUPS.values() for label, field in fields.items()}
"""Owner (see read_field), name and component of each field of the page, by its label."""

_OPEN = ('Time', 'Powers')

PAGE = """<!DOCTYPE html>
<html lang="en"><head>{%metas%}<title>{%title%}</title><link rel="icon" href="data:,">{%css%}
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
:root { --Dash-Fill-Interactive-Strong: #2757dd; --line: #e3e5ea; --muted: #5a6270 }
body { margin: 0; color: #1f2430; background: #fff;
  font: 14px/1.4 -apple-system, BlinkMacSystemFont, "Segoe UI", Helvetica, Arial, sans-serif }
#explore { display: grid; gap: 12px; padding: 12px 16px; grid-template-columns: minmax(0, 1fr) }
header { display: flex; flex-wrap: wrap; gap: 4px 28px; align-items: center;
  padding-bottom: 10px; border-bottom: 1px solid var(--line) }
h1 { margin: 0; font-size: 20px; line-height: 1.2; font-weight: 600; overflow-wrap: anywhere }
#headline { flex: 1 1 300px; min-width: 0 }
#objective, #state { color: var(--muted) }
#state { min-height: 1.4em }
#state.failed { color: #b00020; font-weight: 600 }
#problem { color: #b00020; white-space: pre-wrap; overflow-wrap: anywhere }
#problem:empty { display: none }
#words { display: flex; gap: 24px; align-items: end; min-height: 52px }
#words.old { opacity: 0.4 }
.rate b { display: block; font-size: 30px; line-height: 1.1; font-weight: 600; color: #RATE;
  font-variant-numeric: tabular-nums }
.rate i, .entry i { display: inline-block; width: 22px; margin-right: 6px; vertical-align: middle;
  border-top: 3px solid #RATE }
.rate small { color: var(--muted); font-size: 12px }
h2, summary { margin: 0; font-size: 13px; font-weight: 600 }
.bar { display: flex; flex-wrap: wrap; gap: 6px; align-items: center; margin-bottom: 6px }
.caption { min-height: 24px }
.entry { display: inline-block; margin-right: 14px; font-size: 13px }
button { padding: 5px 11px; border: 1px solid #cfd3dc; border-radius: 6px; background: #fff;
  color: inherit; font: inherit; font-size: 13px; cursor: pointer }
button:hover { border-color: #2757dd; color: #2757dd }
.dash-graph { border: 1px solid var(--line); border-radius: 8px; overflow: hidden }
details { padding: 8px 12px; border: 1px solid var(--line); border-radius: 8px }
details + details { margin-top: 8px }
summary { cursor: pointer }
details label { display: block; margin-top: 6px; color: var(--muted); font-size: 13px }
#fields .dash-range-slider-input { display: block !important; width: 52px !important;
  height: 26px }
#fields { order: 1 }
#file { order: 2 }
#file textarea { width: 100%; height: 320px; margin-top: 8px; padding: 8px; box-sizing: border-box;
  border: 1px solid #cfd3dc; border-radius: 6px; font: 12px/1.4 ui-monospace, monospace }
.graph { height: 58vh !important; min-height: 340px }
@media (min-width: 900px) {
  #explore { grid-template-columns: 326px minmax(0, 1.15fr) minmax(0, 1fr) }
  header, #file { grid-column: 1 / -1 }
  #fields { grid-area: 2 / 1; max-height: calc(100vh - 122px); overflow-y: auto }
  .graph { height: calc(100vh - 190px) !important; min-height: 400px } }
</style></head><body>{%app_entry%}<footer>{%config%}{%scripts%}{%renderer%}</footer>
<script>
// Dash tells only the console that no server answers.
const ask = window.fetch;
window.fetch = (...request) => ask(...request).catch(error => {
  dash_clientside.set_props('state', {
    children: 'the server of this page has ended: start it again', className: 'failed'});
  dash_clientside.set_props('words', {className: 'old'});
  throw error;
});
// A double click or tap on a shape removes what it stands for; a second press that moves drags it.
let first = {timeStamp: -Infinity}, second = null;
const distance = (event, earlier) => Math.hypot(
  event.clientX - earlier.clientX, event.clientY - earlier.clientY);
addEventListener('pointerdown', event => {
  const shape = event.target.closest('#map [data-index]');
  const isSecond = shape && event.timeStamp - first.timeStamp < 500 && distance(event, first) < 20;
  second = isSecond ? {event, index: Number(shape.dataset.index)} : null;
  first = isSecond ? {timeStamp: -Infinity} : event;
}, true);
addEventListener('pointerup', event => {
  // Plotly drags a shape from 8 pixels on.
  if (second && distance(event, second.event) < 8) {
    dash_clientside.set_props('removed', {data: [second.index, Date.now()]});
  }
  second = null;
}, true);
</script></body></html>""".replace('#RATE', RATE)


def lay_out(page: str, name: str, scenario: Scenario, text: str, mission: Mission) -> html.Div:
    """
    Return the component tree of a page: headline, fields, map, charts and mission file.

    :param page: key of the page.
    :param name: name of the mission, in the headline.
    :param text: text of the mission file, in a pane of its own.
    :param mission: the mission that the map and the fields show.
    """
    shared = {'template': 'plotly_white', 'margin': {'l': 62, 'r': 12, 't': 12, 'b': 44},
              'showlegend': False}
    charts = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.05).update_layout(shared)
    label_charts(charts, 1)
    config: Any = {'displayModeBar': False, 'edits': {'shapePosition': True}, 'scrollZoom': True}
    make_graph = partial(dcc.Graph, config=config, className='graph', responsive=True)
    headline = html.Header([
        html.Div(id='headline', children=[
            html.H1(name), html.Div('largest secrecy rate in the worst case', id='objective'),
            html.Div('planning ...', id='state'), html.Div(id='problem', role='alert')]),
        html.Div(id='words')])
    buttons = {'undo': 'undo', 'redo': 'redo', **{kind: f'+ {kind}' for kind in ADDED}}
    map_pane = html.Div([
        html.Div([html.Button(label, id={'do': name}) for name, label in buttons.items()],
                 className='bar'),
        html.Div(id='legend', className='caption'),
        make_graph(id='map', figure=_make_map(scenario, mission, shared))])
    chart_pane = html.Div([
        html.Div(html.Button('keep this plan', id='keep'), className='bar'),
        html.H2('Power, rate and what is delivered over time', className='caption'),
        make_graph(id='charts', figure=charts)])
    file_pane = html.Div(id='file', children=[
        html.Div([html.H2('Mission file'), *(
            html.Button(f'download {name}', id={'save': name}) for name in (MISSION, PLAN))],
            className='bar'),
        dcc.Textarea(id='yaml', value=text, spellCheck=False)])
    # The browser does not show these values; the callbacks of the page read and set them.
    hidden = [
        dcc.Store(id='page', data=page), dcc.Store(id='version', data=0), dcc.Store(id='removed'),
        dcc.Store(id='drawn', data=0),
        dcc.Interval(id='tick', interval=200, n_intervals=0, max_intervals=0),
        dcc.Download(id='download')]
    return html.Div(id='explore', children=[
        headline, _make_fields(mission), map_pane, chart_pane, file_pane, *hidden])


def _make_map(scenario: Scenario, mission: Mission, shared: dict[str, Any]) -> go.Figure:
    """Return the map with the shapes of a mission; `shared` is the layout of all figures."""
    (left, low), (right, high) = widen(map_extent(scenario))
    axis = {'zeroline': False, 'ticks': 'outside'}
    return go.Figure(layout={
        # Plotly keeps the user's view while uirevision is constant. Shapes follow the mission.
        **shared, 'uirevision': 'map', 'editrevision': False, 'dragmode': 'pan',
        'shapes': [handle.shape for handle in list_handles(mission)],
        # The range grows on the side where the panel is longer, so that the map fills it.
        'xaxis': {**axis, 'title': 'east (m)', 'range': [left, right]},
        'yaxis': {**axis, 'title': 'north (m)', 'range': [low, high], 'scaleanchor': 'x'}})


def _make_fields(mission: Mission) -> html.Div:
    """Return the sliders and inputs of GROUPS with the values of a mission."""
    return html.Div(id='fields', children=[
        html.Details([html.Summary(group), *(
            html.Div([html.Label(label), make_input(
                id={'field': label}, value=read_field(mission, owner, field))])
            for label, (owner, field, make_input) in fields.items())], open=group in _OPEN)
        for group, fields in GROUPS.items()])


def widen(extent: Any) -> Any:
    """Return corners (2, 2) [m] moved outward by _ROOM of the larger side: room to drag into."""
    return np.asarray(extent) + _ROOM * np.ptp(extent, axis=0).max() * np.array([[-1], [1]])


def list_rates(plan: Plan, kept: Plan) -> list[html.Div]:
    """Return both rates of a plan in large type, and the difference from the kept plan's rate."""
    promise, channel = plan.promise, plan.scenario.channel
    rates = (('worst_case', promise.worst_case_rate, 'dashed'),
             ('guaranteed', promise.guaranteed_rate, 'solid'))
    caveat = promise.text and f'; {promise.text}'
    shown = [html.Div([
        html.B(rate_text(rate, 3)), html.I(style={'borderTopStyle': style}),
        html.Small(f'{channel.rate_name(name)} (bit/s/Hz){caveat}')], className='rate')
        for name, rate, style in rates]
    if plan is not kept:
        difference = round(plan.rate - kept.rate, 2)
        shown.append(html.Div([html.B(f'{difference:+.2f}' if difference else '0.00'),
                               html.Small('bit/s/Hz against the plan kept')], className='rate'))
    return shown


def list_entries(plan: Plan) -> list[html.Span]:
    """Return the legend of the map: a line and a name for each UAV."""
    styles = {'solid': 'solid', 'dash': 'dashed', 'dot': 'dotted', 'dashdot': 'dashed'}
    return [html.Span([html.I(style={
        'borderTopColor': uav_color(index),
        'borderTopStyle': styles[LINE_STYLES[index % len(LINE_STYLES)]]}),
        f'{uav.name} {"jams" if index else "transmits"}'], className='entry')
        for index, uav in enumerate(plan.scenario.uavs)]
