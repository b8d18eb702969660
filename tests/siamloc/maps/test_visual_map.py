from __future__ import annotations

import copy
import json
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import analytic
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import History, VisualMap
from siamloc.maps.search import VectorIndex

IDENTITY = {"name": "network", "branch": {"name": "vgg16", "weights": None}, "width": 3}


def make_map(n: int = 6) -> VisualMap:
    rng = np.random.default_rng(0)
    frames = FrameTable(
        path=np.array([f"räume/../t{i}.jpeg" for i in range(n)]),
        x=rng.normal(size=n),
        y=np.where(np.arange(n) == n - 1, np.nan, 1.0),
        room=np.array(["KT-A"] * n),
        lighting=np.array([""] * n),
        unit="frames",
    )
    return VisualMap(rng.normal(size=(n, 3)), frames, IDENTITY, distance="cosine")


def test_round_trip(tmp_path: Path) -> None:
    saved = make_map()
    saved.save(tmp_path / "deep" / "map.npz")
    loaded = VisualMap.load(tmp_path / "deep" / "map.npz")
    np.testing.assert_array_equal(loaded.descriptors, saved.descriptors)
    assert loaded.frames == saved.frames
    assert (loaded.identity, loaded.distance) == (IDENTITY, "cosine")
    assert loaded.unit == loaded.frames.unit == "frames"
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["map.npz"]


def test_equal_maps_give_equal_files(tmp_path: Path) -> None:
    make_map().save(tmp_path / "a.npz")
    make_map().save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_map_knows_its_descriptor(tmp_path: Path) -> None:
    hog = analytic.descriptor("hog", rows=2)
    frames = FrameTable(path=["a.png", "b.png"])
    hog_map = VisualMap(np.eye(2), frames, {**hog.identity, "images": {"height": 16, "width": 64, "camera": None}})
    hog_map.save(tmp_path / "map.npz")
    assert VisualMap.load(tmp_path / "map.npz").descriptor == hog
    assert VisualMap.load(tmp_path / "map.npz", hog).descriptor is hog
    with pytest.raises(ConfigError, match=r"rows is 2 in the map, 4 here.*build the map again"):
        VisualMap.load(tmp_path / "map.npz", analytic.descriptor("hog", rows=4))
    learned = make_map()
    assert not learned.aligned
    with pytest.raises(ConfigError, match="described by 'network', which it does not hold"):
        learned.descriptor  # noqa: B018


def test_frames_join_and_leave_a_map_with_their_counts(tmp_path: Path) -> None:
    known = make_map()
    more = replace(known.frames, path=np.array([f"new/{i}.jpeg" for i in range(6)]), sequence=np.array(["night"] * 6))
    known = replace(known, history=History(np.arange(6), 2 * np.arange(6), np.full(6, 0.5)))
    grown = known.add(more, analytic.Description(np.ones((6, 3))))
    np.testing.assert_array_equal(grown.descriptors[6:], np.ones((6, 3)))
    assert grown.history.confirmed.tolist() == [0, 1, 2, 3, 4, 5, 0, 0, 0, 0, 0, 0]
    grown.save(tmp_path / "map.npz")
    grown = VisualMap.load(tmp_path / "map.npz")
    left = grown.without(grown.frames.select(sequence="night")).without([0])
    assert left.frames == known.frames.take(slice(1, None))
    assert left.history.contradicted.tolist() == [2, 4, 6, 8, 10]
    assert left.without(left.frames.x > 1e9).history.confirmed.tolist() == [1, 2, 3, 4, 5]
    with pytest.raises(DataError, match=r"6 frames are in both maps, such as .*new/0.jpeg: leave them out of one"):
        grown.add(more, analytic.Description(np.ones((6, 3))))
    with pytest.raises(DataError, match="6 of 6 frames to leave out are not in the map"):
        known.without(more)
    with pytest.raises(DataError, match="all 6 frames of the map would be left out"):
        known.without(np.arange(6))
    with pytest.raises(DataError, match="got 6 for 2 frames"):
        known.add(more.take([0, 1]), analytic.Description(np.ones((6, 3))))
    with pytest.raises(DataError, match="descriptors of 2 numbers do not fit a map of 3"):
        known.add(more, analytic.Description(np.ones((6, 2))))
    with pytest.raises(ConfigError, match=r"described differently.*width is 3 in the map, 4 here"):
        known.merge(replace(known, identity={**IDENTITY, "width": 4}))
    with pytest.raises(ConfigError, match="other must be a VisualMap"):
        known.merge(None)  # type: ignore[arg-type]


