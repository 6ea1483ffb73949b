"""The page to drag a mission on, in a real browser; what is drawn is what solve answers."""

from concurrent.futures import wait
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import replace
from http.client import HTTPConnection
import json
import re
import signal
import socket
import subprocess
import sys
import time

from dash import dcc
import numpy as np
from processes import environment, run_python
import pytest
from secure_uav_planner import Channel, Plan, Scenario, solve
from secure_uav_planner.apps.editing import list_handles, read_field, to_mission
from secure_uav_planner.apps.explore import _edit, Editor
from secure_uav_planner.apps.layout import FIELDS, list_rates
from secure_uav_planner.apps.mission_text import MissionText
from secure_uav_planner.mission.formats.mission_file import read_mission
from secure_uav_planner.output.drawing import map_extent
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.pointer_input import PointerInput
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.wait import WebDriverWait
from test_editing import CITY, PAPER
from test_page import browser_in, PATIENCE, screen_of, wait_for

# The command, whose solves are not cut short on a busy machine.
PATIENT = """
import sys
from secure_uav_planner.__main__ import main
from secure_uav_planner.apps import explore

explore._TIME_LIMIT = 600.0
sys.exit(main())
"""

# Whether the plan, the sliders and the graphs, each in its place, are drawn.
READY = """
const plots = ['map', 'charts'].map(name => document.getElementById(name)?.querySelector(
    '.main-svg'));
return document.getElementById('words')?.innerText.includes('worst-case')
    && document.getElementById('state').innerText.includes('planned')
    && document.querySelector('#fields [role=slider]')
    && plots.every(plot => plot?.querySelector('.scatterlayer .trace')
                   && plot.clientHeight === plot.closest('.dash-graph').clientHeight);"""


# Solves


def test_a_solve_tells_its_progress_and_ends_when_the_mission_changes(monkeypatch):
    monkeypatch.setattr('secure_uav_planner.apps.explore._TIME_LIMIT', 600.0)
    editor = Editor(MissionText(CITY))
    slow = editor.solve()
    while not editor.progress.startswith('planning: '):
        assert not slow.done()
        time.sleep(0.01)
    editor.edit(to_mission(PAPER))
    fast = editor.solve()
    assert fast is editor.solve() is not slow
    assert not wait([slow, fast], PATIENCE).not_done
    assert slow.exception() or slow.result().status == 'cancelled'
    assert fast.result().positions.tolist() == solve(PAPER).positions.tolist()


def test_a_solve_ends_after_a_few_seconds_with_what_it_has(tmp_path):
    replace(Scenario.load(CITY), duration=2000.0, slots=2000).save(tmp_path / 'large.yaml')
    plan = Editor(MissionText(tmp_path / 'large.yaml')).solve()
    assert not wait([plan], PATIENCE).not_done
    assert plan.exception() or plan.result().status == 'time_limit'


# The page


