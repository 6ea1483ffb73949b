"""Results of campaigns: the figure by the fields that vary, and tables of values of any kind."""

import csv
from itertools import product
import json

import pytest
from secure_uav_planner.apps.results import draw_figure, save_tables


def rows_of_campaign(**fields):
    """Return rows whose rate is duration times the number of the second field's value."""
    second = next(iter(fields))
    return [{'outcome': 'ok', 'sample': draw, 'method': 'joint', 'objective': 'guaranteed',
             'guaranteed_rate': duration * (1 + fields[second].index(values[0])) + draw,
             'worst_case_rate': 0.0,
             'fields': {'duration': duration, 'place': [draw, 0.0], **dict(zip(fields, values))}}
            for duration in (10.0, 20.0) for draw in range(11)
            for values in product(*fields.values())]


@pytest.mark.parametrize('values', [[5.0, 10.0, 30.0], [[0, 0], [1, 1]]])
def test_the_figure_has_a_line_for_each_value_of_a_second_field_and_says_what_bands_are(values):
    figure = draw_figure(rows_of_campaign(second=values))
    [legend], [axes] = figure.legends, figure.axes
    assert legend.get_title().get_text() == (
        'lines: medians; bands: from 10 to 90% of the missions, over place')
    figure.draw_without_rendering()
    assert not legend.get_window_extent().overlaps(axes.bbox)
    assert axes.get_xlabel() == 'duration (s)'
    assert [line.get_label() for line in axes.lines] == [
        f'second {json.dumps(value)}, joint' for value in values]
    for number, (line, band) in enumerate(zip(axes.lines, axes.collections)):
        medians = [duration * (1 + number) + 5 for duration in (10, 20)]
        assert line.get_xydata().tolist() == [[10, medians[0]], [20, medians[1]]]
        heights = {round(y) for _, y in band.get_paths()[0].vertices}
        assert heights == {middle + by for middle in medians for by in (-4, 4)}


def test_a_third_and_a_fourth_field_are_small_multiples():
    figure = draw_figure(rows_of_campaign(
        second=[1, 2], third=['a', 'b', 'c'], fourth=[0, 7], fifth=[1, 2]))
    assert [axes.get_title() for axes in figure.axes] == [
        f'third "{letter}"\nfourth {number}' for number in (0, 7) for letter in 'abc']
    assert all(len(axes.lines) == 2 for axes in figure.axes)
    assert figure.legends[0].get_title().get_text().endswith('over place, fifth')


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
