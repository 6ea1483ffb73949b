"""The page of `explore`: a mission to drag and its best plan, for a browser of this computer."""

import argparse
from concurrent.futures import Future, wait
from contextlib import suppress
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
import numpy as np
import plotly.graph_objects as go
from werkzeug.serving import make_server

from .editing import (
    add_member, drag, list_handles, list_places, Mission, read_field, remove_member, set_field,
    to_mission)
from .layout import (
    ADDED, FIELDS, lay_out, list_entries, list_rates, MISSION, PAGE, PLAN, widen)
from .mission_text import MissionText
from .missions import load_input
from ..errors import MissionFileError, OptionError, PlanningError
from ..mission.formats.documents import MOST_BYTES
from ..mission.formats.mission_file import EXAMPLE
from ..mission.scenario import Scenario
from ..optimize import solve
from ..output.drawing import map_extent
from ..output.traces import margin_traces, PlanTraces, power_range
from ..plan.plan import Plan
from ..plan.results import Iteration

_HOST = '127.0.0.1'
_TIME_LIMIT = 5.0  # Time limit of a solve [s].
_PROGRESS_DELAY = 0.3  # Time [s] after which the progress of an unfinished solve is shown.
_MOST_STEPS = 100  # Largest number of missions in the history.
_OLDER = 'this page is older than its server: reload'
_NOT_FLOWN, _NOT_TAKEN = 'cannot be flown', 'this text is not taken: the mission stays as it was'


class Editor:
    """
    The missions of a page and their plans; a mission may be impossible to fly.

    :param source: the MissionText of the first mission.
    :ivar version: number that grows with each change that the page should show.
    :ivar numbered: the version since which the shapes of the map have their numbers.
    :ivar unscaled: (duration, slots) before the slider, by the (duration, slots) that it set.
    :ivar problem: why the last edit was refused, '' if it was taken.
    :ivar progress: text on the progress of the last solve.
    :ivar source: the MissionText, which reads and changes texts.
    :ivar plan: the last Plan, None at first.
    :ivar kept: the Plan with which new plans are compared, None at first.
    :ivar extent: the corners of the map, (2, 2) in m.
    """

    def __init__(self, source: MissionText) -> None:
        """Begin with the mission of `source`; nothing is planned yet."""
        self.version, self.problem, self.progress = 0, '', ''
        self.plan: Plan | None = None
        self.kept: Plan | None = None
        self.source = source
        self.extent = widen(map_extent(source.scenario))
        self.unscaled: dict[tuple[float, int], tuple[float, int]] = {}
        self.numbered, self._places = 0, list_places(to_mission(source.scenario))
        # Missions with their texts, oldest first, and the index of the present one.
        self._history, self._present = [(to_mission(source.scenario), source.text)], 0
        self._solve: Future[Plan] | None = None
        self._lock = threading.RLock()

    @property
    def mission(self) -> Mission:
        """Mission that the page shows now."""
        return self._history[self._present][0]

    @property
    def text(self) -> str:
        """Text of the present mission, as its file would have it."""
        return self._history[self._present][1]

    def edit(self, mission: Mission, text: str | None = None) -> None:
        """Add a changed mission in place of undone ones; without a text, adapt the old text."""
        with self._lock:
            if mission != self.mission or text not in (None, self.text):
                if text is None:
                    text = self.source.change(self.text, self.mission, mission)
                self._history = [
                    *self._history[:self._present + 1], (mission, text)][-_MOST_STEPS:]
                self.step(_MOST_STEPS)  # The new mission is the last one of the history.

    def write(self, text: str) -> None:
        """
        Take the mission of another text.

        :raises MissionFileError: if the text is refused.
        """
        if text != self.text:
            self.edit(to_mission(self.source.read(text)), text)
        elif self.problem:
            self.step(0)

    def step(self, steps: int) -> None:
        """Redo a number of edits, or undo them if it is negative; stop at the history's ends."""
        with self._lock:
            self._present = min(max(self._present + steps, 0), len(self._history) - 1)
            self.version, self.problem, self._solve = self.version + 1, '', None
            if (places := list_places(self.mission)) != self._places:
                self.numbered, self._places = self.version, places

    def solve(self) -> Future[Plan]:
        """
        Return the future Plan of the present mission; a thread plans it until the next change.

        :raises ScenarioError: for what is wrong with the mission.
        """
        with self._lock:
            if self._solve is None:
                scenario, self._solve = Scenario.from_dict(self.mission), Future()
                self.progress = 'planning ...'
                # An executor's thread would be waited for before the main thread ends.
                threading.Thread(target=self._run, args=(self._solve, scenario)).start()
            return self._solve

    def _run(self, future: Future[Plan], scenario: Scenario) -> None:
        """Plan a scenario, and set the plan or the error as the result of a future."""
        def report(iteration: Iteration) -> bool:
            if future is self._solve:
                self.progress = (f'planning: {iteration.rate:.3f} bit/s/Hz after '
                                 f'{iteration.elapsed:.1f} of at most {_TIME_LIMIT:g} s')
            # True stops the solve: after an edit, or at the end of the program, when no thread
            # may stay in the kernel.
            return future is not self._solve or not threading.main_thread().is_alive()

        try:
            future.set_result(solve(scenario, on_iteration=report, time_limit=_TIME_LIMIT))
        except Exception as error:
            future.set_exception(error)