class Page:
    """The page of a mission as a user sees it."""

    def __init__(self, browser, url):
        self.browser = browser
        browser.get(url)
        wait_for(browser, lambda: browser.execute_script(READY))

    def text(self, name):
        return self.browser.find_element(By.ID, name).text

    @property
    def yaml(self):
        return self.browser.find_element(By.ID, 'yaml').get_property('value')

    @property
    def mission(self):
        return read_mission('mission.yaml', Scenario, self.yaml)

    def place_of(self, place):
        """Return the middle of the last shape that moves a place of the mission, in pixels."""
        number = max(number for number, handle in enumerate(list_handles(to_mission(self.mission)))
                     if handle.place == place)
        return self.middle_of(f'#map path[data-index="{number}"]')

    def middle_of(self, selector):
        """Return the middle of an element, in pixels."""
        return wait_for(self.browser, lambda: self.browser.execute_script("""
            const box = document.querySelector(arguments[0]).getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2].map(Math.round);""", selector))

    def drag(self, start, end):
        self._point(start, 'pointer_down', end, 'pointer_up')

    def remove(self, place, kind):
        """Click or tap twice on a place, again where the machine was too slow for that."""
        yaml = self.yaml
        for _ in range(4):
            self._point(place, *['pointer_down', 'pointer_up'] * 2, kind=kind)
            with suppress(TimeoutException):
                return WebDriverWait(self.browser, PATIENCE / 4).until(lambda _: self.yaml != yaml)
        raise AssertionError(f'nothing is removed by {kind}')

    def _point(self, *steps, kind='mouse'):
        actions = ActionChains(self.browser, devices=[PointerInput(kind, kind)])
        for step in steps:
            pointer = actions.w3c_actions.pointer_action
            getattr(pointer, step)() if isinstance(step, str) else pointer.move_to_location(*step)
        actions.perform()

    def click(self, text):
        self.browser.find_element(By.XPATH, f'//button[text()="{text}"]').click()

    def write(self, text):
        pane = self.browser.find_element(By.ID, 'yaml')
        pane.send_keys(Keys.CONTROL, 'a')
        pane.send_keys(text, Keys.TAB)

    def wait_for_change(self, yaml):
        """Wait until the mission is another one than a text, and its plan is shown."""
        self.wait_for_shapes(yaml)
        self.wait_for_plan()

    def wait_for_shapes(self, yaml):
        """Wait until the mission is another one than a text, and as many shapes are shown."""
        wait_for(self.browser, lambda: self.yaml != yaml)
        count = len(list_handles(to_mission(self.mission)))
        wait_for(self.browser, lambda: len(self.browser.find_elements(
            By.CSS_SELECTOR, '#map path[data-index]')) == count)

    def wait_for_plan(self):
        """Wait until the plan shown is solve of the mission shown."""
        plan = solve(self.mission)
        rates = [f'{rate:.3f}' for rate in (plan.worst_case_rate, plan.guaranteed_rate)]
        wait_for(self.browser, lambda: [
            rate.text for rate in self.browser.find_elements(By.CSS_SELECTOR, '#words b')
        ][:2] == rates and self.text('state').startswith('planned in '))
        wait_for(self.browser, lambda: np.allclose(self.path(0), plan.positions[0].T))
        return plan

    def path(self, number):
        """Return where a UAV flies on the map, (2, N+2) in m."""
        return self.browser.execute_script("""
            const trace = document.querySelector('#map .js-plotly-plot').data
                .filter(trace => trace.showlegend !== false)[arguments[0]];
            return [trace.x, trace.y];""", number)


@pytest.fixture(scope='module')
def url(tmp_path_factory):
    """Return the address of the page of the paper's mission, from the real command."""
    folder = tmp_path_factory.mktemp('explore')
    PAPER.save(folder / 'mission.yaml')
    with serve(folder) as address:
        yield address


@contextmanager
def serve(folder):
    """Give the address of the page of the mission in a folder."""
    process = subprocess.Popen(
        [sys.executable, '-c', PATIENT, 'explore', 'mission.yaml'], cwd=folder,
        stdout=subprocess.PIPE, text=True, env=environment(BROWSER='true'))
    try:
        yield re.search(r'http://127\.0\.0\.1:\d+/', process.stdout.readline())[0]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    folder = tmp_path_factory.mktemp('browser')
    with browser_in(folder) as driver:
        driver.folder = folder / 'downloads'
        driver.folder.mkdir()
        driver.execute_cdp_cmd('Browser.setDownloadBehavior', {
            'behavior': 'allow', 'downloadPath': str(driver.folder)})
        yield driver


@pytest.fixture
def page(browser, url):
    return Page(browser, url)


@pytest.mark.parametrize('place', [
    ('eavesdroppers', 0), ('uavs', 1, 'start'), ('ground_node',), ('no_fly_zones', 0, 'vertices')])
def test_a_drag_is_planned_as_solve_plans_it(page, place):
    page.wait_for_plan()
    before, (x, y) = page.yaml, page.place_of(place)
    page.drag((x, y), (x + 20, y - 14))
    page.wait_for_change(before)
    x_now, y_now = page.place_of(place)
    assert abs(x_now - x - 20) <= 1 and abs(y_now - y + 14) <= 1