def test_added_frames_keep_what_headings_need() -> None:
    hog = analytic.descriptor("hog", rows=2)
    seen = hog.describe(np.random.default_rng(0).integers(0, 256, (4, 16, 64)).astype(np.uint8))
    known = VisualMap(
        seen.position[:1], FrameTable(path=["a.png"]), hog.identity, orientation=seen.orientation[:1], describes=hog
    )
    grown = known.add(FrameTable(path=["b.png", "c.png", "d.png"]), seen.take([1, 2, 3]))
    np.testing.assert_array_equal(grown.orientation, seen.orientation)


def test_a_map_without_frames_or_positions_says_so() -> None:
    with pytest.raises(DataError, match=r"n and D at least 1, got float32 \(0, 3\)"):
        make_map().take([])
    assert len(make_map().placed()) == 5
    with pytest.raises(DataError, match="no map frame has a position"):
        VisualMap([[1.0]], FrameTable(path=["a.png"])).placed()


def test_copies_are_equal_and_read_only_too() -> None:
    known = make_map()
    known = replace(known, orientation=known.descriptors.reshape(6, 3, 1))
    for same in (copy.deepcopy(known), pickle.loads(pickle.dumps(known))):
        assert same.digest == known.digest
        assert same.bytes == known.bytes  # descriptors and orientation parts share their values
        for array in (same.descriptors, same.orientation, same.frames.x, same.history.change):
            assert not array.flags.writeable


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16, torch.int64])
def test_queries_may_be_tensors(dtype) -> None:
    known = VisualMap(np.eye(3), FrameTable(path=["a.png", "b.png", "c.png"]))
    query = torch.tensor([[0, 1, 0]], dtype=dtype, requires_grad=dtype.is_floating_point)
    assert known.search(query).indices.tolist() == [[1]]


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32])
def test_orientation_parts_may_be_tensors_whose_precision_stays(dtype) -> None:
    parts = torch.ones(2, 2, 2, dtype=dtype, requires_grad=True)
    known = VisualMap(np.eye(2), FrameTable(path=["a.png", "b.png"]), orientation=parts)
    assert known.orientation.dtype.name == str(dtype).removeprefix("torch.")


def test_tensors_of_float64_are_searched_in_float64() -> None:
    near = torch.tensor([[0.0], [1e-9], [2e-9]], dtype=torch.float64) + 1
    assert VectorIndex(near).search(near[2:], 3).indices.tolist() == [[2, 1, 0]]


def test_a_map_of_a_tensor_keeps_its_values() -> None:
    vectors = torch.ones(6, 3, requires_grad=True)
    known = VisualMap(vectors, make_map().frames)
    with torch.no_grad():
        vectors += 1
    assert (known.descriptors == 1).all()
    assert (VisualMap(torch.ones(6, 3, dtype=torch.bfloat16), make_map().frames).descriptors == 1).all()


