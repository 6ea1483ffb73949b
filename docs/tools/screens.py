"""
The pictures of docs/explore.md, taken of the page in a browser.

`python -m docs.tools.screens` needs chromium and chromedriver. A picture carries, as its
description, what was done on the page and the rates that it shows.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import time

from secure_uav_planner.mission.formats.mission_file import EXAMPLE
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.wait import WebDriverWait

from .png import save_png

DOCS = Path(__file__).resolve().parents[1]
CITY = DOCS.parent / 'config' / 'city.yaml'

_PATIENCE = 120.0  # s
_SIZE, _PHONE = (1280, 800), (360, 740)
_MOVE = "Plotly.relayout(document.querySelector('#map .js-plotly-plot'), {});"
_ADD_ZONE = "[...document.querySelectorAll('button')].find(b => b.innerText === '+ zone').click()"
_ZONE = _MOVE.replace('{}', "{'shapes[0].path': 'M-60,120L10,120L10,200L-60,200Z'}")
# The shapes of the example: disc and middle of the eavesdropper, ground node, goal and start of
# the sender, goal and start of the jammer; those of zones are before these.
SCREENS = (
    ('explore-1', EXAMPLE, _SIZE, ()),
    ('explore-2', EXAMPLE, _SIZE, (
        _MOVE.replace('{}', "{'shapes[1].xanchor': 110, 'shapes[1].yanchor': -60}"),)),
    ('explore-3', EXAMPLE, _SIZE, (_ADD_ZONE, _ZONE)),
    ('explore-4', EXAMPLE, _SIZE, (
        _ADD_ZONE, _MOVE.replace('{}', "{'shapes[0].path': 'M50,260L130,260L130,340L50,340Z'}"))),
    ('explore-5', CITY, _SIZE, ()),
    ('explore-6', EXAMPLE, _PHONE, ()))
"""Name, mission, size in pixels and what is done on the page, of each picture."""


def main() -> int:
    """Take all pictures; return the exit status."""
    for name, mission, (width, height), steps in SCREENS:
        with _serve(mission) as url, _browse(width, height) as browser:
            browser.get(url)
            _wait_for_rest(browser)
            for step in steps:
                browser.execute_script(step)
                _wait_for_rest(browser)
            browser.save_screenshot(str(DOCS / f'{name}.png'))
            words = browser.find_element('id', 'words').text
        save_png(DOCS / f'{name}.png', DOCS / f'{name}.png', f'{mission.name} {steps} {words}')
    return 0


@contextmanager
def _serve(mission: Path) -> Iterator[str]:
    """Give the address of the page of a mission."""
    process = subprocess.Popen(
        [sys.executable, '-m', 'secure_uav_planner', 'explore', str(mission)],
        stdout=subprocess.PIPE, text=True, cwd=DOCS.parent,
        env={**os.environ, 'BROWSER': 'true'})
    try:
        yield re.search(r'http://\S+', process.stdout.readline())[0]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(_PATIENCE)


@contextmanager
def _browse(width: int, height: int) -> Iterator[webdriver.Chrome]:
    """Give a browser whose window has a size in pixels."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which('chromium')
    for flag in ('headless', 'no-sandbox', 'disable-gpu', 'hide-scrollbars'):
        options.add_argument(f'--{flag}')
    browser = webdriver.Chrome(options=options, service=Service(shutil.which('chromedriver')))
    try:
        browser.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', {
            'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': width < 500})
        yield browser
    finally:
        browser.quit()


def _wait_for_rest(browser: webdriver.Chrome) -> None:
    """Wait until the plan is shown, or why there is none, and the page no longer changes."""
    before = ''

    def rests(_: webdriver.Chrome) -> bool:
        nonlocal before
        time.sleep(1.0)
        text, before = before, browser.execute_script('return document.body.innerText')
        return text == before and re.search('planned in|cannot be flown', text) is not None

    WebDriverWait(browser, _PATIENCE).until(rests)


if __name__ == '__main__':
    sys.exit(main())