def test_a_start_in_a_zone_is_told_and_the_last_plan_stays(page):
    page.wait_for_plan()
    words, yaml, path = page.text('words'), page.yaml, page.path(0)
    page.drag(page.place_of(('uavs', 1, 'start')), page.place_of(('no_fly_zones', 0, 'vertices')))
    wait_for(page.browser, lambda: 'uav2.start is' in page.text('problem'))
    assert 'inside tower' in page.text('problem') and page.yaml != yaml
    assert page.text('words') == words and page.path(0) == path
    rates = page.browser.find_element(By.ID, 'words')
    assert page.text('state') == 'cannot be flown' and rates.get_attribute('class') == 'old'
    assert float(rates.value_of_css_property('opacity')) < 0.5  # Of another mission: paler.
    page.click('undo')
    wait_for(page.browser, lambda: page.yaml == yaml and page.text('problem') == '')
    page.wait_for_plan()


def test_a_slider_changes_the_duration_and_slots_keep_their_length(page):
    before = page.yaml
    x, y = page.middle_of('#fields details [role=slider]')
    page.drag((x, y), (x + 15, y))
    page.wait_for_change(before)
    mission = page.mission
    assert mission.duration > 130.0
    assert mission.slots == round(mission.duration / 6.0)


def test_each_slider_and_its_box_set_the_field_of_their_label(browser, tmp_path):
    replace(PAPER, channel=Channel(rician_k_db=10.0, outage=0.1), uavs=tuple(
        replace(uav, max_acceleration=2.5) for uav in PAPER.uavs)).save(tmp_path / 'mission.yaml')
    with serve(tmp_path) as url:
        page = Page(browser, url)
        browser.execute_script(
            'document.querySelectorAll("#fields details").forEach(group => group.open = true)')
        sliders = [field for field in FIELDS.values() if field[2].func is dcc.Slider]
        for number, (owner, field, slider) in enumerate(sliders):
            _, high, step = slider.args
            for selector, size in (('[role=slider]', step), ('.dash-range-slider-input', 1.0)):
                after = min(read_field(to_mission(page.mission), owner, field) + size, high)
                browser.find_elements(By.CSS_SELECTOR, f'#fields {selector}')[number].send_keys(
                    *[Keys.ARROW_RIGHT] if 'slider]' in selector else (
                        Keys.CONTROL, 'a', Keys.NULL, f'{after:g}', Keys.TAB))
                # A browser under load may send a number before its last digit.
                wait_for(browser, lambda: read_field(
                    to_mission(page.mission), owner, field) == pytest.approx(after))


def test_steps_of_the_duration_keep_the_length_of_slots_as_one_step_does(tmp_path):
    PAPER.save(tmp_path / 'mission.yaml')
    editor = Editor(MissionText(tmp_path / 'mission.yaml'))
    for duration in (*range(121, 133), 2, 150):
        values = [duration] + [None] * (len(FIELDS) - 1)
        _edit(editor, [({'field': 'duration (s)'}, duration)], editor.text, values,
              editor.version, editor.version)
        assert editor.mission['slots'] == max(1, round(duration / 6.0))


def test_undo_redo_and_double_clicks_or_taps_change_back_what_buttons_add(page):
    before = page.yaml
    for kind, members in (('zone', 'no_fly_zones'), ('eavesdropper', 'eavesdroppers'),
                          ('jammer', 'uavs')):
        yaml, count = page.yaml, len(getattr(page.mission, members))
        page.click(f'+ {kind}')
        page.wait_for_shapes(yaml)
        assert len(getattr(page.mission, members)) == count + 1
    after = page.yaml
    page.click('undo')
    page.wait_for_shapes(after)
    yaml = page.yaml
    page.click('redo')
    page.wait_for_shapes(yaml)
    assert page.yaml == after
    for place, kind in ((('uavs', 2, 'goal'), 'mouse'), (('eavesdroppers', 1), 'touch'),
                        (('no_fly_zones', 1, 'vertices'), 'touch')):
        yaml = page.yaml
        page.remove(page.place_of(place), kind)
        page.wait_for_shapes(yaml)
    assert page.yaml == before
    page.wait_for_plan()


