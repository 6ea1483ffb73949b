"""The page of `explore`: a mission to drag and its best plan, for a browser of this computer."""

import argparse
from concurrent.futures import Future, wait
from contextlib import suppress
from functools import partial
import logging
from pathlib import Path
import socket
from tempfile import TemporaryDirectory
import threading
from typing import Any
import uuid
import webbrowser

from dash import ALL, ctx, Dash, dcc, html, Input, no_update, Output, Patch, State
from dash.exceptions import PreventUpdate
from flask import abort, request
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from werkzeug.serving import make_server

from .editing import (
    add_member, drag, list_handles, Mission, read_field, remove_member, set_field, to_mission)
from .missions import load_input
from ..errors import MissionFileError, OptionError, PlanningError
from ..mission.formats.documents import format_document, MOST_BYTES
from ..mission.formats.mission_file import EXAMPLE, read_mission
from ..mission.propagation import ENVIRONMENTS
from ..mission.scenario import Scenario
from ..optimize import solve
from ..output.drawing import map_extent, rate_label
from ..output.traces import label_charts, margin_traces, PlanTraces, power_range
from ..plan.plan import Plan
from ..plan.results import Iteration

_HOST = '127.0.0.1'
_TIME_LIMIT = 5.0  # Of a solve, in s.
_PROGRESS_DELAY = 0.3  # s without a plan after which the progress is shown instead.
_MOST_STEPS = 100  # That can be undone.
_MISSION, _PLAN = 'mission.yaml', 'plan.json'
_ADDED = ('eavesdropper', 'jammer', 'zone')
_format = partial(format_document, _MISSION)

_slider = partial(dcc.Slider, marks=None)
_FIELDS = {
    'duration (s)': ('mission', 'duration', partial(_slider, 1, 1000, 1)),
    'mean power, transmitter (W)': (
        'transmitter', 'average_power', partial(_slider, 0.05, 5, 0.05)),
    'peak power, transmitter (W)': ('transmitter', 'peak_power', partial(_slider, 0.05, 20, 0.05)),
    'mean power, jammers (W)': ('jammers', 'average_power', partial(_slider, 0.05, 5, 0.05)),
    'peak power, jammers (W)': ('jammers', 'peak_power', partial(_slider, 0.05, 20, 0.05)),
    'SNR at 1 m and 1 W (dB)': ('mission', 'reference_snr_db', partial(_slider, 40, 120, 0.5)),
    'acceleration (m/s², 0 for no limit)': (
        'uavs', 'max_acceleration', partial(_slider, 0, 10, 0.1)),
    'tracking margin (m)': ('mission', 'tracking_margin', partial(_slider, 0, 20, 0.5)),
    'path loss exponent': ('channel', 'exponent', partial(_slider, 2, 6, 0.1)),
    'outage (0 for none)': ('channel', 'outage', partial(_slider, 0, 0.5, 0.01)),
    'lines of sight': ('channel', 'los', partial(
        dcc.Dropdown, [*ENVIRONMENTS], placeholder='everywhere')),
    'Rician factor (dB)': ('channel', 'rician_k_db', partial(
        dcc.Input, type='number', debounce=True, placeholder='no fading')),
    'eavesdroppers': ('mission', 'colluding', partial(dcc.RadioItems, [
        {'label': 'alone', 'value': False}, {'label': 'colluding', 'value': True}]))}

_PAGE = """<!DOCTYPE html>
<html lang="en"><head>{%metas%}<title>{%title%}</title><link rel="icon" href="data:,">{%css%}
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body { margin: 8px; font: 14px sans-serif }
#explore { display: grid; gap: 8px; grid-template-columns: minmax(0, 1fr) }
#words { min-height: 3.6em }
#problem { color: #B00020; white-space: pre-wrap }
button { margin: 0 4px 4px 0 }
textarea { width: 100%; height: 300px; box-sizing: border-box; font: 12px monospace }
@media (min-width: 900px) { #explore { grid-template-columns: 310px repeat(2, minmax(0, 1fr)) }
  #fields { grid-area: 1 / 1 / span 2 } #file { grid-column: span 2 } }
</style></head><body>{%app_entry%}<footer>{%config%}{%scripts%}{%renderer%}</footer>
<script>
// A double click or tap on a shape removes what it stands for.
let first = {timeStamp: -Infinity};
addEventListener('pointerdown', event => {
  const shape = event.target.closest('#map [data-index]');
  const isSecond = shape && event.timeStamp - first.timeStamp < 500
    && Math.hypot(event.clientX - first.clientX, event.clientY - first.clientY) < 20;
  if (isSecond) {
    dash_clientside.set_props('removed', {data: [Number(shape.dataset.index), Date.now()]});
  }
  first = isSecond ? {timeStamp: -Infinity} : event;
}, true);
</script></body></html>"""