@pytest.mark.parametrize(
    ("descriptors", "names", "distance", "error", "message"),
    [
        (np.empty((0, 3)), [], "euclidean", DataError, "n and D at least 1, got float64 (0, 3)"),
        (np.ones((2, 3)), ["a"], "euclidean", DataError, "got 2 for 1 frames"),
        (np.ones(3), ["a"], "euclidean", DataError, "got float64 (3,)"),
        ([[1.0], [np.nan]], ["a.png", "b.png"], "euclidean", DataError, "the first that of b.png"),
        (np.full((1, 2), "a"), ["a"], "euclidean", DataError, "descriptors that are real numbers"),
        (np.full((1, 2), 1j), ["a"], "euclidean", DataError, "got complex128 (1, 2)"),
        (np.full((1, 2), 1.0, object), ["a"], "euclidean", DataError, "got object (1, 2)"),
        (np.ones((1, 3)), ["a"], "cosin", ConfigError, "did you mean 'cosine'"),
    ],
)
def test_maps_that_cannot_be(
    descriptors: np.ndarray, names: list[str], distance: str, error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as raised:
        VisualMap(descriptors, FrameTable(path=np.array(names, dtype=np.str_)), distance=distance)
    assert message in str(raised.value)


def test_check_descriptor_names_what_differs() -> None:
    visual_map = make_map()
    visual_map.check_descriptor({"width": 3, "branch": {"weights": None, "name": "vgg16"}, "name": "network"})
    with pytest.raises(ConfigError) as raised:
        visual_map.check_descriptor({"name": "network", "branch": {"name": "alexnet", "weights": None}, "hash": "ab"})
    message = str(raised.value)
    assert "branch.name is 'vgg16' in the map, 'alexnet' here" in message
    assert "width is 3 in the map, absent here" in message
    assert "hash is absent in the map, 'ab' here" in message
    assert "weights" not in message
    assert "Describe the queries with the map's model" in message


def test_how_images_became_panoramas_is_compared_where_both_say_it_and_by_a_merge_always() -> None:
    known = replace(make_map(), identity={**IDENTITY, "images": {"camera": "ring"}})
    known.check_descriptor(IDENTITY)
    with pytest.raises(ConfigError, match=r"images.camera is 'ring' in the map, 'fisheye' here"):
        known.check_descriptor({**IDENTITY, "images": {"camera": "fisheye"}})
    with pytest.raises(ConfigError, match=r"images.camera is 'ring' in the map, absent here"):
        known.merge(make_map())


def rewritten(source: Path, target: Path, **changes: object) -> Path:
    with np.load(source) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(str(arrays["header"]))
    header.update(changes.pop("header", {}))  # type: ignore[call-overload]
    arrays["header"] = np.array(json.dumps(header))
    for name, value in changes.items():
        if value is None:
            del arrays[name]
        else:
            arrays[name] = np.asarray(value)
    np.savez(target, **arrays)
    return target


def test_load_refuses_what_is_not_a_whole_map(tmp_path: Path) -> None:
    good = tmp_path / "good.npz"
    make_map().save(good)
    cases: dict[Path, str] = {tmp_path / "absent.npz": "does not exist", tmp_path: "does not exist"}
    contents = good.read_bytes()
    for cut in (0, 3, 100, len(contents) // 2, len(contents) - 1):
        path = tmp_path / f"cut{cut}.npz"
        path.write_bytes(contents[:cut])
        cases[path] = "not a whole one"
    flipped = bytearray(contents)
    flipped[contents.index(make_map().descriptors.tobytes()) + 2] ^= 0xFF
    (tmp_path / "flipped.npz").write_bytes(flipped)
    cases[tmp_path / "flipped.npz"] = "not a whole one"
    (tmp_path / "text.npz").write_text("hello")
    cases[tmp_path / "text.npz"] = "not a siamloc map"
    np.save(tmp_path / "single.npy", np.ones(3))
    cases[tmp_path / "single.npy"] = "not a siamloc map"
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    cases[tmp_path / "other.npz"] = "not a siamloc map"
    np.savez(tmp_path / "pickled.npz", header=np.array([{"format": "siamloc map"}], dtype=object))
    cases[tmp_path / "pickled.npz"] = "not a siamloc map"
    newer = rewritten(good, tmp_path / "newer.npz", header={"version": 3})
    cases[newer] = "format version 3, this siamloc reads version 2: update siamloc"
    older = rewritten(good, tmp_path / "older.npz", header={"version": 1})
    cases[older] = "format version 1, this siamloc reads version 2: build the map again"
    oldest = rewritten(good, tmp_path / "oldest.npz", header={"format": "siamloc-map", "version": 1})
    cases[oldest] = "was written by an older siamloc: build the map again with `siamloc map`"
    cases[rewritten(good, tmp_path / "short.npz", descriptors=np.ones((2, 3)))] = "got 2 for 6 frames"
    cases[rewritten(good, tmp_path / "lacking.npz", descriptors=None)] = "not a whole siamloc map ('descriptors')"
    parts = {"orientation": np.ones((6, 2, 2), np.float16), "heading": {"name": "hog"}}
    replace(make_map(), **parts).save(tmp_path / "headed.npz")
    cases[rewritten(tmp_path / "headed.npz", tmp_path / "cut.npz", heading=None)] = "not a whole siamloc map"
    cases[rewritten(good, tmp_path / "extra.npz", frame_colour=np.ones(6))] = "not a whole siamloc map"
    cases[rewritten(good, tmp_path / "lies.npz", header={"width": 9})] = "announces descriptors (6, 9) and holds (6, 3)"
    for path, message in cases.items():
        with pytest.raises(FormatError) as raised:
            VisualMap.load(path)
        assert message in str(raised.value), path
        assert str(path) in str(raised.value)
        assert "\n" not in str(raised.value)


def test_maps_and_tasks_do_not_load_torch() -> None:
    code = (
        "import sys, siamloc.maps.visual_map, siamloc.evaluation.absolute, siamloc.evaluation.room_retrieval\n"
        "import siamloc.report\n"
        "import siamloc.results\n"
        "print(sorted({'torch', 'lightning', 'pandas', 'matplotlib', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
