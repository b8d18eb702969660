"""`Location`: where an image was taken, and the map frames that it resembles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Candidate:
    """A map frame that resembles the image.

    Attributes:
        image: the map frame's file, as named in the map.
        x: position, in the unit of the map; NaN if unknown.
        y: position, as x.
        room: room of the map frame, as in `Location`.
        distance: descriptor distance from the image.
        row: row in the map, -1 if unknown; `Bundle.thumbnail` returns its thumbnail if the bundle holds any.
    """

    image: str
    x: float
    y: float
    room: str
    distance: float
    row: int = -1


@dataclass(frozen=True)
class Location:
    """Where an image was taken.

    Attributes:
        x: position, in the unit of the map: finer than the map if the bundle refines it, else the position of the
            nearest map frame; NaN if that is unknown.
        y: position, as x.
        theta: heading in rad in (-pi, pi], counter-clockwise; NaN if the bundle gives no headings, or if the heading of
            the nearest map frame is unknown.
        room: room of the map frame that looks most like the image, or "". If the map has several buildings, with the
            building before it, as in "top/office", or the building alone, "top", where the frame has no room. If a
            coarse layer is searched first, room of the nearest map frame; with a `SequenceFilter`, room of the map
            frame where the robot is tracked.
        error_m: expected error of x and y in their unit, metres by default; NaN if the bundle holds no error model, or
            if the image shows nothing of what the map shows. In a surveyed map it is the distance to where the map has
            this place, which may itself be off.
        lost: whether the expected error is above the threshold that the error model was learned with, or the image
            shows nothing of what the map shows, such as one of another building or from another camera; None without a
            threshold.
        candidates: the map frames that resemble the image most, nearest first.
        ms: total time for preparing, describing, searching and all estimates, in milliseconds.
        covariance: covariance ((xx, xy), (xy, yy)) of x and y, in their squared unit; None if unknown, as of a pose
            that is not refined in a map whose drives have one place each. That of a refined pose contains the
            deviations of a surveyed map, which `error_m` does not. If `lost` is true, it is meaningless: it is the
            covariance of a pose in the map.
        agreement: share of the examined map frames that agree on a refined pose, from 0 to 1; NaN if the pose is not
            refined.
    """

    x: float
    y: float
    theta: float
    room: str
    error_m: float
    lost: bool | None
    candidates: tuple[Candidate, ...]
    ms: float
    covariance: tuple[tuple[float, float], tuple[float, float]] | None = None
    agreement: float = math.nan

    def describe(self, unit: str = "m") -> str:
        """Return one line with where the image was taken, in the unit of x and y, and which map frames resemble it."""
        heading = "" if math.isnan(self.theta) else f", heading {round(math.degrees(self.theta))} deg"
        room = f" in {self.room}" if self.room else ""
        expected = "" if math.isnan(self.error_m) else f"; expected error {self.error_m:.2f} {unit}"
        lost = ", lost" if self.lost else ""
        others = ", ".join(f"{Path(c.image).name} ({c.distance:.3g})" for c in self.candidates)
        known = not (math.isnan(self.x) or math.isnan(self.y))
        position = f"x {self.x:.2f} {unit}, y {self.y:.2f} {unit}" if known else "position unknown"
        return f"{position}{heading}{room}{expected}{lost}; nearest {others}; {self.ms:.1f} ms"