def explore_mission(options: argparse.Namespace) -> None:
    """Serve a page of the mission, or of the example, in a browser here; return after Ctrl-C."""
    source = load_input(options.mission or str(EXAMPLE), MissionText)
    try:
        listener = socket.create_server((_HOST, options.port))
    except (OSError, OverflowError) as error:
        raise OptionError(f'--port is {options.port}; it cannot be used: '
                          f'{getattr(error, "strerror", None) or error}') from None
    port = listener.getsockname()[1]
    logging.getLogger('werkzeug').setLevel(logging.ERROR)
    server = make_server(_HOST, port, make_app(source, port).server, threaded=True,
                         fd=listener.fileno())
    url = f'http://{_HOST}:{port}/'
    print(f'{url} shows the mission; Ctrl-C ends it', flush=True)
    # Some browsers run in the terminal until they are left.
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
    with suppress(KeyboardInterrupt):
        server.serve_forever()


def make_app(source: MissionText, port: int) -> Dash:
    """Return the Dash app of a mission, with an Editor for each page; other sites get 403."""
    app = Dash(__name__, title='explore', update_title='', index_string=PAGE)
    app.server.config['MAX_CONTENT_LENGTH'] = 2 * MOST_BYTES
    editors: dict[str, Editor] = {}

    def refuse_others() -> None:
        """Answer 403 to a request that is not for this server or comes from another site."""
        # DNS rebinding shows in the host, and a request of another site in the origin.
        own = f'http://{request.host}'
        if request.host not in (f'{_HOST}:{port}', f'localhost:{port}') or request.headers.get(
                'Origin', own) != own:
            abort(403)

    app.server.before_request(refuse_others)

    def begin() -> html.Div:
        page = uuid.uuid4().hex
        editors[page] = Editor(source)
        return lay_out(page, source.name, source.scenario, source.text, editors[page].mission)

    app.layout = begin

    @app.callback(
        Output('version', 'data'), Output('yaml', 'value'), Output({'field': ALL}, 'value'),
        Input('removed', 'data'), Input('yaml', 'n_blur'),
        Input({'do': ALL}, 'n_clicks'), Input({'field': ALL}, 'value'),
        State('yaml', 'value'), State('version', 'data'), State('drawn', 'data'),
        State('page', 'data'),
        prevent_initial_call=True)
    def edit(*arguments: Any) -> Any:
        """Edit the mission by the changed component; return version, text and field values."""
        removed, *_, values, text, version, drawn, page = arguments
        if page not in editors:  # The callback `follow` asks to reload the page.
            return version + 1, no_update, [no_update] * len(values)
        # Dash gives None for the value of a component whose id has letters beyond ASCII.
        fields = dict(zip(FIELDS, values))
        changes = [(trigger, removed if trigger == 'removed' else None if trigger == 'yaml' else
                    fields.get(trigger.get('field')))
                   for trigger in ctx.triggered_prop_ids.values()]
        return _edit(editors[page], changes, text, values, version, drawn)

    @app.callback(
        Output('version', 'data', allow_duplicate=True),
        Output('yaml', 'value', allow_duplicate=True), Input('map', 'relayoutData'),
        State('version', 'data'), State('drawn', 'data'), State('page', 'data'),
        State('yaml', 'value'), prevent_initial_call=True)
    def edit_shapes(change: Any, version: int, drawn: int, page: str, text: str) -> Any:
        """Edit the mission by a dragged shape; return version and text."""
        # A callback of its own: with a resize of the window, Plotly reports a moved view, which
        # would supersede an edit that is running in the callback `edit`.
        if page not in editors:  # The callback `follow` asks to reload the page.
            return version + 1, no_update
        return _edit(editors[page], [('map', change)], text, [], version, drawn)[:2]

    @app.callback(
        Output('map', 'figure'), Output('charts', 'figure'), Output('words', 'children'),
        Output('words', 'className'), Output('legend', 'children'), Output('state', 'children'),
        Output('state', 'className'), Output('problem', 'children'),
        Output('tick', 'max_intervals'), Output('drawn', 'data'),
        Input('version', 'data'), Input('tick', 'n_intervals'), Input('keep', 'n_clicks'),
        State('drawn', 'data'), State('page', 'data'))
    def follow(_: int, ticks: int, clicks: Any, drawn: int, page: str) -> Any:
        """Show the mission, its plan or progress; `drawn` is the version whose shapes it shows."""
        if page not in editors:  # The server was started anew: the page must be reloaded.
            return (*[no_update] * 3, 'old', no_update, _OLDER, 'failed', '', ticks, drawn)
        editor = editors[page]
        if ctx.triggered_id == 'keep':
            editor.kept = editor.plan
        version = editor.version
        return *_follow(editor, drawn != version, ticks), version

    @app.callback(Output('download', 'data'), Output('version', 'data', allow_duplicate=True),
                  Input({'save': ALL}, 'n_clicks'),
                  State('yaml', 'value'), State('version', 'data'), State('page', 'data'),
                  prevent_initial_call=True)
    def download(_: Any, text: str, version: int, page: str) -> Any:
        """Send the text of the mission or its plan, nothing if it cannot be flown."""
        if page not in editors:
            raise PreventUpdate
        editor = editors[page]
        # The callback `edit` may take the text later, and tells why a text is refused.
        if version == editor.version:
            with suppress(MissionFileError):
                editor.write(text)
        if ctx.triggered_id['save'] == MISSION:
            return dcc.send_string(editor.text, MISSION), editor.version
        try:
            while not (future := editor.solve()).done():
                wait([future])
            with TemporaryDirectory() as folder:
                future.result().save(Path(folder) / PLAN)
                return dcc.send_file(Path(folder) / PLAN), editor.version
        except PlanningError:
            raise PreventUpdate from None

    return app