def test_a_click_and_a_drag_at_once_move_the_shape_that_is_under_the_pointer(page):
    before, (x, y) = page.yaml, page.place_of(('eavesdroppers', 0))
    actions = ActionChains(page.browser)
    pointer = actions.w3c_actions.pointer_action
    pointer.move_to_location(x, y)
    pointer.pointer_down()
    pointer.pointer_up()
    pointer.pointer_down()
    pointer.move_to_location(x + 9, y)
    pointer.move_to_location(x + 20, y)
    pointer.pointer_up()
    actions.perform()
    page.wait_for_change(before)
    (eve,), (was,) = page.mission.eavesdroppers, PAPER.eavesdroppers
    assert eve.position[0] > was.position[0] and eve.error_radius == was.error_radius


@pytest.mark.parametrize('trigger', ['map', 'removed'])
def test_numbers_of_shapes_that_are_no_longer_shown_change_nothing(tmp_path, trigger):
    eves = *PAPER.eavesdroppers, replace(PAPER.eavesdroppers[0], position=(-200.0, 0.0))
    replace(PAPER, eavesdroppers=eves).save(tmp_path / 'mission.yaml')
    editor = Editor(MissionText(tmp_path / 'mission.yaml'))
    fields, drawn, numbers = [None] * len(FIELDS), editor.version, [
        number for number, handle in enumerate(list_handles(editor.mission))
        if handle.place == ('eavesdroppers', 0)]
    assert _edit(editor, [('removed', numbers)], editor.text, fields, drawn, drawn)[0] == 1
    mission, version = editor.mission, editor.version
    value = numbers if trigger == 'removed' else {f'shapes[{numbers[1]}].xanchor': 90.0}
    after, *_ = _edit(editor, [(trigger, value)], editor.text, fields, version, drawn)
    assert after == version + 1 and editor.mission == mission
    _edit(editor, [(trigger, value)], editor.text, fields, version + 1, version)
    assert editor.mission != mission


def test_a_kept_plan_is_drawn_in_grey_and_the_difference_is_told(page):
    kept = page.wait_for_plan()
    before, (x, y) = page.yaml, page.place_of(('eavesdroppers', 0))
    page.drag((x, y), (x + 40, y))
    page.wait_for_change(before)
    difference = solve(page.mission).rate - kept.rate
    assert f'{difference:+.2f}' in page.text('words') and 'against' in page.text('words')
    assert list_rates(copy(kept), kept)[-1].children[0].children == '0.00'
    grey = page.browser.execute_script("""
        return document.querySelector('#map .js-plotly-plot').data
            .filter(trace => trace.line.color === '#BBBBBB').map(trace => [trace.x, trace.y]);""")
    np.testing.assert_allclose(np.moveaxis(grey, 1, 2), kept.positions)
    page.click('keep this plan')
    wait_for(page.browser, lambda: 'against' not in page.text('words'))


def test_the_text_is_the_mission_and_its_errors_are_told_by_line(page):
    before = page.yaml
    page.write(before.replace('duration: 120.0', 'duration: 130.0'))
    page.wait_for_change(before)
    wait_for(page.browser, lambda: page.yaml.count('130.0') == 1)
    assert page.mission.duration == 130.0
    page.write(page.yaml.replace('error_radius: 10.0', 'error_radius: wide'))
    line = 1 + page.yaml.split('error_radius')[0].count('\n')
    wait_for(page.browser, lambda: f'line {line}: ' in page.text('problem'))
    assert 'wide' in page.text('problem') and 'wide' in page.yaml
    page.write(f'{before}\nairspace: zones.geojson')  # A text names no files.
    wait_for(page.browser, lambda: "has no field 'airspace'" in page.text('problem'))


def test_a_text_that_is_not_left_yet_is_taken_with_the_next_drag(browser, url):
    def type_and_drag(text):
        """Write a text in place of 'duration: 1', then drag without leaving the pane."""
        browser.execute_script("""
            const pane = document.getElementById('yaml'), at = pane.value.indexOf('duration: 1');
            pane.focus();
            pane.setSelectionRange(at, at + 'duration: 1'.length);""")
        ActionChains(browser).send_keys(text).perform()
        yaml, (x, y) = page.yaml, page.middle_of(f'#map path[data-index="{number}"]')
        page.drag((x, y), (x + 20, y))
        assert browser.execute_script('return document.activeElement.id') == 'yaml'
        return yaml

    with screen_of(browser, 1400, 1500):  # Map and pane are seen at once.
        page = Page(browser, url)
        page.wait_for_plan()
        number = max(number for number, handle in enumerate(list_handles(to_mission(PAPER)))
                     if handle.place == ('eavesdroppers', 0))
        yaml = type_and_drag('duration: 11')  # 1120 s.
        wait_for(browser, lambda: page.mission.eavesdroppers != PAPER.eavesdroppers)
        assert page.mission.duration == 1120.0
        page.wait_for_shapes(yaml)
        before = page.yaml
        yaml = type_and_drag('duration: 1 1')  # No number.
        wait_for(browser, lambda: 'line ' in page.text('problem'))
        assert page.yaml == yaml
        page.click('undo')
        wait_for(browser, lambda: page.yaml == before and page.text('problem') == '')


