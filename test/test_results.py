"""Results of campaigns: the figure by the fields that vary, and tables of values of any kind."""

import csv
from itertools import product

import pytest
from secure_uav_planner.apps.results import save_tables
from secure_uav_planner.apps.summary import draw_figure, name_field


def rows_of_campaign(**fields):
    """Return rows whose rate is duration times the number of the second field's value."""
    second = next(iter(fields))
    return [{'outcome': 'ok', 'sample': draw, 'method': 'joint', 'objective': 'guaranteed',
             'guaranteed_rate': duration * (1 + fields[second].index(values[0])) + draw,
             'worst_case_rate': 0.0,
             'fields': {'duration': duration, 'place': [draw, 0.0], **dict(zip(fields, values))}}
            for duration in (10.0, 20.0) for draw in range(11)
            for values in product(*fields.values())]


@pytest.mark.parametrize('values, shown', [
    ([5.0, 10.0, 30.0], ['5', '10', '30']), ([[0, 0], [1, 1]], ['[0, 0]', '[1, 1]']),
    ([48.1234567, 48.1234568], ['48.1234567', '48.1234568']), (['$a', 'b'], [r'\$a', 'b'])])
def test_the_figure_has_a_line_for_each_value_of_a_second_field_and_says_what_lines_are(
        values, shown):
    figure = draw_figure(rows_of_campaign(second=values))
    [legend], [axes] = figure.legends, figure.axes
    assert legend.get_title().get_text().split() == (
        'medians, thin: 10% and 90%, of n = 11 missions at each point, over place second:').split()
    figure.draw_without_rendering()
    assert not legend.get_window_extent().overlaps(axes.bbox)
    assert axes.get_xlabel() == 'duration (s)'
    assert [text.get_text() for text in legend.get_texts()] == shown
    lines = [line.get_xydata().tolist() for line in axes.lines if len(line.get_xdata()) == 2]
    assert lines == [
        [[x, x * number + by] for x in (10, 20)]
        for number in range(1, 1 + len(values)) for by in (5, 1, 9)]


def test_what_could_not_be_flown_is_counted_and_no_curve_begins_later():
    rows = rows_of_campaign(second=[1.0, 2.0])
    for row in rows:
        is_short = row['fields']['duration'] == 10.0
        if is_short and (row['fields']['second'] == 2.0 or row['sample'] < 4):
            row |= {'outcome': 'infeasible', 'guaranteed_rate': None, 'promise': None}
    figure = draw_figure(rows)
    [axes] = figure.axes
    assert '15 of 22 could not be flown at 10 s' in figure.legends[0].get_title().get_text()
    points = {(line.get_xdata()[0], line.get_color()): (
        line.get_marker(), line.get_markerfacecolor()) for line in axes.lines
        if len(line.get_xdata()) == 1}
    first, second = axes.lines[0].get_color(), axes.lines[5].get_color()
    assert points == {(10.0, first): ('o', 'white'), (20.0, first): ('o', first),
                      (10.0, second): ('x', 'white'), (20.0, second): ('o', second)}
    assert [text.get_text() for text in axes.texts] == ['n = 7']


def test_a_line_has_one_promise_also_where_nothing_could_be_flown_and_no_label_is_cut_off():
    promises = {'none': 'guaranteed', 'urban': 'at mean gains'}
    rows = [{**row, 'promise': promises[row['fields']['los']]}
            for row in rows_of_campaign(los=['none', 'urban'], third=[1, 2])]
    rows += [{**row, 'outcome': 'infeasible', 'promise': None,
              'fields': {**row['fields'], 'duration': 5.0}} for row in rows]
    figure = draw_figure(rows)
    figure.draw_without_rendering()
    [legend] = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        'none, joint, guaranteed', 'urban, joint, at mean gains']
    assert legend.get_window_extent().x1 < figure.bbox.x1
    assert len({axes.get_ylabel() for axes in figure.axes} - {''}) == 1


def test_fly_hover_fly_has_the_line_that_it_has_in_all_views():
    rows = rows_of_campaign(second=[1.0])
    for row in rows:
        del row['fields']['second']
    rows += [{**row, 'method': f'fly_hover_fly_{power}'} for row in rows
             for power in ('constant', 'optimised')]
    [axes] = draw_figure(rows).axes
    lines = {line.get_label(): line.get_linestyle() for line in axes.lines}
    assert (lines['joint'], lines['fly-hover-fly, constant power'],
            lines['fly-hover-fly, optimised power']) == ('-', '--', ':')


