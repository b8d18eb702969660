from __future__ import annotations

import math

import numpy as np
import pytest

import siamloc
from augment import AugmentError
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError
from siamloc.evaluation.disturbed import Disturbance, Robustness, locate_disturbed
from siamloc.evaluation.disturbed_tables import Answer, answers, concatenated, curves, measures

ROWS = np.array([4, 9, 11])


@pytest.fixture
def images() -> np.ndarray:
    return np.random.default_rng(0).integers(40, 200, (3, 3, 16, 72), dtype=np.uint8)


def frames(x: list[float]) -> FrameTable:
    return FrameTable(path=np.array([f"{i}.png" for i in range(len(x))]), x=np.array(x), y=np.zeros(len(x)))


@pytest.mark.parametrize(
    ("name", "kind", "level"),
    [("noise", "noise", 0), ("occlusion", "occlusion", 0), ("turn", "turn", 0), ("turn", "turn", 360)]
    + [(name, "effect", 0) for name in ("bulb", "darken", "blur", "rotate", "jpeg", "sun_patch", "motion_blur")],
)
def test_the_lowest_level_changes_nothing(images: np.ndarray, name: str, kind: str, level: float) -> None:
    np.testing.assert_array_equal(Disturbance(name, (level,), kind).apply(images, level, ROWS), images)


def test_a_left_turn_moves_the_content_to_the_right(images: np.ndarray) -> None:
    turned = Disturbance("turn", (90,), "turn").apply(images, 90, ROWS)
    np.testing.assert_array_equal(turned[..., 18:], images[..., :-18])


@pytest.mark.parametrize(
    ("name", "kind", "level"),
    [("noise", "noise", 0.02), ("occlusion", "occlusion", 0.3), ("bulb", "effect", 1.0), ("sun_patch", "effect", 0.5)],
)
def test_draws_follow_from_seed_and_query_alone(images: np.ndarray, name: str, kind: str, level: float) -> None:
    one = Disturbance(name, (level,), kind)
    whole = one.apply(images, level, ROWS)
    for i in range(3):
        np.testing.assert_array_equal(one.apply(images[i : i + 1], level, ROWS[i : i + 1])[0], whole[i])
    assert (one.apply(images, level, ROWS + 1) != whole).any()
    assert (one.apply(images, level, ROWS, seed=1) != whole).any()
    same = one.apply(np.stack([images[0]] * 3), level, ROWS)
    assert (same[0] != same[1]).any(), "each query has a draw of its own"


