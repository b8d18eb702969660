import json

import numpy as np
import pytest

import analytic
from analytic import AnalyticError
from analytic.mapper import IncrementalMapper, replay
from foundation.arrays import read_arrays, write_arrays
from foundation.errors import FormatError
from tests.analytic.mapper.world import FRAMES, POSES, WIDE, WIDE_FRAMES, WORLD, World, mapped


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize(
    ("world", "frames", "parameters"),
    [
        (WORLD, FRAMES, {}),
        (WORLD, FRAMES, {"exemplars": 12, "orientation": False}),
        (WIDE, WIDE_FRAMES, {"exemplars": 12, "y": 2.5}),
    ],
    ids=["narrow", "flat", "wide"],
)
def test_going_on_after_loading_is_never_having_stopped(tmp_path, world, frames, parameters, version):
    whole, parts = (IncrementalMapper(world, version, **parameters) for _ in range(2))
    for index, frame in enumerate(frames):
        if index % 37 == 0:
            parts.save(tmp_path / "map")
            parts = IncrementalMapper.load(tmp_path / "map", world, extend=True)
        assert whole.add(frame, [index, 0]) == parts.add(frame, [index, 0])
    assert len(whole.nodes) > 1
    check_equal_files(tmp_path, whole, parts)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "1", "map"]
    assert np.array_equal(replay(parts.events), whole.labels())


def check_equal_files(folder, *mappers):
    for number, mapper in enumerate(mappers):
        mapper.save(folder / f"{number}")
    assert len({(folder / f"{number}").read_bytes() for number in range(len(mappers))}) == 1


def test_a_map_with_parked_candidates_and_modes_goes_on_too(tmp_path):
    whole = mapped(60)
    whole.maintain(0, WORLD.at(POSES[:12], lighting=2.0))
    for frame in FRAMES[60:140]:
        whole.add(frame)
    assert whole._state.parked
    whole.save(tmp_path / "map.npz")
    loaded = IncrementalMapper.load(tmp_path / "map.npz", WORLD, extend=True)
    assert [len(node.modes) for node in loaded.nodes] == [len(node.modes) for node in whole.nodes]
    assert any(len(node.modes) > 1 for node in loaded.nodes)
    for frame in FRAMES[140:]:
        assert whole.add(frame) == loaded.add(frame)
    assert whole.poses == loaded.poses


def test_a_loaded_map_is_for_asking(tmp_path):
    mapper = mapped(120)
    mapper.save(tmp_path / "map")
    loaded = IncrementalMapper.load(tmp_path / "map", WORLD)
    before = loaded.events
    with pytest.raises(AnalyticError, match="load it with extend=True"):
        loaded.add(FRAMES[0])
    with pytest.raises(AnalyticError, match="load it with extend=True"):
        loaded.maintain(0, WORLD.at(POSES[:12]))
    for frame in FRAMES[:120:7]:
        assert loaded.locate(frame) == mapper.locate(frame)
    assert loaded.events == before
    assert np.array_equal(loaded.labels(), mapper.labels())


def test_an_empty_map_can_be_stored(tmp_path):
    IncrementalMapper(WORLD, y=2.0).save(tmp_path / "map")
    loaded = IncrementalMapper.load(tmp_path / "map", WORLD, extend=True)
    assert loaded.parameters.y == 2
    for frame in FRAMES[:30]:
        loaded.add(frame)
    assert len(loaded.nodes) == 1


def test_the_descriptor_is_made_again_or_must_be_the_map_s(tmp_path):
    mapped(3).save(tmp_path / "map")
    with pytest.raises(AnalyticError, match=r"'world'.*: give that one as `descriptor`, got None"):
        IncrementalMapper.load(tmp_path / "map")
    with pytest.raises(AnalyticError, match=r"'size': 8.*: give that one .*'size': 9"):
        IncrementalMapper.load(tmp_path / "map", World(size=9))
    hog = analytic.descriptor("hog")
    mapper = IncrementalMapper(hog, 2)
    mapper.add(hog.describe(np.random.default_rng(0).random((128, 512), dtype=np.float32)))
    mapper.save(tmp_path / "hog")
    assert IncrementalMapper.load(tmp_path / "hog").descriptor.identity == hog.identity


def test_a_file_that_is_cut_short_or_changed_is_refused_or_the_same_map(tmp_path):
    mapper = mapped(25)
    mapper.save(tmp_path / "map")
    whole = (tmp_path / "map").read_bytes()
    generator = np.random.default_rng(0)
    spots = [*generator.integers(len(whole), size=60), *(len(whole) - generator.integers(1, 2500, size=300))]
    changed = [whole[:spot] + bytes([whole[spot] ^ 1 << spot % 8]) + whole[spot + 1 :] for spot in spots]
    cuts = [whole[:cut] for cut in (0, 1, 500, len(whole) // 2, len(whole) - 1)]
    refused = 0
    for content in (*cuts, *changed):
        (tmp_path / "other").write_bytes(content)
        try:
            loaded = IncrementalMapper.load(tmp_path / "other", WORLD)
        except FormatError:
            refused += 1
        else:
            assert len(content) == len(whole)
            assert loaded.events == mapper.events
    assert refused > 200


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"version": 2}, "has format version 2, .* build the map again"),
        ({"parameters": {"gamma": -1}}, "gamma must be a number above 0"),
        ({"poses": []}, "40 labels, 40 matches and 0 poses"),
        ({"labels": None}, "not a topological map, or not a whole one .*labels"),
    ],
)
def test_an_older_or_inconsistent_file_is_refused(tmp_path, changes, says):
    mapped(40).save(tmp_path / "map")
    arrays = read_arrays(tmp_path / "map")
    head = json.loads(str(arrays.pop("header"))) | changes
    write_arrays(tmp_path / "map", head, {name: array for name, array in arrays.items() if name not in changes})
    with pytest.raises(FormatError, match=says):
        IncrementalMapper.load(tmp_path / "map", WORLD)
