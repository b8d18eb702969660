"""The call of each task: what it measures, what it refuses, and what it writes."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

import analytic
from foundation.files import plain
from siamloc import evaluation, maps
from siamloc.data import PanoramaLibrary, Protocol
from siamloc.data.frames import concatenate
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation import Result
from siamloc.models import build
from siamloc.results import finest
from tests.siamloc.evaluation.scenes import evaluate_absolute
from tests.siamloc.evaluation.world import Reads, drive, library


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    folder = tmp_path_factory.mktemp("world")
    drives = ("monday", 40, 1), ("tuesday", 30, 2), ("sunday", 30, 3)
    monday, tuesday, sunday = (drive(folder, *one) for one in drives)
    images = library(folder, monday, tuesday, sunday)
    return images, monday, tuesday, sunday, maps.build(Reads(), images, monday, progress=False)


def test_localization_is_the_search_of_the_map_compared_with_the_truth(world):
    images, _, tuesday, _, known = world
    result = evaluation.localization(known, images, tuesday, radii=(0.5,), ks=(1, 3), baselines=["thumbnail"])
    vectors = Reads().describe(images.batch(images.rows(tuesday))).position
    expected = evaluate_absolute(known, vectors, tuesday, (0.5,), (1, 3))
    for name, column in expected.tables["queries"].items():
        np.testing.assert_array_equal(result.tables["queries"][name], column, err_msg=name)
    assert result.measures["error"] == expected.measures["error"]
    assert list(result.parts) == ["absolute", "room_retrieval"]
    assert result.measures["baselines"]["thumbnail"]["error"] == result.baselines["thumbnail"].measures["error"]
    assert result.about["protocol"] == "cross_run"
    assert "reads has no margin" in result.skipped["room_pairs"]
    assert "thumbnail" in result.table()
    assert "mAP@100" in result.table()


def test_pairs_that_cannot_be_drawn_are_said_without_the_keys_of_training(world, monkeypatch):
    images, _, tuesday, _, known = world
    monkeypatch.setattr(known.descriptor, "margin", 2.0, raising=False)
    rooms = tuesday.rows_by("room")
    for rows, says in (
        ([own[0] for own in rooms.values()], f"each of the {len(rooms)} rooms has only one frame"),
        (next(iter(rooms.values())), "belong to one room"),
    ):
        said = evaluation.rooms(known, images, tuesday.take(rows)).skipped["room_pairs"]
        assert says in said
        assert said.endswith("-room pairs")


def test_a_result_is_written_and_read_back(world, tmp_path):
    images, _, tuesday, _, known = world
    result = evaluation.localization(known, images, tuesday, baselines=["thumbnail"])
    result.save(tmp_path / "reads", pictures=False)
    again = Result.load(tmp_path / "reads")
    assert json.dumps(plain(again.parts)) == json.dumps(plain(result.parts))
    assert again.settings == plain(result.settings)
    for name, column in result.columns.items():
        np.testing.assert_array_equal(again.tables["queries"][name], column, err_msg=name)
    assert again.table().splitlines()[:4] == result.table().splitlines()[:4]
    assert "queries" in repr(result)
    assert result._repr_html_().startswith("<pre>")
    assert len(result.plot("error_curve").axes) >= 1
    with pytest.raises(DataError, match=r"no picture 'pie'.*error_curve"):
        result.plot("pie")


@pytest.mark.parametrize(
    "protocol",
    [Protocol(leave_one_out=True), Protocol(apart_seconds=3.0), Protocol(apart_metres=2.0)],
    ids=["leave-one-out", "seconds", "metres"],
)
def test_queries_of_the_maps_own_drive_are_honest_where_near_frames_are_left_out(world, protocol):
    images, monday, _, _, known = world
    with pytest.raises(ConfigError, match="'monday' is in the map and among the queries"):
        evaluation.localization(known, images, monday)
    result = evaluation.localization(known, images, monday, protocol=protocol)
    excluded = protocol.excluded(monday, monday)
    for row in range(len(monday)):
        allowed = [j for j in range(len(monday)) if not excluded[row, j]]
        vectors = known.descriptors.astype(float)
        best = min(allowed, key=lambda j: (np.linalg.norm(vectors[j] - vectors[row]), j))
        assert result.columns["match"][row] == best
        floor = min(math.dist(monday.xy[j], monday.xy[row]) for j in allowed)
        assert result.columns["floor"][row] == pytest.approx(floor)
    assert excluded.any(axis=1).all()


def test_queries_that_find_few_frames_or_none_of_their_room_are_said(world):
    images, monday, _, _, known = world
    least = int((~Protocol(apart_seconds=3.0).excluded(monday, monday)).sum(axis=1).min())
    result = evaluation.rooms(known, images, monday, protocol=Protocol(apart_seconds=3.0))
    assert f"find only {least} map frames" in result.skipped["room_retrieval, ranks"]
    once = monday.with_columns(room=["alone", *monday.room[1:].tolist()])
    result = evaluation.rooms(replace(known, frames=once), images, once, protocol=Protocol(leave_one_out=True))
    assert result.skipped["rooms"].startswith(
        "1 of 40 queries may find no map frame of their room, which the protocol excludes (alone)"
    )
    assert "room_retrieval, ranks" not in result.skipped


def test_a_map_in_which_frames_lack_positions_says_for_how_many_queries_a_robot_gives_none(world):
    images, monday, tuesday, _, known = world
    some = replace(known, frames=monday.with_columns(x=np.where(np.arange(len(monday)) % 4, np.nan, monday.x)))
    nearest = evaluation.localization(known, images, tuesday, names=("absolute",)).columns["match"]
    without = int((~some.frames.has_position)[nearest].sum())
    said = evaluation.localization(some, images, tuesday).skipped["absolute, map frames"]
    assert said.startswith(f"{len(monday) * 3 // 4} of {len(monday)} map frames have no position; a robot without")
    assert f"as for {without} of the {len(tuesday)} queries: track it, or make the map without them" in said
    assert "absolute, map frames" not in evaluation.localization(some.placed(), images, tuesday).skipped
    alone = evaluation.localization(some, images, monday, protocol=Protocol(leave_one_out=True))
    assert alone.skipped["absolute, map frames"].endswith("have no position"), "no robot leaves frames out"


def test_rooms_need_no_positions(world):
    images, monday, tuesday, _, known = world
    blind = np.full(len(tuesday), np.nan)
    result = evaluation.rooms(known, images, tuesday.with_columns(x=blind, y=blind))
    right = [monday.room[match] == room for match, room in zip(result.columns["match"], tuesday.room, strict=True)]
    assert result.measures["accuracy"] == sum(right) / len(right) > 0.8
    assert set(result.measures) >= {"top", "chance", "mean_average_precision", "confusion"}


def test_filter_interpolation_and_expected_errors(world):
    images, _, tuesday, sunday, known = world
    result = evaluation.localization(
        known, images, tuesday, validation=sunday, filter=True, filter_tune=True, refine="interpolate", error_model=True
    )
    assert {"absolute_filtered", "absolute_interpolated", "absolute_tracked", "calibration"} <= set(result.parts)
    assert {"filtered_error", "interpolated_error", "tracked_error", "error_m", "lost"} <= set(result.columns)
    assert set(result.about["estimates"]) == {"filter", "interpolation", "tracking", "error_model"}
    near = np.hypot(result.columns["tracked_est_x"] - result.columns["filtered_est_x"], 0)
    assert 0 < near.max() <= 1, "the mean between frames stays within place_radius of the most probable one"
    assert result.refinement == maps.Refinement("interpolate", 3, 1.0, map_digest=known.digest)
    assert result.error_model == evaluation.error_model(known, images, sunday, refine="interpolate")
    assert result.error_model != evaluation.error_model(known, images, sunday)
    model = evaluation.error_model(known, images, sunday, place_radius=0.2)
    assert model.foreign_above is not None, "there are enough frames farther than 0.6 m away"
    found = maps.match(known, known.descriptor.describe(images.batch(images.rows(tuesday))), 20)
    judged = evaluation.localization(
        known, images, tuesday, validation=sunday, error_model=True, place_radius=0.2
    ).columns
    np.testing.assert_array_equal(judged["lost"], model.judged(found, known.frames.xy)[1])
    between = result.parts["calibration"]["overall"]["observed"]
    assert between == pytest.approx(result.columns["interpolated_error"].mean())
    with pytest.raises(ConfigError, match="give validation=FRAMES"):
        evaluation.localization(known, images, tuesday, error_model=True)
    own = maps.build(Reads(), images, sunday, progress=False)
    with pytest.raises(ConfigError, match="'sunday' is in the map and in the validation"):
        evaluation.localization(own, images, tuesday, validation=sunday, error_model=True)


def test_poses_by_comparison_with_map_frames(world, tmp_path, monkeypatch):
    images, monday, tuesday, sunday, reads = world
    network = build("panoresnet", "magnitudes", images.image_shape[1:], circular=True, relative=True)
    known = maps.build(network, images, monday, progress=False)
    result = evaluation.localization(known, images, tuesday, validation=sunday, refine="relative", neighbours=2)
    overall = result.parts["absolute_refined"]["overall"]
    assert overall["error"]["mean"] == pytest.approx(result.columns["refined_error"].mean())
    assert 0 <= overall["inside"] <= 1
    assert set(result.about["estimates"]["refinement"]) == {"neighbours", "widened", "validation"}
    described = known.descriptor.describe(images.batch(images.rows(tuesday)))
    poses = maps.refine(known, described, maps.match(known, described, 2), k=2)
    moved = np.hypot(*(poses.xy - tuesday.xy).T)
    np.testing.assert_allclose(result.columns["refined_error"], moved, rtol=1e-3, atol=1e-3)
    assert "refinement" in result.table()
    wider = result.about["estimates"]["refinement"]["widened"]
    assert result.refinement == maps.Refinement("relative", 2, widening=wider, map_digest=known.digest)
    result.save(tmp_path / "result", pictures=False)
    assert evaluation.Result.load(tmp_path / "result").refinement == result.refinement
    evaluation.localization(known, images, tuesday).save(tmp_path / "result", pictures=False)
    assert evaluation.Result.load(tmp_path / "result").refinement is None
    finer, name = finest(result.columns)
    assert name == "refined"
    np.testing.assert_array_equal(finer["error"], result.columns["refined_error"])
    expecting = evaluation.localization(
        known, images, tuesday, validation=sunday, refine="relative", neighbours=2, error_model=True
    )
    assert expecting.error_model.of_poses
    expected = expecting.error_model.predict(maps.match(known, described, 2), known.frames.xy, poses)
    np.testing.assert_allclose(expecting.columns["error_m"], expected, rtol=1e-2)
    judged = expecting.parts["calibration"]["overall"]
    assert judged["observed"] == pytest.approx(expecting.columns["refined_error"].mean())
    bare = tuesday.with_columns(x=np.full(len(tuesday), np.nan), y=np.full(len(tuesday), np.nan))
    unscored = evaluation.localization(
        known, images, bare, validation=sunday, refine="relative", neighbours=2, error_model=True
    )
    assert unscored.refinement == result.refinement
    assert unscored.error_model == expecting.error_model
    located = unscored.tables["located"]
    np.testing.assert_allclose(located["refined_est_x"], poses.xy[:, 0], rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(located["error_m"], expecting.columns["error_m"], rtol=1e-2)
    followed = evaluation.localization(known, images, tuesday, refine="relative", neighbours=2, filter=True)
    overall = followed.parts["absolute_tracked"]["overall"]
    assert overall["error"]["mean"] == pytest.approx(followed.columns["tracked_error"].mean())
    step = followed.about["estimates"]["tracking"]["step"]
    expected = maps.PoseFilter(step).run(poses, tuesday.sequence)
    np.testing.assert_allclose(followed.columns["tracked_est_x"], expected.xy[:, 0], rtol=1e-3, atol=1e-3)
    assert finest(followed.columns)[1] == "tracked"
    assert "odometry" not in followed.about["estimates"]["tracking"]
    driven = tuesday.with_columns(odom_x=tuesday.x, odom_y=tuesday.y, odom_theta=tuesday.theta)
    by_wheels = evaluation.localization(known, images, driven, refine="relative", neighbours=2, filter=True)
    expected = maps.PoseFilter(step).run(poses, tuesday.sequence, maps.motions(driven))
    np.testing.assert_allclose(by_wheels.columns["tracked_est_x"], expected.xy[:, 0], rtol=1e-3, atol=1e-3)
    model = maps.MotionModel.learn(known.frames, step=by_wheels.about["estimates"]["filter"]["step"])
    robot = maps.SequenceFilter(model, maps.temperature_of_map(known))
    filtered = robot.run(maps.frame_distances(known, described), driven.sequence, motion=maps.motions(driven))
    np.testing.assert_array_equal(by_wheels.columns["filtered_match"], filtered.frame)
    assert by_wheels.about["estimates"]["tracking"]["odometry"] == len(tuesday) - 1
    degrees = driven.with_columns(odom_theta=np.arange(len(driven)) * 20.0)
    with pytest.raises(DataError, match="tracked by its odometry: odom_theta looks like degrees"):
        evaluation.localization(known, images, degrees, filter=True)
    assert followed.plot("tracked_plan").axes
    monkeypatch.setattr(PanoramaLibrary, "batches", lambda *_: pytest.fail("images were described"))
    with pytest.raises(ConfigError, match=r"reads does not tell .*task\.refine=interpolate"):
        evaluation.localization(reads, images, tuesday, refine="relative")


def test_a_robot_is_tracked_through_queries_without_a_position(world):
    images, monday, tuesday, _, reads = world
    network = build("panoresnet", "magnitudes", images.image_shape[1:], circular=True, relative=True)
    compares = maps.build(network, images, monday, progress=False)
    driven = tuesday.with_columns(odom_x=tuesday.x, odom_y=tuesday.y, odom_theta=tuesday.theta)
    some = driven.with_columns(x=np.where(np.arange(len(driven)) % 3 == 1, np.nan, driven.x))
    for known, refine in ((compares, "relative"), (reads, "interpolate")):
        whole, part = (
            evaluation.localization(known, images, queries, refine=refine, neighbours=2, filter=True)
            for queries in (driven, some)
        )
        for about in ("filter", "tracking"):
            assert part.about["estimates"][about] == whole.about["estimates"][about]
        np.testing.assert_array_equal(part.columns["path"], driven.path[some.has_position])
        for name in ("filtered_match", "filtered_probability", "filtered_error", "tracked_est_x", "tracked_error"):
            np.testing.assert_allclose(part.columns[name], whole.columns[name][some.has_position], rtol=1e-4, atol=1e-5)


def test_a_drive_without_any_position_changes_nothing_of_how_others_are_tracked(world):
    images, _, tuesday, sunday, known = world
    late = {"time": sunday.time * 10, "x": np.full(len(sunday), np.nan)}
    moved = {"odom_x": sunday.x * 100, "odom_y": sunday.y * 100, "odom_theta": sunday.theta}
    both = concatenate([tuesday, sunday.with_columns(**late, **moved)])
    alone, beside = (
        evaluation.localization(known, images, queries, filter=True, names=("absolute",)) for queries in (tuesday, both)
    )
    assert beside.about["estimates"] == alone.about["estimates"]
    for name, column in alone.columns.items():
        np.testing.assert_array_equal(beside.columns[name], column, err_msg=name)


def test_a_filter_is_tuned_on_a_whole_drive_by_the_frames_with_positions(world):
    images, _, tuesday, sunday, known = world
    part = sunday.with_columns(x=np.where(np.arange(len(sunday)) % 2, np.nan, sunday.x))
    result = evaluation.localization(known, images, tuesday, validation=part, filter=True, filter_tune=True)
    apart = maps.frame_distances(known, known.descriptor.describe(images.batch(images.rows(sunday))))
    model = maps.MotionModel.learn(known.frames, interval=float(np.median(np.diff(sunday.time))))
    best = maps.tune_filter(model, apart, part.xy, part.sequence, maps.temperature_of_map(known))[0]
    tuned = {"queries": int(part.has_position.sum()), "error": pytest.approx(best.error)}
    assert result.about["estimates"]["filter"]["tuned"] == tuned


def test_hierarchical_search_of_all_nodes_is_the_search_of_the_map(world):
    images, _, tuesday, _, known = world
    built = maps.group(known, "sample", nodes=8)
    every = evaluation.hierarchical(known, images, tuesday, built, candidates=8)
    whole = evaluation.localization(known, images, tuesday)
    np.testing.assert_array_equal(every.columns["match"], whole.columns["match"])
    without = replace(known, frames=known.frames.with_columns(x=np.full(len(known), np.nan)))
    rooms = maps.group(without, "rooms")
    with pytest.raises(DataError, match="no map frame has a position: give x and y in a manifest"):
        evaluation.hierarchical(without, images, tuesday, rooms)
    few = evaluation.hierarchical(known, images, tuesday, built, candidates=1, coarse={"by": "vote", "neighbours": 3})
    assert few.measures["comparisons"]["frames_share"] < 0.5
    assert "hierarchical localization" in few.table()
    other = maps.build("thumbnail", images, known.frames, progress=False)
    for task in (
        lambda: evaluation.hierarchical(other, images, tuesday, built),
        lambda: evaluation.hierarchical(known, images, tuesday, built, coarse_map=other),
        lambda: evaluation.mapping(other, built),
    ):
        with pytest.raises(DataError, match=r"was not built over VisualMap\(40 frames"):
            task()


def test_the_building_of_a_query(world, tmp_path):
    images, monday, tuesday, _, known = world
    near, far = (
        frames.with_columns(building=np.where(frames.x < 15, "north", "south")) for frames in (monday, tuesday)
    )
    both = maps.build(Reads(), images, near, progress=False)
    result = evaluation.buildings(both, images, far)
    assert result.measures["accuracy"] > 0.9
    assert result.parts["buildings"]["maps"]["north"]["frames"] == int((monday.x < 15).sum())
    one = evaluation.buildings(both, images, far.select(building="north"))
    assert one.denominators["queries"] == int((tuesday.x < 15).sum())
    assert one.measures["confusion"]["labels"] == ["north", "south"], "queries of one building are looked for in all"
    layers = {name: maps.group(part, "sample", nodes=4).layer for name, part in evaluation.by_building([both]).items()}
    assert evaluation.buildings(both, images, far, layers=layers).measures["accuracy"] > 0.8
    with pytest.raises(DataError, match="40 of the 40 map frames have no building"):
        evaluation.buildings(known, images, far)
    north, south = evaluation.by_building([both]).values()
    with pytest.raises(ConfigError, match=r"different distances \(euclidean in north, manhattan in south\)"):
        evaluation.buildings([north, replace(south, distance="manhattan")], images, far)
    with pytest.raises(ConfigError, match="building 'south' has no layer"):
        evaluation.buildings(both, images, far, layers={"north": layers["north"]})
    with pytest.raises(DataError, match="the layer of building 'north' has labels for"):
        evaluation.buildings(both, images, far, layers={"north": layers["south"], "south": layers["north"]})


def test_without_positions_disturbed_queries_are_judged_by_their_room(world):
    images, monday, tuesday, _, _ = world
    blind = [frames.with_columns(x=np.full(len(frames), np.nan)) for frames in (monday, tuesday)]
    known = maps.build(Reads(), images, blind[0], progress=False)
    result = evaluation.robustness(known, images, blind[1], every=1, noise=(0,), occlusion=(), turn=())
    right = evaluation.rooms(known, images, blind[1]).measures["accuracy"]
    assert result.measures["unit"] == "wrong rooms"
    entry = result.measures["methods"]["reads"]["noise"][0]
    assert entry["mean"] == pytest.approx(1 - right)
    assert entry["share"] == pytest.approx(right)


def test_frames_left_out_stay_left_out_under_disturbances_and_are_refused_where_they_cannot(world):
    images, monday, _, _, known = world
    apart = Protocol(leave_one_out=True)
    result = evaluation.robustness(known, images, monday, protocol=apart, every=1, noise=(0,), occlusion=(), turn=())
    whole = evaluation.localization(known, images, monday, protocol=apart)
    assert result.measures["methods"]["reads"]["noise"][0]["mean"] == pytest.approx(whole.measures["error"]["mean"])
    level = result.measures["methods"]["reads"]["noise"][0]
    assert level["floor"] == pytest.approx(whole.measures["floor"]["mean"])
    assert level["excess"] == pytest.approx(whole.measures["excess"]["mean"])
    with pytest.raises(ConfigError, match="hierarchical localization compares queries with all frames"):
        evaluation.hierarchical(known, images, monday, maps.group(known, "sample", nodes=4), protocol=apart)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"radius": (1,)}, "localization has no setting 'radius': did you mean 'radii'"),
        ({"names": ()}, "task.names must be a list of one or more of absolute and room_retrieval"),
        ({"filter_tune": True}, "task.filter_tune=true chooses the settings of the sequence filter"),
        ({"names": ("room_retrieval",), "refine": "interpolate"}, "task.refine goes with absolute localization"),
        ({"protocol": "honest"}, "protocol.kind must be cross_run or same_run, got 'honest'"),
        ({"baselines": ["hogg"]}, "hogg.*hog"),
    ],
)
def test_settings_that_mean_nothing_are_one_sentence(world, options, says):
    images, _, tuesday, _, known = world
    with pytest.raises(Exception, match=says) as caught:
        evaluation.localization(known, images, tuesday, **options)
    assert type(caught.value).__name__ in ("ConfigError", "AnalyticError")


def test_no_estimate_compares_a_query_with_frames_that_are_left_out(world):
    images, monday, _, _, known = world
    protocol = Protocol(apart_seconds=3.0)
    excluded, rows = protocol.excluded(monday, monday), np.arange(len(monday))
    result = evaluation.localization(
        known, images, monday, protocol=protocol, filter=True, refine="interpolate", neighbours=2
    )
    assert not excluded[rows, result.columns["filtered_match"]].any()
    assert (result.columns["filtered_error"] >= result.columns["floor"] - 1e-9).all()
    blind = monday.with_columns(x=np.where(rows < 5, np.nan, monday.x))
    located = evaluation.localization(known, images, blind, protocol=protocol).tables["located"]
    assert not excluded[rows[:5], located["match"]].any()
    by_way = evaluation.localization(
        known.take(rows >= 5), images, blind, protocol=Protocol(apart_metres=2.0), names=("absolute",)
    )
    assert "located" not in by_way.tables
    assert "have no position along a drive" in by_way.skipped["located"]


def test_a_session_shows_itself_and_takes_each_thing_in_its_place(world):
    images, _, tuesday, _, known = world
    shown = repr(evaluation.Session(known, images, tuesday))
    assert shown.startswith("Session(reads: 30 queries in VisualMap(40 frames")
    with pytest.raises(ConfigError, match="known must be a VisualMap, got PanoramaLibrary"):
        evaluation.localization(images, known, tuesday)
    with pytest.raises(ConfigError, match="queries must be a FrameTable, got 'tuesday'"):
        evaluation.robustness(known, images, "tuesday")


def test_validation_frames_are_never_queries(world):
    images, _, tuesday, _, known = world
    for protocol in ("cross_run", "same_run"):
        with pytest.raises(ConfigError, match="sequence 'tuesday' is among the queries and in the validation"):
            evaluation.localization(
                known, images, tuesday, validation=tuesday.every(2), error_model=True, protocol=protocol
            )


def test_panoramas_made_in_another_way_than_those_of_the_map_are_refused_by_every_task(world, tmp_path):
    _, _, tuesday, _, known = world
    larger = PanoramaLibrary(tuesday, tmp_path, image_size=(16, 64))
    for task in (evaluation.localization, evaluation.robustness):
        with pytest.raises(ConfigError, match=r"images\.height is 8 in the map, 16 here"):
            task(known, larger, tuesday)


def test_queries_and_validation_in_another_unit_than_the_map_are_refused_by_every_task(world):
    images, _, tuesday, sunday, known = world
    feet, days = replace(tuesday, unit="ft"), replace(sunday, unit="ft")
    layer = maps.group(known, "sample", nodes=4)
    for task in (
        lambda: evaluation.localization(known, images, feet),
        lambda: evaluation.localization(known, images, tuesday, validation=days, error_model=True),
        lambda: evaluation.hierarchical(known, images, feet, layer),
        lambda: evaluation.robustness(known, images, feet),
        lambda: evaluation.compact(known, images, feet, nodes=(4,)),
        lambda: evaluation.error_model(known, images, feet),
    ):
        with pytest.raises(DataError, match="positions count in m and ft cannot be joined or compared"):
            task()
    nowhere = replace(feet, x=np.full(30, np.nan))
    assert "room_retrieval" in evaluation.rooms(known, images, nowhere).parts


@pytest.mark.parametrize(
    ("column", "label"), [("lighting", "all"), ("lighting", "all queries"), ("room", "(unlabelled)")]
)
def test_queries_whose_label_names_a_row_of_the_tables_are_refused(world, column, label):
    images, _, tuesday, _, known = world
    labels = np.where(np.arange(len(tuesday)) % 2, label, "night")
    same = tuesday.with_columns(building=["b"] * len(tuesday), **{column: labels})
    with pytest.raises(DataError, match=rf"the {column} {re.escape(repr(label))}, which names a row of the tables"):
        evaluation.compact(known, images, same, nodes=(2,), ways=("sample",))


def test_every_result_says_what_its_methods_take_and_keep(world, tmp_path):
    images, _, tuesday, _, known = world
    result = evaluation.localization(known, images, tuesday, baselines=["hog"])
    hog = result.baselines["hog"].cost
    assert min(hog[f"{step}_ms"] for step in ("describe", "search", "heading")) > 0
    described = maps.build("hog", images, known.frames, progress=False)
    assert (hog["numbers"], hog["map_frames"]) == (described.width, len(known))
    assert hog["bytes"] == (described.descriptors.nbytes + described.orientation.nbytes) // len(known)
    assert result.cost["bytes"] == 4 * known.width
    assert "cost of a query" in result.table()
    result.save(tmp_path, pictures=False)
    again = Result.load(tmp_path)
    assert again.cost == result.cost
    assert again.baselines["hog"].cost == hog
    layer = maps.group(known, "sample", nodes=4)
    both = evaluation.hierarchical(known, images, tuesday, layer).cost
    assert min(both[f"{step}_ms"] for step in ("describe", "rank", "search", "whole_search")) > 0


def test_a_distance_is_a_setting_of_maps_and_one_that_says_nothing_of_the_descriptors_is_refused(world):
    images, _, tuesday, _, known = world
    found = evaluation.localization(known.with_distance("manhattan"), images, tuesday).columns["descriptor_distance"]
    vectors = Reads().describe(images.batch(images.rows(tuesday))).position
    np.testing.assert_array_equal(found, analytic.distance("manhattan")(vectors, known.descriptors).min(axis=1))
    with pytest.raises(ConfigError, match="unknown distance 'cosin': did you mean 'cosine'"):
        known.with_distance("cosin")
    one = replace(known, descriptors=known.descriptors[:, :1], describes=None, identity={})
    with pytest.raises(ConfigError, match="distance=cosine needs descriptors of 2 numbers or more, and these have 1"):
        one.with_distance("cosine")
    assert known.with_distance(None) is known
    assert known.with_distance("cosine").digest != known.digest