def _edit(editor: Editor, changes: list[tuple[Any, Any]], text: str, values: list[Any],
          version: int, drawn: int) -> Any:
    """
    Edit the mission by what was changed on the page; return version, text and values of FIELDS.

    A changed text is taken first, also if its pane has the focus. A text that is refused stays,
    and sets editor.problem; then 'undo' drops it, and no other edit is taken.

    :param changes: (id, new value) of each changed component; ids are 'map', 'removed', 'yaml',
        {'field': label} of FIELDS, and {'do': name} of a button.
    :param text: text of the pane.
    :param values: values of all FIELDS on the page, in their order.
    :param version: version that the page shows.
    :param drawn: version whose shapes the map shows; numbers of other shapes change nothing.
    :raises PreventUpdate: if nothing has changed since this version.
    """
    # Only the view of the map was moved if no shape changed.
    changes = [(trigger, value) for trigger, value in changes if trigger != 'map' or any(
        name.startswith('shapes[') for name in value)]
    if not changes:
        raise PreventUpdate
    try:
        if version == editor.version or editor.problem or ('yaml', None) in changes:
            editor.write(text)
        # Two changes come at once if a button is tapped while a field has the focus.
        for trigger, value in sorted(changes, key=lambda change: 'do' in change[0]):
            if trigger != 'yaml':
                _apply(editor, trigger, value, drawn)
    except MissionFileError as error:
        editor.version += 1
        editor.problem = '\n'.join(f'line {line}: {words}' for line, words in error.problems)
        if ({'do': 'undo'}, None) in changes:
            editor.step(0)
    fields = [read_field(editor.mission, *field[:2]) for field in FIELDS.values()]
    updates = [no_update if field == before else field for field, before in zip(fields, values)]
    if version == editor.version and all(update is no_update for update in updates):
        raise PreventUpdate
    return editor.version, text if editor.problem else editor.text, updates


