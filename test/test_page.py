"""The page of a plan, in a real browser."""

from contextlib import contextmanager
from dataclasses import replace
from itertools import combinations
from pathlib import Path
import re
import shutil
import time
from urllib.parse import urlsplit
from urllib.request import url2pathname

import numpy as np
from processes import ROOT
import pytest
from secure_uav_planner import (
    Bound, Channel, Eavesdropper, fly_hover_fly, GroundNode, Scenario, Uav)
from secure_uav_planner.output.page import draw_page, save_page
from secure_uav_planner.output.traces import PlanTraces
from selenium import webdriver
from selenium.common.exceptions import JavascriptException, StaleElementReferenceException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

CHROMIUM = next(filter(None, map(shutil.which, (
    'chromium', 'chromium-browser', 'google-chrome'))), None)
DRIVER = shutil.which('chromedriver')
PATIENCE = 120.0  # s

# Where the markers of the UAVs are drawn, in pixels of the window.
DRAWN = """
return [...document.querySelectorAll('.xy .scatterlayer .trace .points path')]
    .filter(path => arguments[0].includes(getComputedStyle(path).fill))
    .map(path => { const box = path.getBoundingClientRect();
                   return [box.x + box.width / 2, box.y + box.height / 2]; });
"""
BLUE, ORANGE, CROSS = 'rgb(0, 114, 178)', 'rgb(230, 159, 0)', 'rgb(213, 94, 0)'


SIZES = (360, 740), (1024, 768), (1920, 1080)
# In free space, for which bounds are proven.
CITY = replace(Scenario.load(ROOT / 'config' / 'city.yaml'),
               channel=Channel())

# The boxes of texts that a reader needs, by their classes.
TEXTS = """
return [...document.querySelectorAll('h1, .slider-label, .updatemenu-button, .xtitle,'
                                     + ' .ytitle, .y2title, .y3title, .y4title, .legendtext,'
                                     + ' .slider-grip-rect')]
    .map(one => { const box = one.getBoundingClientRect();
                  return [one.textContent, box.left, box.right, box.top, box.bottom]; })
    .filter(([text, left, right]) => right > left);
"""


@pytest.fixture(scope='module')
def plan():
    return fly_hover_fly(Scenario.paper(200, slots=40), 'optimised')


@contextmanager
def browser_in(folder):
    """Give a browser that keeps what it needs in a folder, or skip the test without one."""
    if CHROMIUM is None or DRIVER is None:
        pytest.skip('needs chromium and chromedriver: apt install chromium chromium-driver')
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in ('headless', 'no-sandbox', 'disable-gpu', 'disable-dev-shm-usage',
                 'disable-background-networking', 'disable-component-update', 'disable-sync',
                 'no-first-run', 'window-size=1400,900', f'user-data-dir={folder / "profile"}'):
        options.add_argument(f'--{flag}')
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


@pytest.fixture(scope='module')
def browser(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp('page')
    with browser_in(folder) as driver:
        save_page(plan, folder / 'plan.html')
        city = fly_hover_fly(CITY, 'constant')
        city = city.with_bound(Bound(CITY, 2.0 * city.worst_case_rate, ignored=('separation',)))
        save_page(city, folder / 'city.html')
        open_page(driver, folder / 'plan.html')
        yield driver


@pytest.fixture(params=[(page, size) for page in ('plan', 'city') for size in SIZES])
def screen(browser, request):
    """Give a page on a screen, the least of them a phone's, and after that the one as it was."""
    before = Path(url2pathname(urlsplit(browser.current_url).path))
    page, size = request.param
    with screen_of(browser, *size):
        open_page(browser, before.with_name(f'{page}.html'))
        yield browser
    open_page(browser, before)


@contextmanager
def screen_of(browser, width, height):
    """Give the browser a screen of a size in pixels for a while; a narrow one is a phone's."""
    browser.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', {
        'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': width < 500})
    try:
        yield
    finally:
        browser.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})


def open_page(browser, file):
    """Open a page, and wait until it is drawn."""
    browser.get(file.as_uri())
    wait_for(browser, lambda: browser.find_elements(By.CSS_SELECTOR, '.slider-grip-rect'))
    wait_for(browser, lambda: browser.execute_script("""
        const layout = document.getElementById('plan')._fullLayout;
        const legend = document.querySelector('.legend').getBoundingClientRect();
        return Math.abs(layout.margin.b - 60 - legend.height) < 1;"""))


def drawn(browser, *colors):
    return browser.execute_script(DRAWN, colors)