class Editor:
    """
    The missions of a page, which need not be ones that can be flown, and their plans.

    :param scenario: a Scenario to begin with.
    :ivar version: number of what the page should show.
    :ivar problem: why the last edit was not taken, '' if it was.
    :ivar progress: of the last solve, as text.
    :ivar plan: the last Plan, None at first.
    :ivar kept: the Plan with which others are compared.
    :ivar extent: the corners of the map, (2, 2) in m.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.version, self.problem, self.progress = 0, '', ''
        self.plan: Plan | None = None
        self.kept: Plan | None = None
        self.extent = map_extent(scenario)
        self._history, self._present = [to_mission(scenario)], 0
        self._solve: Future[Plan] | None = None
        self._lock = threading.Lock()

    @property
    def mission(self) -> Mission:
        """Return the mission as it is now."""
        return self._history[self._present]

    def edit(self, mission: Mission) -> None:
        """Go on with another mission."""
        if mission != self.mission:
            self._history = [*self._history[:self._present + 1], mission][-_MOST_STEPS:]
            self.step(_MOST_STEPS)

    def step(self, steps: int) -> None:
        """Go so many steps on in the history, or back, as far as it reaches."""
        with self._lock:
            self._present = min(max(self._present + steps, 0), len(self._history) - 1)
            self.version, self.problem, self._solve = self.version + 1, '', None

    def solve(self) -> Future[Plan]:
        """
        Return the solve of the mission as it is now, in a thread that ends with its mission.

        :raises ScenarioError: for what is wrong with the mission.
        """
        with self._lock:
            if self._solve is None:
                scenario, self._solve = Scenario.from_dict(self.mission), Future()
                self.progress = 'planning ...'
                # Not one of an executor, which waits for it before the main thread ends.
                threading.Thread(target=self._run, args=(self._solve, scenario)).start()
            return self._solve

    def _run(self, future: Future[Plan], scenario: Scenario) -> None:
        def report(iteration: Iteration) -> bool:
            if future is self._solve:
                self.progress = (f'planning: {iteration.rate:.3f} bit/s/Hz after '
                                 f'{iteration.elapsed:.1f} of at most {_TIME_LIMIT:g} s')
            # At the end of the program, too, whose threads may not run on in the kernel.
            return future is not self._solve or not threading.main_thread().is_alive()

        try:
            future.set_result(solve(scenario, on_iteration=report, time_limit=_TIME_LIMIT))
        except Exception as error:
            future.set_exception(error)


def explore_mission(options: argparse.Namespace) -> None:
    """Serve the page until Ctrl-C."""
    scenario = load_input(options.mission or str(EXAMPLE))
    try:
        listener = socket.create_server((_HOST, options.port))
    except (OSError, OverflowError) as error:
        raise OptionError(f'--port is {options.port}; it cannot be used: '
                          f'{getattr(error, "strerror", None) or error}') from None
    port = listener.getsockname()[1]
    logging.getLogger('werkzeug').setLevel(logging.ERROR)
    server = make_server(_HOST, port, make_app(scenario, port).server, threaded=True,
                         fd=listener.fileno())
    url = f'http://{_HOST}:{port}/'
    print(f'{url} shows the mission; Ctrl-C ends it', flush=True)
    # Some browsers run in the terminal until they are left.
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
    with suppress(KeyboardInterrupt):
        server.serve_forever()


def make_app(scenario: Scenario, port: int) -> Dash:
    """Return the Dash app of a Scenario, which answers only pages of its own from this port."""
    app = Dash(__name__, title='explore', update_title=None, index_string=_PAGE)
    app.server.config['MAX_CONTENT_LENGTH'] = 2 * MOST_BYTES
    editors: dict[str, Editor] = {}

    @app.server.before_request
    def refuse_others() -> None:
        # The host is another one after DNS rebinding, the origin in requests of other sites.
        own = f'http://{request.host}'
        if request.host not in (f'{_HOST}:{port}', f'localhost:{port}') or request.headers.get(
                'Origin', own) != own:
            abort(403)

    def lay_out() -> html.Div:
        page = uuid.uuid4().hex
        editors[page] = Editor(scenario)
        return _lay_out(page, scenario)

    app.layout = lay_out

    @app.callback(
        Output('version', 'data'), Output('yaml', 'value'), Output({'field': ALL}, 'value'),
        Input('removed', 'data'), Input('yaml', 'n_blur'),
        Input({'do': ALL}, 'n_clicks'), Input({'field': ALL}, 'value'),
        State('yaml', 'value'), State('version', 'data'), State('page', 'data'),
        prevent_initial_call=True)
    def edit(*arguments: Any) -> Any:
        *_, values, text, version, page = arguments
        value = text if ctx.triggered_id == 'yaml' else ctx.triggered[0]['value']
        return _edit(editors[page], ctx.triggered_id, value, values, version)

    # Apart: a view that moves, as when the window does, would supersede another edit under way.
    @app.callback(
        Output('version', 'data', allow_duplicate=True),
        Output('yaml', 'value', allow_duplicate=True), Input('map', 'relayoutData'),
        State('version', 'data'), State('page', 'data'), prevent_initial_call=True)
    def edit_shapes(change: Any, version: int, page: str) -> Any:
        return _edit(editors[page], 'map', change, [], version)[:2]

    @app.callback(
        Output('map', 'figure'), Output('charts', 'figure'), Output('words', 'children'),
        Output('problem', 'children'), Output('tick', 'max_intervals'), Output('drawn', 'data'),
        Input('version', 'data'), Input('tick', 'n_intervals'), Input('keep', 'n_clicks'),
        State('drawn', 'data'), State('page', 'data'))
    def follow(_: int, ticks: int, clicks: Any, drawn: int, page: str) -> Any:
        editor = editors[page]
        if ctx.triggered_id == 'keep':
            editor.kept = editor.plan
        version = editor.version
        return *_follow(editor, drawn != version, ticks), version

    @app.callback(Output('download', 'data'), Input({'save': ALL}, 'n_clicks'),
                  State('page', 'data'), prevent_initial_call=True)
    def download(_: Any, page: str) -> Any:
        if ctx.triggered_id['save'] == _MISSION:
            return dcc.send_string(_format(editors[page].mission), _MISSION)
        with TemporaryDirectory() as folder:
            editors[page].plan.save(Path(folder) / _PLAN)
            return dcc.send_file(Path(folder) / _PLAN)

    return app


def _edit(editor: Editor, trigger: Any, value: Any, values: list[Any], version: int) -> Any:
    """
    Edit the mission as the page says.

    :param trigger: what was changed on the page, to a value.
    :param values: those of all fields on the page, which shows this version.
    :return: the outputs of the callback `edit`.
    """
    mission = editor.mission
    try:
        if trigger == 'map':
            editor.edit(drag(mission, value))
        elif trigger == 'removed':
            editor.edit(remove_member(mission, value[0]))
        elif trigger == 'yaml':
            editor.edit(to_mission(read_mission(_MISSION, Scenario, value)))
        elif 'field' in trigger:
            editor.edit(set_field(mission, *_FIELDS[trigger['field']][:2], value))
        elif trigger['do'] in _ADDED:
            editor.edit(add_member(mission, trigger['do'], editor.extent))
        else:
            editor.step(-1 if trigger['do'] == 'undo' else 1)
    except MissionFileError as error:
        editor.version += 1
        editor.problem = '\n'.join(f'line {line}: {words}' for line, words in error.problems)
    if version == editor.version:  # Nothing but the view was moved.
        raise PreventUpdate
    fields = [read_field(editor.mission, *field[:2]) for field in _FIELDS.values()]
    return editor.version, value if editor.problem else _format(editor.mission), [
        no_update if field == before else field for field, before in zip(fields, values)]


def _follow(editor: Editor, is_new: bool, ticks: int) -> Any:
    """Return the view of a mission, new or not: its shapes and plan, or its progress."""
    on_map = Patch()
    if is_new:
        on_map['layout']['shapes'] = [item.shape for item in list_handles(editor.mission)]
    try:
        future = editor.solve()
        wait([future], _PROGRESS_DELAY)
        if not future.done() or editor.solve() is not future:
            return on_map, no_update, editor.progress, editor.problem, ticks + 1
        editor.plan = future.result()
    except PlanningError as error:
        return on_map, no_update, no_update, editor.problem or str(error), ticks
    plan, editor.kept = editor.plan, editor.kept or editor.plan
    words = [rate_label(plan), f'{plan.message}, in {plan.solve_time:.2f} s']
    if plan is not editor.kept:
        words.insert(1, f'{plan.rate - editor.kept.rate:+.2f} bit/s/Hz against the plan kept')
    return (on_map, _draw_plans(on_map, plan, editor.kept), [*map(html.Div, words)],
            editor.problem, ticks)


def _lay_out(page: str, scenario: Scenario) -> html.Div:
    mission = to_mission(scenario)
    config = {'displayModeBar': False, 'edits': {'shapePosition': True}, 'scrollZoom': True}
    make_graph = partial(dcc.Graph, config=config, style={'height': '58vh', 'minHeight': 340})
    (left, right), (low, high) = map_extent(scenario).T.tolist()
    axis = {'constrain': 'domain', 'zeroline': False, 'ticks': 'outside'}
    shared = {'template': 'plotly_white', 'margin': {'l': 60, 'r': 5, 't': 5, 'b': 40},
              'legend': {'orientation': 'h', 'y': 1.0, 'yanchor': 'bottom'}}
    on_map = go.Figure(layout={
        # The view stays as the user has it; shapes are where the mission has them.
        **shared, 'uirevision': 'map', 'editrevision': False, 'dragmode': 'pan',
        'shapes': [item.shape for item in list_handles(mission)],
        'xaxis': {**axis, 'title': 'east (m)', 'range': [left, right]},
        'yaxis': {**axis, 'title': 'north (m)', 'range': [low, high], 'scaleanchor': 'x'}})
    charts = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.04).update_layout(shared)
    label_charts(charts, 1)
    buttons = {'undo': 'undo', 'redo': 'redo', **{kind: f'+ {kind}' for kind in _ADDED}}
    return html.Div(id='explore', children=[
        html.Div([
            html.Div([html.Button(label, id={'do': name}) for name, label in buttons.items()]),
            make_graph(id='map', figure=on_map)]),
        html.Div([
            html.Button('keep this plan', id='keep'), html.Div(id='words'),
            html.Div(id='problem', role='alert'), make_graph(id='charts', figure=charts)]),
        html.Div(id='fields', children=[
            html.Div([html.Label(label), make(
                id={'field': label}, value=read_field(mission, owner, field))])
            for label, (owner, field, make) in _FIELDS.items()]),
        html.Div(id='file', children=[
            *(html.Button(f'download {name}', id={'save': name}) for name in (_MISSION, _PLAN)),
            dcc.Textarea(id='yaml', value=_format(mission), spellCheck='false')]),
        dcc.Store(id='page', data=page), dcc.Store(id='version', data=0), dcc.Store(id='removed'),
        dcc.Store(id='drawn', data=0),
        dcc.Interval(id='tick', interval=200, n_intervals=0, max_intervals=0),
        dcc.Download(id='download')])


def _draw_plans(on_map: Patch, plan: Plan, kept: Plan) -> Patch:
    """Draw a plan on the map, and one in grey behind it; return the change of the charts."""
    content, behind, charts = PlanTraces(plan), PlanTraces(kept), Patch()
    on_map['data'] = [*margin_traces(plan.scenario), *content.way_traces(),
                      *map(_paint_grey, behind.path_traces()), *content.path_traces()]
    charts['data'] = [trace.update(xaxis=f'x{row}', yaxis=f'y{row}') for trace, row in (
        *((_paint_grey(trace), row) for trace, row in behind.chart_traces()),
        *content.chart_traces())]
    charts['layout']['yaxis']['range'] = power_range(plan)
    return charts


def _paint_grey(trace: go.Scatter) -> go.Scatter:
    return trace.update(line_color='#BBBBBB', showlegend=False, hoverinfo='skip')
