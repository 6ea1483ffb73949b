"""The picture of a plan."""

from dataclasses import replace
from itertools import combinations

from hypothesis import given, settings
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Circle
from matplotlib.text import Text
import numpy as np
from processes import ROOT
import pytest
from secure_uav_planner import (
    Eavesdropper, fly_hover_fly, GroundNode, NoFlyZone, Plan, Scenario, solve)
from secure_uav_planner.apps.cli import main
from secure_uav_planner.mission.formats.mission_file import EXAMPLE
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import fly_hover_fly_positions
from secure_uav_planner.output.drawing import uav_color
from secure_uav_planner.output.map import power_level
from secure_uav_planner.output.picture import draw_plan, save_picture
import shapely
from strategies import random_powers, scenarios, with_uavs

CITY = ROOT / 'config' / 'city.yaml'


PAPER = Scenario.paper(120.0, slots=24)
MISSIONS = {
    'paper': PAPER,
    'long': Scenario.paper(200.0),
    'new': Scenario.load(EXAMPLE),
    'city': Scenario.load(CITY),
    'convoy': replace(PAPER, eavesdroppers=tuple(
        Eavesdropper(name=name, track=((0.0, x, -300.0, 15.0), (120.0, x, 300.0, 15.0)),
                     receiver_advantage_db=6.0)
        for name, x in (('car' * 12, 200.0), ('van', -150.0)))),
    'farms': replace(PAPER, ground_node=None, ground_nodes=tuple(
        GroundNode(place, name) for place, name in (
            ((-150.0, 250.0), 'north_farm'), ((-250.0, 0.0), 'mill'), ((50.0, -250.0), 'south')))),
    'corridor': with_uavs(PAPER, start=(-600.0, 20.0), goal=(600.0, 0.0)),
    'square': with_uavs(PAPER, start=(-350.0, 350.0), goal=(350.0, -350.0)),
    'names': replace(PAPER, uavs=tuple(
        replace(PAPER.uavs[0], name=4 * f'observer_{number}_', altitude=100.0 + 10.0 * number)
        for number in range(5))),
    'edge': replace(PAPER, no_fly_zones=(NoFlyZone(
        ((330, 480), (350, 480), (350, 500), (330, 500)), 0.0, 50.0, 'a school at the edge'),))}


@pytest.fixture(scope='module')
def plans():
    scenario = Scenario.paper(120, slots=24)
    return [fly_hover_fly(scenario, power) for power in ('constant', 'optimised')]


def is_close(color, pixels):
    """Return where pixels (..., 3) have almost a colour '#rrggbb'."""
    wanted = np.array([int(color[at:at + 2], 16) / 255 for at in (1, 3, 5)])
    return np.abs(pixels - wanted).max(axis=-1) < 0.03


def test_the_file_shows_both_uavs_the_disc_and_nothing_is_cut_off_at_its_edges(plans, tmp_path):
    save_picture(plans[1], tmp_path / 'plan.png', plans[:1])
    pixels = imread(tmp_path / 'plan.png')[..., :3]
    for color in ('#0072B2', '#E69F00', '#D55E00', '#000000'):
        assert is_close(color, pixels).sum() > 100
    edges = np.concatenate([pixels[:3].reshape(-1, 3), pixels[-3:].reshape(-1, 3),
                            pixels[:, :3].reshape(-1, 3), pixels[:, -3:].reshape(-1, 3)])
    assert (edges == 1).all()


def test_what_is_drawn_is_the_plan_and_the_power_holds_from_its_point_on(plans):
    figure = draw_plan(plans[1], plans[:1])
    map_axes, power_axes, rate_axes = figure.axes
    (values, edges, _), = (
        patch.get_data() for patch in power_axes.patches[:1])
    assert values == pytest.approx(plans[1].powers[0])
    assert edges == pytest.approx(plans[1].times[1:])
    guaranteed, = (patch for patch in rate_axes.patches
                   if patch.get_label() == 'guaranteed rate')
    assert guaranteed.get_data().values == pytest.approx(plans[1].guaranteed_rates)
    paths = [line.get_xydata() for line in map_axes.lines]
    for path in plans[1].positions:
        assert any(path.shape == drawn.shape and np.allclose(path, drawn) for drawn in paths)