def test_what_is_typed_comes_before_the_button_that_is_tapped_after_it(tmp_path):
    PAPER.save(tmp_path / 'mission.yaml')
    editor = Editor(MissionText(tmp_path / 'mission.yaml'))
    values = [read_field(editor.mission, *field[:2]) for field in FIELDS.values()]
    text = editor.text.replace('duration: 120.0', 'duration: 130.0')
    field = {'field': 'mean, transmitter (W)'}
    _edit(editor, [({'do': 'zone'}, None), (field, 2.0), ('yaml', None)], text, values, 0, 0)
    after = Scenario.from_dict(editor.mission)
    assert (after.duration, after.uavs[0].average_power) == (130.0, 2.0)
    assert len(after.no_fly_zones) == len(PAPER.no_fly_zones) + 1


def test_a_box_that_is_left_or_emptied_changes_nothing_and_shows_the_mission_again(
        browser, tmp_path):
    replace(PAPER, duration=120.4, tracking_margin=0.3, uavs=tuple(
        replace(uav, average_power=7.123, peak_power=33.3) for uav in PAPER.uavs)).save(
            tmp_path / 'mission.yaml')
    with serve(tmp_path) as url:
        page = Page(browser, url)
        browser.execute_script(
            'document.querySelectorAll("#fields details").forEach(group => group.open = true)')
        before = page.yaml
        boxes = browser.find_elements(By.CSS_SELECTOR, '#fields .dash-range-slider-input')
        for box in boxes[:7]:
            shown = box.get_property('value')
            for keys in ([Keys.TAB], [Keys.CONTROL, 'a', Keys.NULL, Keys.BACKSPACE, Keys.TAB]):
                box.click()
                box.send_keys(*keys)
                wait_for(browser, lambda: box.get_property('value') == shown)
        boxes[0].send_keys(Keys.CONTROL, 'a', Keys.NULL, '150', Keys.TAB)
        wait_for(browser, lambda: page.yaml != before)
        assert replace(page.mission, duration=120.4, slots=20) == Scenario.load(
            tmp_path / 'mission.yaml')


def test_mission_and_plan_can_be_downloaded(page):
    plan = page.wait_for_plan()
    for name in ('mission.yaml', 'plan.json'):
        page.click(f'download {name}')
        wait_for(page.browser, (page.browser.folder / name).exists)
    assert Scenario.load(page.browser.folder / 'mission.yaml') == PAPER
    saved = Plan.load(page.browser.folder / 'plan.json')
    assert saved.positions.tolist() == plan.positions.tolist()


def test_downloads_are_of_the_mission_that_the_text_has_at_the_click(page):
    page.wait_for_plan()
    pane, text = page.browser.find_element(By.ID, 'yaml'), page.yaml
    for name, duration in (('mission.yaml', 110.0), ('plan.json', 115.0)):
        file = page.browser.folder / name
        file.unlink(missing_ok=True)
        pane.send_keys(Keys.CONTROL, 'a')
        pane.send_keys(text.replace('duration: 120.0', f'duration: {duration}'))
        page.browser.execute_script('[...document.querySelectorAll("#file button")].find('
                                    'button => button.innerText.includes(arguments[0])).click()',
                                    name)  # Without leaving the pane, as fast as a tap.
        wait_for(page.browser, file.exists)
        saved = Scenario.load(file) if name == 'mission.yaml' else Plan.load(file).scenario
        assert saved.duration == duration