def test_methods_of_solve_and_promises_have_dashes_of_their_own_and_names_in_words():
    rows = [{**row, 'method': method, 'promise': promise,
             'fields': {'colluding': row['fields']['colluding'], **row['fields']}}
            for row in rows_of_campaign(colluding=[False, True])
            for method in ('joint', 'alternating', 'fly_hover_fly_constant')
            for promise in ('guaranteed', 'at mean gains')]
    [axes] = draw_figure(rows).axes
    assert axes.get_xlabel() == 'duration (s)'  # Truth values are no axis.
    dashes = {line.get_label(): line._unscaled_dash_pattern for line in axes.lines
              if not line.get_label().startswith('_')}
    assert {'true, joint, at mean gains', 'true, fly-hover-fly, constant power, guaranteed',
            'false, alternating, at mean gains'} <= dashes.keys()
    assert len({str(dash) for dash in dashes.values()}) > 3


def test_a_third_and_a_fourth_field_are_small_multiples():
    figure = draw_figure(rows_of_campaign(
        second=[1, 2], third=['a', 'b', 'c'], fourth=[0, 7], fifth=[1, 2]))
    assert [axes.get_title(loc='left') for axes in figure.axes] == [
        f'third: {letter}\nfourth: {number}' for number in (0, 7) for letter in 'abc']
    assert all(len({line.get_color() for line in axes.lines}) == 2 for axes in figure.axes)
    assert 'over place, fifth' in ' '.join(figure.legends[0].get_title().get_text().split())


@pytest.mark.parametrize('field, words', [
    ('duration', 'duration'), ('uavs.*.average_power', 'average power of all UAVs'),
    ('uavs.0.start.1', 'start north of UAV 1'), ('channel.los', 'lines of sight'),
    ('eavesdroppers.0.position', 'position of eavesdropper 1'),
    ('eavesdroppers.0.track.1.1', 'track 2 east of eavesdropper 1'),
    ('eavesdroppers.*.track.*.3', 'track radius of all eavesdroppers'),
    ('geofence.1.0', 'geofence 2 east'), ('head_starts.0', 'head starts 1'),
    ('channel.los.0', 'lines of sight 1')])
def test_a_field_is_named_in_words(field, words):
    assert name_field(field) == words


def test_without_a_field_that_varies_methods_are_compared_by_the_rate_of_each_objective():
    rows = rows_of_campaign(second=[1])
    for row in rows:
        row['fields'] = {}
    rows += [{**row, 'method': 'fly_hover_fly_optimised', 'objective': objective}
             for row in rows for objective in ('guaranteed', 'worst_case')]
    figure = draw_figure(rows)
    assert [axes.get_xlabel() for axes in figure.axes] == [
        'guaranteed rate (bit/s/Hz)', 'worst-case rate (bit/s/Hz)']
    assert figure.axes[0].get_legend_handles_labels()[1] == ['joint', 'fly_hover_fly_optimised']


def test_values_of_several_kinds_are_columns_of_json_and_null_is_nothing(tmp_path):
    rows = [{'key': str(number), 'outcome': 'ok', 'fields': {
        'mixed': mixed, 'limit': limit, 'large': large, 'colluding': bool(number)}}
            for number, (mixed, limit, large) in enumerate(
                [(5, None, 1.5), ('x', 2.0, 10**30), (None, 3, 2), ([1, 2], None, True)])]
    csv_file, *parquet_files = save_tables(rows, tmp_path)
    with open(csv_file, newline='') as file:
        table = list(csv.DictReader(file))
    assert [row['mixed'] for row in table] == ['5', '"x"', '', '[1, 2]']
    assert [row['limit'] for row in table] == ['', '2.0', '3', '']
    parquet = pytest.importorskip('pyarrow.parquet')
    [file] = parquet_files
    columns = parquet.read_table(file).to_pydict()
    assert columns['key'] == [row['key'] for row in rows]
    assert columns['mixed'] == ['5', '"x"', None, '[1, 2]']
    assert columns['limit'] == [None, 2.0, 3.0, None]
    assert columns['large'] == ['1.5', f'{10**30}', '2', 'true']
    assert columns['colluding'] == [False, True, True, True]
