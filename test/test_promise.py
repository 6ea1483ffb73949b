"""No view calls a rate guaranteed that is not: one at the mean gains of lines of sight."""

import csv
from dataclasses import replace
from importlib.util import find_spec
import json
import re

import pytest
from secure_uav_planner import assess, Channel, fly_hover_fly, Scenario, solve
from secure_uav_planner.apps.cli import main
from secure_uav_planner.apps.summary import draw_figure
from secure_uav_planner.output.figures import draw_assessment
from secure_uav_planner.output.page import draw_page
from secure_uav_planner.output.picture import draw_plan
from secure_uav_planner.output.tables import assessment_table, rate_table
from test_plan import gap_plan

CHANNELS = {
    'guaranteed': Channel(), 'at mean gains': Channel(los='urban'),
    'at mean gains of the links that help': Channel(los='suburban', cautious=True)}


@pytest.fixture(params=CHANNELS)
def case(request):
    """Return a promise, and a plan in a channel that has it."""
    scenario = replace(Scenario.paper(120.0, slots=12), channel=CHANNELS[request.param])
    return request.param, fly_hover_fly(scenario, 'optimised')


def has_words(promise, text):
    """Return whether a text has the words of a promise and of no other."""
    text = ' '.join(text.replace('<br>', ' ').split())
    return promise in text and ('mean gains of' in text) == ('gains of' in promise) and (
        'guaranteed' in text.replace('not guaranteed', '')) == (promise == 'guaranteed')


def test_the_page_marks_the_slots_in_a_gap_between_promises():
    _, plan = gap_plan()
    page = draw_page(plan)
    assert '8 of 10 slots promised' in page.layout.title.text
    assert {(shape.x0, shape.x1) for shape in page.layout.shapes if shape.type == 'rect'} == {
        (30.0, 50.0)}


def test_what_is_not_promised_is_assessed_and_told_as_such():
    plan = replace(solve(Scenario.paper(120.0, slots=12)), bits=1.0)
    partial = replace(plan, promised_until=60.0)
    assert plan.message.endswith('for 1 bit/Hz') and '; 6 of 12 slots' in partial.message
    found = assess(partial, 5)
    assert found.promised_rate == partial.promise.rate != plan.rate
    assert found.promised_delivery == pytest.approx(
        plan.worst_case_rates[:6].sum() * plan.scenario.slot_duration)
    texts = [assessment_table(found), repr(found), *(text for _, text in texts_of(partial))]
    assert [bool(re.search('6 of 12 slots', text)) for text in texts].count(False) == 2  # Legends.
    never = replace(plan, promised_until=0.0)
    for text in (repr(assess(never, 5)), *(text for _, text in texts_of(never))):
        assert 'nan' not in text


def test_a_channel_promises_with_an_outage_as_in_free_space():
    for los in (None, 'urban'):
        assert Channel(los=los, rician_k_db=5.0, outage=0.1).promise == 'guaranteed'
    assert Channel(los='urban', outage=0.1).promise == 'guaranteed'
    for promise, channel in CHANNELS.items():
        assert channel.promise == promise
        assert channel.is_guarantee == (promise == 'guaranteed')
        for objective in ('guaranteed', 'worst_case'):
            name = channel.rate_name(objective)
            assert name == 'worst-case rate' or has_words(promise, name), name


def texts_of(plan):
    """Yield what each view of a plan says of its rates, by the name of the view."""
    yield 'table', rate_table([plan])
    yield 'repr', repr(plan)
    figure = draw_plan(plan)
    yield 'title', ' '.join(text.get_text() for text in figure.texts)
    rate_axes = figure.axes[-1]
    yield 'legend', ' '.join(text.get_text() for text in rate_axes.get_legend().get_texts())
    page = draw_page(plan)
    yield 'title of the page', page.layout.title.text
    yield 'legend of the page', ' '.join(
        trace.name for trace in page.data if trace.showlegend is not False)
    if find_spec('rclpy') is not None:
        from secure_uav_planner.ros.planner.status import plan_summary
        yield 'status', plan_summary(plan, None)


def test_each_view_has_the_words_of_the_promise(case):
    promise, plan = case
    for view, text in texts_of(plan):
        assert has_words(promise, text), (view, text)
    assert 'guaranteed' not in draw_page(plan).layout.sliders[0].steps[3].label


def test_an_assessment_says_no_promise_where_there_is_none(case):
    promise, plan = case
    assessment = assess(plan, 20)
    for text in (assessment_table(assessment), repr(assessment)):
        assert ('no promise' in text) == (promise != 'guaranteed')
        assert promise == 'guaranteed' or promise in text
    outage, = (line for line in assessment_table(assessment).splitlines()
               if line.startswith('outage'))
    assert outage.split()[1:3] == (
        ['0.0000%', '0.0000%'] if promise == 'guaranteed' else ['no', 'promise'])
    labels = {' '.join(text.get_text().split()) for axes in draw_assessment(assessment).axes
              for text in axes.get_legend().get_texts()}
    assert ('promised' in labels) == (promise == 'guaranteed') != (promise in labels)


def test_plan_and_check_say_how_often_a_slot_has_less(case, tmp_path, command, monkeypatch):
    promise, plan = case
    monkeypatch.chdir(tmp_path)
    plan.scenario.save('mission.yaml')
    for words, shown in (
            (['check', 'mission.yaml'], fly_hover_fly(plan.scenario)),
            (['plan', 'mission.yaml', '--bound-time-limit', '0', '--method', 'joint'], None)):
        out, _ = command(*words)
        assert ('a slot has less in' in out) == (promise != 'guaranteed')
        assert shown is None or promise == 'guaranteed' or assess(shown, 200).shortfall in out


def test_a_campaign_keeps_channels_of_different_promise_apart(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'a.json').write_text(json.dumps({
        'mission': Scenario.paper(120.0, slots=6).to_dict(),
        'methods': ['fly_hover_fly_constant'], 'objectives': ['guaranteed'],
        'vary': {'duration': [110.0, 120.0], 'channel.los': [None, 'urban', 'suburban']}}))
    assert main(['sweep', 'a.json', '--out', 'out', '--jobs', '1']) == 0
    with open('out/results.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert {(row['channel.los'], row['promise']) for row in rows} == {
        ('', 'guaranteed'), ('"urban"', 'at mean gains'),
        ('"suburban"', 'at mean gains')}
    with open('out/results.jsonl') as file:
        known = [json.loads(line) for line in file]
    for row in known:  # Bands over the channel: it is no field that colours tell apart.
        row['fields'].pop('channel.los')
    figure = draw_figure(known)
    [axes], [legend] = figure.axes, figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert len(labels) == 2 and sum('guaranteed' in label for label in labels) == 1
    assert axes.get_ylabel().replace('\n', ' ') == (
        'guaranteed rate or lower bound at mean gains (bit/s/Hz)')