def slide(browser, share):
    """Drag the slider's grip to a share of its rail."""
    rail = browser.find_element(By.CSS_SELECTOR, '.slider-rail-rect').rect
    grip = browser.find_element(By.CSS_SELECTOR, '.slider-grip-rect').rect
    x, y = (int(grip[side] + grip[size] / 2) for side, size in (('x', 'width'), ('y', 'height')))
    target = int(rail['x'] + share * rail['width'])
    actions = ActionChains(browser)
    actions.w3c_actions.pointer_action.move_to_location(x, y)
    actions.w3c_actions.pointer_action.pointer_down()
    actions.w3c_actions.pointer_action.move_to_location(target, y)
    actions.w3c_actions.pointer_action.pointer_up()
    actions.perform()


def readout(browser):
    return browser.find_element(By.CSS_SELECTOR, '.slider-label').text


def wait_for(browser, condition):
    """Return what a condition gives once that is true, however often the page is drawn again."""
    redrawn = [StaleElementReferenceException, JavascriptException]
    return WebDriverWait(browser, PATIENCE, ignored_exceptions=redrawn).until(
        lambda _: condition())


def wait_for_rest(browser, value):
    """Return a value of the page once it has been the same for a second."""
    def rests():
        before = value()
        time.sleep(1.0)
        return before == value() and before
    return wait_for(browser, rests)


def test_the_page_is_one_file_that_asks_for_nothing_and_logs_no_errors(browser):
    asked = browser.execute_script(
        'return performance.getEntriesByType("resource").map(entry => entry.name)')
    assert [name for name in asked if not name.startswith('data:')] == []
    assert [entry for entry in browser.get_log('browser') if entry['level'] == 'SEVERE'] == []


@pytest.mark.parametrize('color', [BLUE, ORANGE])
def test_the_slider_moves_the_uavs_and_the_readout(browser, color):
    def place_at(share):
        """Return where the UAV is drawn, in pixels, once it is, and the time that is told."""
        before = drawn(browser, color)
        slide(browser, share)
        wait_for(browser, lambda: drawn(browser, color) != before)
        (place,) = wait_for_rest(browser, lambda: drawn(browser, color))
        return place, float(readout(browser).split(' s:')[0])

    place_at(0.7)
    (x, y), start = place_at(0.0)
    _, middle = place_at(0.5)
    (end_x, end_y), end = place_at(1.0)
    assert start == 0.0 and 80 < middle < 125 and end == 205.0
    # The goal is 1000 m south of the start: straight down.
    assert end_y > y + 200 and end_x == pytest.approx(x, abs=2)


def test_play_flies_and_pause_holds(browser):
    slide(browser, 0.0)
    wait_for(browser, lambda: readout(browser).startswith('0.0 s'))
    play, pause = browser.find_elements(By.CSS_SELECTOR, '.updatemenu-button')
    play.click()
    wait_for(browser, lambda: float(readout(browser).split(' s:')[0]) > 10)
    pause.click()
    held = wait_for_rest(browser, lambda: readout(browser))
    assert 10 < float(held.split(' s:')[0]) < 205  # which is the end


def test_the_readout_adds_up_to_what_the_plan_delivers(browser, plan):
    slide(browser, 1.0)
    wait_for(browser, lambda: readout(browser).startswith('205.0 s'))
    delivered = float(re.search(r'([\d.]+)\s*bit/Hz', readout(browser))[1])
    assert delivered == pytest.approx(plan.guaranteed_rate * plan.scenario.duration, abs=0.06)


def test_the_worst_place_of_the_eavesdropper_is_shown_in_its_disc(browser):
    slide(browser, 0.5)
    places = drawn(browser, CROSS)
    assert len(places) == 1
    disc = browser.execute_script("""
        return [...document.querySelectorAll('.xy .scatterlayer .trace path.js-fill')]
            .map(path => { const box = path.getBoundingClientRect();
                           return [box.left, box.right, box.top, box.bottom]; });""")[0]
    assert disc[0] - 2 <= places[0][0] <= disc[1] + 2
    assert disc[2] - 2 <= places[0][1] <= disc[3] + 2


def test_any_screen_is_filled_and_scrolled_and_no_text_is_cut_or_covers_another(screen):
    width, scrolled, left, map_width, chart_left, chart_width = screen.execute_script("""
        const {xaxis, xaxis2} = document.getElementById('plan')._fullLayout;
        return [visualViewport.width, document.documentElement.scrollWidth, xaxis._offset,
                xaxis._length, xaxis2._offset, xaxis2._length];""")
    assert scrolled == width and chart_left + chart_width == pytest.approx(width - 20, abs=2)
    if width < 500:
        assert chart_left < 100 and map_width > 0.5 * width
    else:
        assert 60 < chart_left - left - map_width < 0.15 * width
    texts = screen.execute_script(TEXTS)
    assert left >= 60 and all(-1 <= box[0] and box[1] <= width + 1 for _, *box in texts)
    assert len(texts) > 10 and {'start', 'goal'} <= {text for text, *_ in texts}
    for (text, *first), (neighbour, *second) in combinations(texts, 2):
        over = [min(first[end], second[end]) - max(first[end - 1], second[end - 1])
                for end in (1, 3)]
        assert min(over) < 3.0, (text, neighbour)
    assert screen.execute_script('return getComputedStyle(document.querySelector('
                                 '"#plan .nsewdrag")).touchAction') != 'none'


