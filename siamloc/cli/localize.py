"""`siamloc localize`: locate image files with an exported bundle."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

from omegaconf import DictConfig

from siamloc.cli.steps import finished_run, images_named
from siamloc.errors import DataError
from siamloc.files import write_text
from siamloc.runtime import Localizer, Location


def main(config: DictConfig) -> None:
    """Locate the images, print a line for each and write them to a CSV file."""
    run = finished_run(config)
    folder = Path(config.bundle) if config.bundle is not None else run.bundle
    images = images_named(config.images)
    localizer = Localizer(folder, top=config.top)
    rows, failed = [], []
    for path in images:
        try:
            location = localizer.locate(path)
        except DataError as error:
            if config.data.on_error == "raise":
                raise
            failed.append(str(error))
            continue
        rows.append(_row(path, location))
        print(_line(path, location, localizer.unit))
    for message in failed:
        print(f"left out: {message}")
    if not rows:
        raise DataError(f"none of the {len(images)} images could be read")
    target = run.folder / "locations.csv" if config.bundle is None else Path("locations.csv")
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(target, text.getvalue())
    print(f"{len(rows)} of {len(images)} images located: {target}")


def _row(path: Path, location: Location) -> dict[str, object]:
    best = location.candidates[0]
    return {
        "image": str(path),
        "x": _cell(location.x),
        "y": _cell(location.y),
        "theta": _cell(location.theta),
        "room": location.room,
        "error_m": _cell(location.error_m),
        "lost": "" if location.lost is None else location.lost,
        "match": best.image,
        "distance": best.distance,
        "ms": round(location.ms, 2),
    }


def _cell(value: float) -> object:
    return "" if math.isnan(value) else value


def _line(path: Path, location: Location, unit: str) -> str:
    heading = "" if math.isnan(location.theta) else f", heading {math.degrees(location.theta):.0f} deg"
    room = f" in {location.room}" if location.room else ""
    expected = "" if math.isnan(location.error_m) else f"; expected error {location.error_m:.2f} {unit}"
    lost = ", lost" if location.lost else ""
    others = ", ".join(f"{Path(c.image).name} ({c.distance:.3g})" for c in location.candidates)
    known = not (math.isnan(location.x) or math.isnan(location.y))
    position = f"x {location.x:.2f} {unit}, y {location.y:.2f} {unit}" if known else "position unknown"
    return f"{path}: {position}{heading}{room}{expected}{lost}; nearest {others}; {location.ms:.1f} ms"
