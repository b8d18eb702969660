"""A made-up flat of square rooms with striped walls, drawn column by column: small data for end-to-end tests."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np

ROOMS = ("kitchen", "office", "corridor")
SIDE = 4.0
_GAIN = {"cloudy": 1.0, "night": 0.6, "sunny": 1.3}


def written(folder: Path, pictures: Iterable[np.ndarray]) -> list[str]:
    """Write pictures, BGR, as 0.png, 1.png and so on, and return their paths."""
    paths = []
    for number, picture in enumerate(pictures):
        paths.append(str(folder / f"{number}.png"))
        cv2.imwrite(paths[-1], picture)
    return paths


def draw_panorama(x: float, y: float, theta: float, room: str, lighting: str = "cloudy", size=(32, 128)) -> np.ndarray:
    """Return the panorama (H, W, 3) uint8, BGR, seen from a point of a room; the room's centre is the origin."""
    rows, columns = size
    azimuth = theta + (columns / 2 - np.arange(columns) - 0.5) * 2 * np.pi / columns
    direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    position = np.array([x, y])
    with np.errstate(divide="ignore"):
        reach = np.where(direction > 0, SIDE / 2 - position, -SIDE / 2 - position) / direction
    distance = reach.min(axis=1)
    hit = position + distance[:, None] * direction
    axis = reach.argmin(axis=1)
    wall = 2 * axis + (np.take_along_axis(direction, axis[:, None], axis=1)[:, 0] > 0)
    along = np.take_along_axis(hit, 1 - axis[:, None], axis=1)[:, 0] + SIDE / 2
    rng = np.random.default_rng([7, ROOMS.index(room)])
    palette = rng.uniform(30, 225, (4, 8, 3))
    stripe = np.clip((along / SIDE * 8).astype(int), 0, 7)
    colour = palette[wall, stripe]
    elevation = np.linspace(0.8, -0.8, rows)[:, None]
    on_wall = np.abs(np.tan(elevation)) < 1.3 / distance[None]
    floor, ceiling = rng.uniform(40, 160, 3), rng.uniform(150, 240, 3)
    outside = np.where(elevation[..., None] < 0, floor, ceiling)
    picture = np.where(on_wall[..., None], colour[None], outside)
    return np.clip(picture * _GAIN[lighting], 0, 255).astype(np.uint8)


def draw_sequence(seed: int, frames_per_room: int, rooms=ROOMS) -> list[dict[str, float | str]]:
    """Return poses along a wandering path through the rooms, in the frame of the flat."""
    rng = np.random.default_rng(seed)
    poses = []
    for number, room in enumerate(rooms):
        phase = rng.uniform(0, 0.3)
        for step in range(frames_per_room):
            angle = phase + 2 * np.pi * step / frames_per_room
            x, y = 1.2 * np.cos(angle), 1.2 * np.sin(angle)
            poses.append({"room": room, "local_x": x, "x": x + SIDE * number, "y": y, "theta": angle})
    return poses


def write_manifest(folder: Path, sequences: dict[str, str], frames_per_room: int = 6, rooms=ROOMS) -> Path:
    """Draw sequences (name -> lighting) into a folder and return the path of their manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / "manifest.csv"
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["image", "x", "y", "theta", "room", "sequence", "lighting", "time"])
        for number, (name, lighting) in enumerate(sequences.items()):
            (folder / name).mkdir(exist_ok=True)
            for time, pose in enumerate(draw_sequence(number, frames_per_room, rooms)):
                picture = draw_panorama(pose["local_x"], pose["y"], pose["theta"], pose["room"], lighting)
                image = f"{name}/{time:04d}.png"
                cv2.imwrite(str(folder / image), picture)
                writer.writerow([image, pose["x"], pose["y"], pose["theta"], pose["room"], name, lighting, time])
    return table


def write_cold(part: Path, drives: dict[str, int], frames_per_room: int, size: tuple[int, int]) -> None:
    """Draw drives (name such as "night1" -> seed) in COLD's layout into the folder of a part."""
    codes = {"kitchen": "KT-A", "office": "1PO-A", "corridor": "CR-A"}
    for drive, seed in drives.items():
        folder, rows = part / f"seq2_{drive}", []
        for time, pose in enumerate(draw_sequence(seed, frames_per_room)):
            name = f"t{1000 + time}.0_x{pose['x']:.6f}_y{pose['y']:.6f}_a{pose['theta']:.6f}.jpeg"
            place = pose["local_x"], pose["y"], pose["theta"], pose["room"]
            (folder / "omni_cam").mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / "omni_cam" / name), draw_panorama(*place, drive[:-1], size=size))
            rows.append(f"{name} {codes[pose['room']]}\n")
        (folder / "localization").mkdir()
        (folder / "localization" / "places.lst").write_text("".join(rows))


def write_rows(path: Path, rows: list[dict[str, str]]) -> Path:
    """Write the rows of a manifest, and return its path."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def altered(manifest: Path, name: str, change: Callable[[dict[str, str]], dict[str, str]]) -> Path:
    """Write a manifest next to another, with every row changed by a function, and return its path."""
    with manifest.open(newline="") as file:
        return write_rows(manifest.parent / name, [{**row, **change(row)} for row in csv.DictReader(file)])