def test_a_phone_shows_the_map_of_many_uavs_and_scrolls_no_further_than_the_plot(
        browser, tmp_path):
    before, file = browser.current_url, tmp_path / 'plan.html'
    crowd = replace(Scenario.paper(120.0, slots=10), ground_node=None, ground_nodes=tuple(
        GroundNode((0.0, 60.0 * number)) for number in range(6)), uavs=tuple(
            Uav(f'uav{number}', (40.0 * number, 400.0), (40.0 * number, -400.0),
                100.0 + 5 * number, 12.0) for number in range(8)))
    save_page(fly_hover_fly(crowd), file)
    browser.get_log('browser')
    with screen_of(browser, 360, 740):
        open_page(browser, file)
        height, scrolled, map_height = browser.execute_script("""
            const layout = document.getElementById('plan')._fullLayout;
            return [layout.height, document.documentElement.scrollHeight, layout.yaxis._length];
        """)
        assert map_height > 200 and height < scrolled < height + 100
    browser.get(before)
    assert [log for log in browser.get_log('browser') if log['level'] == 'SEVERE'] == []


def test_baselines_names_and_times_of_receivers_that_move_are_shown(tmp_path):
    moving = replace(Scenario.paper(120.0, slots=12), eavesdroppers=tuple(
        Eavesdropper(name=name, track=((0.0, 200.0, -300.0, 15.0), (120.0, 200.0, y, 15.0)))
        for name, y in (('car', 300.0), ('van', 200.0))))
    plan, baseline = fly_hover_fly(moving, 'optimised'), fly_hover_fly(moving)
    traces = draw_page(plan, [baseline]).data
    shown = {trace.name for trace in traces if trace.showlegend is not False}
    assert {'track of car', 'track of van', 'UAV, larger with more power',
            'fly-hover-fly, constant power'} <= shown
    texts = [text.strip() for trace in traces if 'text' in trace.mode for text in trace.text]
    assert {'car', 'van'} <= {*texts} and texts.count('60 s') == texts.count('130 s') == 2
    paths = [np.stack([trace.x, trace.y], axis=1) for trace in traces
             if trace.legendgroup == baseline.method and trace.xaxis == 'x']
    assert np.array_equal(paths, baseline.positions)


def test_the_chart_of_powers_draws_each_slot_with_power_over_its_whole_length(plan):
    powers = plan.powers.copy()
    powers[0, [3, 5, -2]] = 0.0  # A slot alone, and the last one alone.
    page = draw_page(replace(plan, powers=powers))
    for watts, trace in zip(powers, (trace for trace in page.data if trace.yaxis == 'y2')):
        x, y = np.array([trace.x, trace.y], dtype=float)
        drawn = [(*x[at:at + 2], y[at]) for at in range(0, len(x), 2) if y[at] == y[at + 1]]
        assert trace.line.shape is None and drawn == [
            (plan.times[slot + 1], plan.times[slot + 2], power)
            for slot, power in enumerate(watts) if power > 0]


def test_small_powers_and_the_times_of_a_short_flight_are_told_apart():
    track = (0.0, 2.0, -3.0, 0.1), (2.0, 2.0, 3.0, 0.1)
    uav = Uav('hopper', (-2.0, -2.0), (2.0, 2.0), 3.0, 5.0)
    plan = fly_hover_fly(Scenario((0.0, 0.0), (Eavesdropper(track=track),), (uav,), 2.0, 20))
    content = PlanTraces(replace(plan, powers=np.full_like(plan.powers, 3e-5)))
    assert 'hopper 0.03 mW' in content.readout(2)
    *_, marks = content.track_traces()
    assert len({*marks.text}) == len(marks.text)


def test_the_axis_of_powers_ends_just_below_the_least_and_a_baseline_has_one_line_style(plan):
    baseline = fly_hover_fly(plan.scenario)
    page = draw_page(plan, [plan, baseline])
    low, _ = page.layout.yaxis2.range
    least = plan.powers[plan.powers > 1e-4].min()
    assert 0.5 * least < 10**low < least
    dashes = {(trace.legendgroup, trace.line.dash) for trace in page.data
              if trace.line.color == '#808080'}
    assert dashes == {(plan.method, 'dot'), (baseline.method, 'dash')}