def test_north_is_up_and_both_axes_have_one_scale(plans):
    map_axes = draw_plan(plans[0]).axes[0]
    origin, east, north = map_axes.transData.transform([(0, 0), (1, 0), (0, 1)])
    assert east[0] - origin[0] == pytest.approx(north[1] - origin[1]) and east[0] > origin[0]
    assert (map_axes.get_xlabel(), map_axes.get_ylabel()) == ('east (m)', 'north (m)')


def test_the_labels_of_times_cover_no_zone_disc_or_path_nor_each_other(tmp_path):
    main(['new', str(tmp_path / 'mission.yaml')])
    for plan, beyond in ((fly_hover_fly(Scenario.load(CITY)), 5),
                         (solve(Scenario.load(tmp_path / 'mission.yaml')), 10)):
        figure = draw_plan(plan)
        figure.draw_without_rendering()
        axes = figure.axes[0]
        labels = [text.get_window_extent() for text in axes.texts
                  if text.get_text().endswith(' s')]
        assert len(labels) > beyond
        assert not any(first.overlaps(second) for first, second in combinations(labels, 2))
        to_map = axes.transData.inverted()
        boxes = [shapely.box(*to_map.transform(label).ravel()) for label in labels]
        taken = [*(shapely.Polygon(zone.vertices) for zone in plan.scenario.no_fly_zones),
                 *(shapely.Point(eve.position).buffer(eve.error_radius)
                   for eve in plan.scenario.eavesdroppers),
                 *map(shapely.LineString, plan.positions)]
        assert not any(shapely.intersects(box, taken).any() for box in boxes)


def test_the_scale_of_power_distinguishes_low_jamming_power_from_none():
    level = power_level(np.array([0.0, 0.013, 1.3, 4.0]), 4.0)
    assert level[0] == 0 and level[-1] == pytest.approx(1)
    assert (np.diff(level) > 0.1).all()


@pytest.mark.parametrize('mission', MISSIONS)
@pytest.mark.parametrize('width', [3.5, 7.16, None])
def test_nothing_is_drawn_outside_the_figure_which_fits_a_page(mission, width):
    plan = fly_hover_fly(MISSIONS[mission])
    for baselines in ((), [plan, fly_hover_fly(plan.scenario, 'constant')]):
        figure = plan.plot(baselines, title=width is None, width=width)
        figure.draw_without_rendering()
        drawn, (figure_width, height) = figure.get_tightbbox(), figure.get_size_inches()
        assert drawn.x0 >= 0 and drawn.y0 >= 0
        assert drawn.x1 <= figure_width and drawn.y1 <= height
        assert width is None or width == figure_width and height <= 9.0


@pytest.mark.parametrize('width', [3.5, 7.16, None])
def test_every_uav_that_hovers_has_the_time_of_it_beside_it(width):
    for mission in ('long', 'new', 'city'):
        plan = fly_hover_fly(MISSIONS[mission])
        axes = plan.plot(width=width).axes[0]
        colors = {text.get_color() for text in axes.texts if '–' in text.get_text()}
        assert {uav_color(index) for index in range(len(plan.positions))} <= colors


def test_a_square_map_has_the_width_of_a_column_and_no_energies_are_in_it():
    map_axes, power_axes, _ = fly_hover_fly(MISSIONS['square']).plot(width=3.5).axes
    assert map_axes.get_window_extent().width > 0.95 * power_axes.get_window_extent().width
    texts = [text.get_text() for axes in fly_hover_fly(MISSIONS['new']).plot(width=3.5).axes
             for text in axes.get_legend().texts]
    assert texts and not any('kJ' in text for text in texts)


def test_baselines_on_the_map_are_told_apart_by_the_line_that_they_have_in_the_chart():
    plan = fly_hover_fly(MISSIONS['paper'])
    straight = np.linspace(plan.scenario.starts, plan.scenario.goals, 26, axis=1)
    map_axes, _, rate_axes = plan.plot([
        fly_hover_fly(plan.scenario, 'optimised'), plan,
        replace(plan, positions=straight, method='planned elsewhere')]).axes
    lines = {line.get_label(): line.get_linestyle() for line in map_axes.lines}
    rates = {patch.get_label(): patch.get_linestyle() for patch in rate_axes.patches}
    assert lines['planned elsewhere'] == rates['planned elsewhere'] == '-.'
    assert lines['fly-hover-fly'] == rates['fly-hover-fly,\noptimised power'] == ':'