def test_bars_are_as_many_of_the_colour_and_at_the_place_asked_for(images: np.ndarray) -> None:
    asked = Robustness(noise=(), turn=(), occlusion=(0.5,), bars=2, bar_colour="grey", bar_place=0.0)
    (one,) = asked.disturbances(circular=True)
    hidden = one.apply(images, 0.5, ROWS)
    covered = np.isin(np.arange(72) // 18, (0, 2))
    assert (hidden[..., covered] == 128).all()
    np.testing.assert_array_equal(hidden[..., ~covered], images[..., ~covered])


def test_stronger_effects_change_more_at_the_same_place() -> None:
    grey = np.full((3, 3, 64, 256), 100, dtype=np.uint8)
    bulb = Disturbance("bulb", (0.25, 0.5, 1), "effect")
    change = [np.abs(bulb.apply(grey, level, ROWS).astype(int) - 100) for level in bulb.levels]
    assert change[0].sum() < change[1].sum() < change[2].sum()
    for image in range(3):
        brightest = [np.unravel_index(part[image, 0].argmax(), (64, 256)) for part in change]
        assert np.ptp(np.array(brightest), axis=0).max() <= 2


@pytest.mark.parametrize(
    ("wanted", "error", "says"),
    [
        ({"noise": (-0.1,)}, ConfigError, "noise must be a list of numbers from 0 to inf that differ"),
        ({"noise": (math.nan,)}, ConfigError, "noise must be"),
        ({"occlusion": (0.1, 1.5)}, ConfigError, "from 0 to 1"),
        ({"bars": 0}, ConfigError, "bars must be a whole number from 1"),
        ({"bar_colour": "white"}, ConfigError, "bar_colour must be black or grey or mean, got 'white'"),
        ({"bar_place": 1.5}, ConfigError, "bar_place must be a number from 0 to 1, or null, got 1.5"),
        ({"turn": (5, 5)}, ConfigError, "turn must be .* that differ"),
        ({"turn": (5,)}, ConfigError, "cannot be turned"),
        ({"strengths": (2,)}, ConfigError, "from -1 to 1"),
        ({"effects": ("bulbs",)}, AugmentError, "did you mean 'bulb'"),
        ({"effects": ("bulb",), "strengths": ()}, ConfigError, "no levels at all"),
    ],
)
def test_what_makes_no_sense_is_refused(wanted: dict, error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says):
        Robustness(**wanted).disturbances(circular=False)


def test_unchanged_images_are_located_once(images: np.ndarray) -> None:
    asked = []

    def locate(changed: np.ndarray) -> Answer:
        asked.append(changed)
        return Answer(np.full(3, len(asked)), np.zeros(3), np.zeros(3))

    wanted = [Disturbance("noise", (0, 0.01), "noise"), Disturbance("turn", (0, 90, 360), "turn")]
    found = locate_disturbed(locate, images, ROWS, wanted)
    assert len(asked) == 3
    assert list(found) == [("noise", 0), ("noise", 0.01), ("turn", 0), ("turn", 90), ("turn", 360)]
    assert found["turn", 0].nearest is found["noise", 0].nearest is found["turn", 360].nearest
    assert found["turn", 90].nearest[0] != found["noise", 0.01].nearest[0]
    # What a robot that turned left by 90 degrees sees is reported with its heading before it turned.
    np.testing.assert_allclose(found["turn", 90].heading, -np.pi / 2)
    np.testing.assert_allclose(found["turn", 0].heading, 0)


def test_curves_are_those_of_a_loop_over_the_answers() -> None:
    rng = np.random.default_rng(1)
    known, queries = frames([0, 1, 2, 3]), frames([0.2, 1.4, 2.9, 8.0])
    wanted = [Disturbance("noise", (0, 0.5), "noise"), Disturbance("bulb", (0, 1), "effect")]
    none = np.full(4, np.nan)
    found = {(one.name, level): Answer(rng.integers(0, 4, 4), none, none) for one in wanted for level in one.levels}
    columns = concatenated([answers("a", known, queries, found), answers("b", known, queries, found)])
    table = curves(columns, 0.5, 4)
    assert len(table["method"]) == 8
    for i in range(8):
        match = found[table["disturbance"][i], table["level"][i]].nearest
        errors = [abs(known.x[m] - x) for m, x in zip(match, queries.x, strict=True)]
        assert table["mean"][i] == pytest.approx(sum(errors) / 4)
        assert table["median"][i] == pytest.approx(sum(sorted(errors)[1:3]) / 2)
        assert table["within"][i] == sum(error <= 0.5 for error in errors)
        assert table["share"][i] == table["within"][i] / 4
        assert (table["queries"][i], table["map_frames"][i], table["answerable"][i]) == (4, 4, 3)
        assert table["floor"][i] == pytest.approx((0.2 + 0.4 + 0.1 + 5) / 4)
        assert table["excess"][i] == pytest.approx(table["mean"][i] - table["floor"][i])
        assert table["hit_rate"][i] == sum(m == n for m, n in zip(match, (0, 1, 3, 3), strict=True)) / 4
    told = measures(table, [one.plain() for one in wanted], "m", 2)
    assert told["queries"] == 4
    assert told["radius"] == 0.5
    assert told["methods"]["b"]["bulb"][1]["mean"] == table["mean"][-1]
    assert [one["levels"] for one in told["disturbances"]] == [[0, 0.5], [0, 1]]


def test_headings_are_measured_by_the_frame_found_and_by_the_nearest_one() -> None:
    images = siamloc.data.example()
    monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
    known = siamloc.maps.build("hog", images, monday, progress=False)
    result = siamloc.evaluation.robustness(known, images, tuesday, every=1, noise=(0, 0.01), occlusion=(), turn=(90,))
    rows, hog = result.tables["answers"], known.descriptor
    drawn = {"noise": Disturbance("noise", (0, 0.01), "noise"), "turn": Disturbance("turn", (90,), "turn")}
    panoramas = images.batch(images.rows(tuesday))
    for name, level in (("noise", 0), ("noise", 0.01), ("turn", 90)):
        part = (rows["disturbance"] == name) & (rows["level"] == level)
        described = hog.describe(drawn[name].apply(panoramas, level, np.arange(len(tuesday))))
        for i in range(len(tuesday)):
            apart = [math.dist(xy, tuesday.xy[i]) for xy in monday.xy.tolist()]
            nearest = monday.path.tolist().index(rows["match_path"][part][i])
            for column, frame in (("heading_error", nearest), ("heading_error_nearest", int(np.argmin(apart)))):
                one = hog.relative_heading(described.take([i]), known.description.take(np.array([frame])))[0]
                turned = math.radians(level) if name == "turn" else 0.0
                wrong = math.degrees(monday.theta[frame] + one - turned - tuesday.theta[i])
                wrong = abs((wrong + 180) % 360 - 180)
                assert rows[column][part][i] == pytest.approx(wrong, abs=1e-6)
    told = result.measures["methods"]["hog"]["noise"][0]
    assert told["heading_nearest"] == pytest.approx(rows["heading_error_nearest"][:12].mean())
    assert result.cost["describe_ms"] > 0
