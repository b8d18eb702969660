"""Files of every kind that siamloc reads, and ways of damaging them."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from foundation.files import file_hash, read_json, write_json
from siamloc.data import FrameTable

SIZE = (16, 64)
WAYS = ("flipped", "cut", "repeated", "swapped", "grafted", "emptied", "lengthened", "numbers", "nested", "leaves")
_STRANGE: tuple[Any, ...] = (3, -1, 1e300, True, None, "", "x", "${oc.env:HOME}", [], [["a"]], [{}], {}, {"a": 1}, "\0")


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        write: makes a file at a path, or in a folder of that name, and returns the file's own path.
        read: reads the file, as far as siamloc does.
    """

    write: Callable[[Path], Path]
    read: Callable[[Path], Any]


def damaged(content: bytes, others: list[bytes], chance: random.Random) -> tuple[str, bytes]:
    """Damage a file, and return how, and its damaged content."""
    how = chance.choice(WAYS)
    held, size = bytearray(content), max(len(content), 1)
    at = chance.randrange(size)
    if how == "flipped":
        for _ in range(chance.choice([1, 1, 4, 64])):
            held[chance.randrange(size)] ^= 1 << chance.randrange(8)
    elif how == "cut":
        held = held[:at]
    elif how == "repeated":
        held = held[:at] + held[max(0, at - chance.randrange(1, 200)) :]
    elif how == "swapped":
        other = chance.randrange(size)
        length = min(chance.randrange(1, 64), size - max(at, other))
        held[at : at + length], held[other : other + length] = held[other : other + length], held[at : at + length]
    elif how == "grafted":
        other = chance.choice(others)
        held = held[:at] + bytearray(other[chance.randrange(max(len(other), 1)) :][: chance.randrange(1, 4096)])
    elif how == "emptied":
        held = bytearray() if chance.random() < 0.3 else bytearray(len(content))
    elif how == "lengthened":
        held += bytes(chance.randrange(256) for _ in range(chance.randrange(1, 300)))
    elif how == "numbers":
        strange = [b"nan", b"-1", b"1e400", b"999999999999999999999", b'"x"', b"null", b"", b"[]", b"true", b"{}"]
        found = list(re.finditer(rb"-?\d+(\.\d+)?", content))
        if found:
            one = chance.choice(found)
            held = bytearray(content[: one.start()] + chance.choice(strange) + content[one.end() :])
    elif how == "leaves":
        held = bytearray(_with_a_leaf(content, chance))
    else:
        held = bytearray(b"[" * chance.choice([10, 100_000]) + content)
    return how, bytes(held)


def _with_a_leaf(content: bytes, chance: random.Random) -> bytes:
    """Return a JSON file with one value at any depth replaced with one of another kind; other files as they are."""
    try:
        held = json.loads(content)
    except ValueError:
        return content
    node, places = held, []
    while isinstance(node, dict | list) and node:
        place = chance.choice(list(node)) if isinstance(node, dict) else chance.randrange(len(node))
        places.append((node, place))
        node = node[place]
    if places:
        parent, place = chance.choice(places)
        parent[place] = chance.choice(_STRANGE)
    return json.dumps(held).encode()


def _frames() -> tuple[Any, FrameTable]:
    images = siamloc.data.example()
    return images, images.frames.select(sequence="monday")


def _network() -> siamloc.models.Network:
    return siamloc.models.build("simple1", "flat", SIZE, outputs=8)


def _known() -> siamloc.maps.VisualMap:
    return siamloc.maps.build("hog", *_frames(), progress=False)


def _saved(name: str, make: Callable[[], Any], pick: str = "") -> Callable[[Path], Path]:
    """Return a function that saves an object under a name in its own folder and returns the path of one file."""

    def write(path: Path) -> Path:
        path.mkdir(parents=True, exist_ok=True)
        target = path / name if name else path
        make().save(target)
        return target / pick if pick else target

    return write


def _write_image(path: Path) -> Path:
    import cv2

    target = path.with_suffix(".jpeg")
    cv2.imwrite(str(target), np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8))
    return target


def _write_manifest(path: Path) -> Path:
    path.mkdir(parents=True)
    image = _write_image(path / "a")
    rows = [f"{image.name},{n}.5,{-n},0.{n},room{n % 2},day,cloudy,{n}" for n in range(6)]
    target = path / "robot.csv"
    target.write_text("\n".join(["image,x,y,theta,room,sequence,lighting,time", *rows]) + "\n")
    return target


def _write_places(path: Path) -> Path:
    folder = path / "part_a" / "seq2_cloudy1"
    (folder / "std_cam").mkdir(parents=True)
    (folder / "localization").mkdir()
    names = [f"t{n}.500000_x{n}.25_y-1.5_a0.{n}.jpeg" for n in range(5)]
    for name in names:
        _write_image(folder / "std_cam" / name)
    target = folder / "localization" / "places.lst"
    target.write_text("\n".join(f"{name} CR-A" for name in names) + "\n")
    return target


def _read_places(path: Path) -> Any:
    return siamloc.data.read("cold", root=path.parents[3], camera="std_cam")


def _result() -> siamloc.evaluation.Result:
    images, monday = _frames()
    known = siamloc.maps.build("hog", images, monday, progress=False)
    return siamloc.evaluation.localization(known, images, images.frames.select(sequence="tuesday"))


def _read_result(path: Path) -> Any:
    result = siamloc.evaluation.Result.load(path.parent)
    return result.table(), len(result)


class _Results:
    """A result, saved without pictures."""

    def save(self, folder: Path) -> None:
        _result().save(folder, pictures=False)