def test_the_page_fits_a_phone_asks_its_own_server_only_and_logs_no_errors(browser, url):
    with screen_of(browser, 360, 900):
        browser.get('about:blank')  # Which ends what the page before was asking for.
        browser.get_log('browser')
        page = Page(browser, url)
        assert browser.execute_script('return document.documentElement.scrollWidth') <= 360
        boxes = [browser.find_element(By.CSS_SELECTOR, f'#{name} .main-svg').rect
                 for name in ('map', 'charts')]
        assert all(box['width'] > 300 and box['height'] > 300 for box in boxes)
        page.wait_for_plan()
        asked = browser.execute_script(
            'return performance.getEntriesByType("resource").map(entry => entry.name)')
        assert [name for name in asked if not name.startswith((url, 'data:', 'blob:'))] == []
        assert [log for log in browser.get_log('browser') if log['level'] == 'SEVERE'] == []


def test_at_1280_by_800_map_rates_and_first_sliders_are_seen_and_no_legend_is_on_the_map(
        browser, url):
    with screen_of(browser, 1280, 800):
        page = Page(browser, url)
        page.wait_for_plan()
        boxes = {name: browser.execute_script("""
            const box = document.querySelector(arguments[0]).getBoundingClientRect();
            return [box.left, box.top, box.right, box.bottom];""", name) for name in (
                '#words b', '#map', '#charts', '#fields details [role=slider]', '#legend')}
        assert all(0 <= left < right <= 1280 and 0 <= top < bottom <= 800
                   for left, top, right, bottom in boxes.values())
        assert boxes['#legend'][3] <= boxes['#map'][1]
        x, y = browser.execute_script("""
            const {xaxis, yaxis, _size} = document.querySelector(
                '#map .js-plotly-plot')._fullLayout;
            return [[...xaxis.range, xaxis._length / _size.w],
                    [...yaxis.range, yaxis._length / _size.h]];""")
        assert x[2] == y[2] == 1.0  # The map fills its panel.
        for (low, high, _), places in zip((x, y), zip(*map_extent(PAPER))):
            room = np.ptp(map_extent(PAPER), axis=0).max() / 3
            assert low <= places[0] - 0.99 * room and high >= places[1] + 0.99 * room


def test_a_page_whose_server_has_ended_says_so(browser, tmp_path):
    PAPER.save(tmp_path / 'mission.yaml')
    with serve(tmp_path) as url:
        page = Page(browser, url)
        page.wait_for_plan()
    page.click('undo')
    wait_for(browser, lambda: page.text('state') == (
        'the server of this page has ended: start it again'))


def test_a_page_that_outlives_its_server_is_told_to_reload(page):
    page.wait_for_plan()
    page.browser.get_log('browser')
    page.browser.execute_script("dash_clientside.set_props('page', {data: 'of another run'})")
    page.click('undo')
    wait_for(page.browser, lambda: page.text('state') == (
        'this page is older than its server: reload'))
    assert [log for log in page.browser.get_log('browser') if log['level'] == 'SEVERE'] == []


# Who is answered


def ask(url, method='GET', path='/', body=None, **headers):
    connection = HTTPConnection(url.split('/')[2], timeout=PATIENCE)
    connection.request(method, path, body, headers)
    return connection.getresponse()


def test_other_computers_hosts_and_origins_are_refused(url):
    own, host = url.rstrip('/'), url.split('/')[2]
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(('127.0.0.2', int(host.split(':')[1])), PATIENCE)
    assert ask(url).status == 200 and ask(url, Origin=own).status == 200
    assert ask(url, Host='attacker.example').status == 403  # DNS rebinding.
    assert ask(url, Host=f'attacker.example:{host.split(":")[1]}').status == 403
    for origin in ('http://attacker.example', 'null', f'https://{host}', f'{own}.example'):
        answer = ask(url, 'POST', '/_dash-update-component', json.dumps({}), Origin=origin,
                     **{'Content-Type': 'text/plain'})
        assert answer.status == 403 and answer.getheader('Access-Control-Allow-Origin') is None


def test_a_port_that_is_taken_is_told():
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        done = run_python('-m', 'secure_uav_planner', 'explore', '--port', port, status=2,
                          env=environment(BROWSER='true'))
    assert f'--port is {port}; ' in done.stderr
    assert len(done.stderr.splitlines()) == 1