@settings(max_examples=10, deadline=None)
@given(scenario=scenarios(max_uavs=4, max_eavesdroppers=3))
def test_a_plan_of_any_mission_can_be_drawn(scenario):
    plan = Plan(scenario, fly_hover_fly_positions(Problem(scenario)),
                random_powers(scenario, np.random.default_rng(0)))
    figure = draw_plan(plan, [plan])
    figure.draw_without_rendering()
    assert len(figure.axes) == 3


@pytest.mark.filterwarnings('error')
def test_names_of_any_kind_are_shown_and_stay_within_the_picture(plans, tmp_path):
    names = ('$\\bad$', '_hidden', 'name_of_thirty_characters_long', '無人機', 'a' * 80)
    first = plans[0].scenario
    scenario = replace(first, uavs=tuple(replace(first.uavs[0], name=name) for name in names),
                       no_fly_zones=(NoFlyZone(((0, 0), (9, 0), (9, 9)), name='$\\bad$'),))
    plan = fly_hover_fly(replace(scenario, no_fly_zones=()))
    for number, figure in enumerate((plan.plot(), scenario.plot())):
        file = tmp_path / f'{number}.png'
        figure.savefig(file)
        for axes in figure.axes[:2]:
            texts = [text.get_text().replace('\n', '') for text in axes.get_legend().texts]
            for name in ('\\$\\bad\\$', '_hidden', 'name_of_thirty_characters_long', '無人機'):
                assert any(name in text for text in texts)
        assert (imread(file)[:, -3:, :3] == 1).all()


def test_one_limit_of_power_has_one_label_and_a_rate_of_zero_cuts_none_off(plans, tmp_path):
    scenario = with_uavs(plans[0].scenario, peak_power=1.0, average_power=1.0)
    figure = fly_hover_fly(replace(scenario, reference_snr_db=0.0)).plot()
    assert [text.get_text() for text in figure.axes[1].texts] == ['peak, average']
    figure.savefig(tmp_path / 'plan.png')
    assert (imread(tmp_path / 'plan.png')[:, :3, :3] == 1).all()


def test_for_a_column_of_a_paper_all_texts_are_serif_of_8_pt_and_none_is_cut(plans, tmp_path):
    for plan in (plans[1], fly_hover_fly(Scenario.load(CITY))):
        figure = plan.plot([plan], title=False, width=3.5)
        figure.savefig(tmp_path / 'plan.png', dpi=100)
        pixels = imread(tmp_path / 'plan.png')[..., :3]
        assert pixels.shape[1] == 350 and (pixels[:, [0, 1, -2, -1]] == 1).all()
        texts = [text for text in figure.findobj(Text) if text.get_text()]
        assert {text.get_fontsize() for text in texts} == {8.0}
        assert {*texts[0].get_family()} & {'serif'}
        assert figure.axes[0].get_title(loc='left') == ''


def test_a_plan_is_drawn_into_the_axes_of_its_user(plans):
    axes = Figure().subplots(1, 3)
    assert plans[0].plot(axes=axes) is axes[0].figure
    assert [part.get_ylabel() for part in axes] == [
        'north (m)', 'power (W)', 'secrecy rate\n(bit/s/Hz)']
    alone = Figure().subplots()
    assert plans[0].plot(axes=alone).axes == [alone]
    for wrong in ({'axes': 5}, {'axes': []}, {'width': 1.0}):
        with pytest.raises(ValueError, match=f'{next(iter(wrong))} is .* must be'):
            plans[0].plot(**wrong)


def test_receivers_that_move_are_told_apart_by_colour_and_name():
    scenario = replace(Scenario.paper(120.0, slots=6), eavesdroppers=tuple(
        Eavesdropper(name=name, track=((0.0, 200.0, y, 15.0), (120.0, 200.0, 300.0 + y, 15.0)))
        for name, y in (('car', -300.0), ('van', -360.0))))
    axes = fly_hover_fly(scenario).plot().axes[0]
    centres = {tuple(patch.center) for patch in axes.patches if isinstance(patch, Circle)}
    assert {(200.0, -300.0), (200.0, -150.0), (200.0, 0.0)} <= centres
    colors = {text.get_text(): text.get_color() for text in axes.texts}
    assert colors['car, 0 s'] != colors['van, 0 s'] and {'60 s', '120 s'} <= colors.keys()
    legend = axes.get_legend()
    entries = dict(zip([text.get_text() for text in legend.get_texts()], legend.legend_handles))
    assert 'eavesdropper, disc' not in entries
    for name in ('car', 'van'):
        assert entries[name].get_color() == colors[f'{name}, 0 s']