def _built() -> Any:
    return siamloc.maps.group(_known(), "rooms")


def _read_layer(path: Path) -> Any:
    return siamloc.maps.Built.load(path.parent)


def _errors() -> siamloc.maps.ErrorModel:
    return siamloc.maps.ErrorModel("ratio", 1.0, 5, (0.1, 0.5), (0.2, 1.0), 30, 1.0, "abc")


def _write_weights(path: Path) -> Path:
    return siamloc.models.save_weights(_network(), path.with_suffix(".safetensors"))


def _write_checkpoint(path: Path) -> Path:
    import torch

    network, target = _network(), path.with_suffix(".ckpt")
    torch.save({"state_dict": network.state_dict(), "hyper_parameters": {}}, target)
    return target


def _write_run(path: Path) -> Path:
    images, monday = _frames()
    network = siamloc.models.build("simple1", "flat", images.image_shape[1:], outputs=8)
    options: dict[str, Any] = {"epochs": 1, "batch_size": 4, "pairs": {"epoch_pairs": 8}}
    siamloc.training.fit(network, images, monday, run=path, **options)
    return path / "run.json"


def _read_run(path: Path) -> Any:
    from siamloc.cli.compose import composed

    run = siamloc.runs.Run(path.parent)
    composed("map", [f"run={path.parent}", "device=cpu", "data=manifest", "data.manifest=x.csv"])
    composed("train", [f"run={path.parent}", "resume=true", "data=manifest", "data.manifest=x.csv"])
    run.record_written([])
    siamloc.training.compare([path.parent], by="train/loss")
    return siamloc.models.load(run), run.curves()


def _write_bundle(name: str) -> Callable[[Path], Path]:
    def write(path: Path) -> Path:
        images, monday = _frames()
        network = siamloc.models.build("simple1", "flat", images.image_shape[1:], outputs=8)
        known = siamloc.maps.build(network, images, monday, progress=False)
        siamloc.runtime.export(network, known, path / "bundle", errors=_fitting(known))
        return path / "bundle" / name

    return write


def _write_analytic(name: str) -> Callable[[Path], Path]:
    """Return a function that writes a bundle of an analytic descriptor with all optional parts."""

    def write(path: Path) -> Path:
        images, monday = _frames()
        known = siamloc.maps.build("hog", images, monday, progress=False)
        layer = siamloc.maps.group(known, "rooms")
        further: dict[str, Any] = {"layer": layer, "images": images, "thumbnails": True, "precision": "int8"}
        siamloc.runtime.export(known.descriptor, known, path / "bundle", **further)
        return path / "bundle" / name

    return write


def _read_analytic(path: Path) -> Any:
    located = _read_bundle(path)
    bundle = siamloc.runtime.Bundle.open(path.parent)
    return located, bundle.summary(), bundle.thumbnail(0)


def _fitting(known: siamloc.maps.VisualMap) -> siamloc.maps.ErrorModel:
    return siamloc.maps.ErrorModel("ratio", 1.0, 5, (0.1, 0.5), (0.2, 1.0), 30, 1.0, known.digest)


def _read_bundle(path: Path) -> Any:
    """Locate with a bundle whose hashes were made to fit, as an attacker would do."""
    about_path = path.parent / "bundle.json"
    if path != about_path:
        about = read_json(about_path)
        about["sha256"][path.name] = file_hash(path)
        write_json(about_path, about)
    return siamloc.runtime.Localizer(path.parent).locate(np.full((32, 128, 3), 90, np.uint8))


def _write_building(path: Path) -> Path:
    target = path.with_suffix(".yaml")
    target.write_bytes((Path(siamloc.__file__).parents[1] / "conf" / "building" / "mini.yaml").read_bytes())
    return target


def _read_building(path: Path) -> Any:
    from siamloc.simulate.parse import read_building_file

    return read_building_file(path, 0)


FILES: dict[str, Kind] = {
    "manifest": Kind(_write_manifest, lambda path: siamloc.data.read("manifest", manifest=path)),
    "places": Kind(_write_places, _read_places),
    "image": Kind(_write_image, siamloc.data.image_files.read_image),
    "map": Kind(_saved("map.npz", _known), siamloc.maps.VisualMap.load),
    "layer": Kind(_saved("", _built, "layer.npz"), _read_layer),
    "error model": Kind(_saved("error_model.json", _errors), siamloc.maps.ErrorModel.load),
    "refinement": Kind(
        _saved("refinement.json", lambda: siamloc.maps.Refinement("relative")), siamloc.maps.Refinement.load
    ),
    "results": Kind(_saved("", _Results, "results.json"), _read_result),
    "queries": Kind(_saved("", _Results, "queries.csv"), _read_result),
    "weights": Kind(_write_weights, siamloc.models.load),
    "checkpoint": Kind(_write_checkpoint, lambda path: siamloc.models.load(path, network=_network())),
    "run": Kind(_write_run, _read_run),
    "bundle": Kind(_write_bundle("bundle.json"), _read_bundle),
    "bundle's network": Kind(_write_bundle("model.onnx"), _read_bundle),
    "bundle's map": Kind(_write_bundle("map.npz"), _read_bundle),
    "bundle's errors": Kind(_write_bundle("error_model.json"), _read_bundle),
    "bundle by hog": Kind(_write_analytic("bundle.json"), _read_analytic),
    "bundle's short map": Kind(_write_analytic("map.npz"), _read_analytic),
    "bundle's layer": Kind(_write_analytic("layer.npz"), _read_analytic),
    "bundle's pictures": Kind(_write_analytic("thumbnails.npz"), _read_analytic),
    "building": Kind(_write_building, _read_building),
}