def _apply(editor: Editor, trigger: Any, value: Any, drawn: int) -> None:
    """Edit the mission by one changed component; see _edit."""
    mission = editor.mission
    if trigger in ('map', 'removed') and drawn < editor.numbered:
        editor.step(0)  # The shapes are drawn again where they are.
    elif trigger == 'map':
        editor.edit(drag(mission, value))
    elif trigger == 'removed':
        editor.edit(remove_member(mission, value[0]))
    elif 'field' in trigger:
        owner, field, component = FIELDS[trigger['field']]
        present = read_field(mission, owner, field)
        if component.func is dcc.Slider and present is not None:
            low, high, step = component.args
            # A box that is left tells the present value on the slider, or None if it is empty.
            if value is None or abs(value - np.clip(present, low, high)) < 0.51 * step:
                return
        if field != 'duration':
            return editor.edit(set_field(mission, owner, field, value))
        # The steps of the slider scale one number of slots, as each step rounds.
        now = mission['duration'], mission['slots']
        duration, slots = editor.unscaled.get(now, now)
        mission = set_field({**mission, 'duration': duration, 'slots': slots}, owner, field, value)
        editor.unscaled[mission['duration'], mission['slots']] = duration, slots
        editor.edit(mission)
    elif trigger['do'] in ADDED:
        editor.edit(add_member(mission, trigger['do'], editor.extent))
    else:
        editor.step(-1 if trigger['do'] == 'undo' else 1)


def _follow(editor: Editor, is_new: bool, ticks: int) -> Any:
    """
    Return what the page shows of the present mission: shapes, and its plan or the progress.

    :param is_new: whether the page does not show the shapes of this version yet.
    :param ticks: number of ticks so far; one more follows while the solve runs.
    :return: the outputs of the callback `follow` in their order, except the last one, `drawn`.
        The class 'old' fades the rates of the last plan while another one is awaited.
    """
    on_map = Patch()
    if is_new:
        on_map['layout']['shapes'] = [item.shape for item in list_handles(editor.mission)]
    try:
        future = editor.solve()
        wait([future], _PROGRESS_DELAY)
        if not future.done() or editor.solve() is not future:
            return (on_map, no_update, no_update, 'old', no_update, editor.progress, '',
                    editor.problem, ticks + 1)
        editor.plan = future.result()
    except PlanningError as error:
        # The last plan stays on the page, faded, since it belongs to another mission.
        return (on_map, no_update, no_update, 'old', no_update, _NOT_FLOWN, 'failed',
                editor.problem or str(error), ticks)
    plan, editor.kept = editor.plan, editor.kept or editor.plan
    state = _NOT_TAKEN if editor.problem else (
        f'planned in {plan.solve_time:.2g} s: {plan.message}')
    return (on_map, _draw_plans(on_map, plan, editor.kept), list_rates(plan, editor.kept), '',
            list_entries(plan), state, 'failed' if editor.problem else '', editor.problem, ticks)


def _draw_plans(on_map: Patch, plan: Plan, kept: Plan) -> Patch:
    """Put a plan, and the kept plan in grey below, into `on_map`; return the charts' Patch."""
    content, behind, charts = PlanTraces(plan), PlanTraces(kept), Patch()
    on_map['data'] = [*margin_traces(plan.scenario), *content.track_traces(),
                      *map(_paint_grey, behind.path_traces()), *content.path_traces()]
    charts['data'] = [trace.update(xaxis=f'x{row}', yaxis=f'y{row}') for trace, row in (
        *((_paint_grey(trace), row) for trace, row in behind.chart_traces()),
        *content.chart_traces())]
    charts['layout']['yaxis']['range'] = power_range(plan)
    return charts


def _paint_grey(trace: go.Scatter) -> go.Scatter:
    return trace.update(line_color='#BBBBBB', showlegend=False, hoverinfo='skip')
