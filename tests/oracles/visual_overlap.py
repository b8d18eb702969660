"""The visual overlap, patch by patch: no ray is cast, and all surfaces are cut into small pieces."""

import math

import numpy as np


def visual_overlap(quads, eyes, lowest, highest, size=0.1, headings=None, field=360):
    """Sum the smaller and the larger of the solid angles of small pieces of rectangles (Q, 4, 3), for each two eyes.

    All angles are in degrees.
    """
    seen = lowest, highest, np.zeros(len(eyes)) if headings is None else headings, field
    angles = np.concatenate([_solid_angles(quads, number, eyes, *seen, size) for number in range(len(quads))])
    return np.array(
        [[np.minimum(one, other).sum() / np.maximum(one, other).sum() for other in angles.T] for one in angles.T]
    )


def _solid_angles(quads, number, eyes, lowest, highest, headings, field, size):
    """Return the solid angle (pieces, eyes) of each piece of one rectangle; 0 where it is hidden."""
    corner, along, up = _frame(quads[number])
    columns, rows = (max(1, round(np.linalg.norm(edge) / size)) for edge in (along, up))
    area = np.linalg.norm(np.cross(along, up)) / (columns * rows)
    normal = np.cross(along, up) / np.linalg.norm(np.cross(along, up))
    s, t = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows)
    pieces = corner + s.reshape(-1, 1) * along + t.reshape(-1, 1) * up
    found = np.zeros((len(pieces) * 2, len(eyes)))  # the front and the back of each piece are different surfaces
    for row, eye in enumerate(eyes):
        away = pieces - eye
        distance = np.linalg.norm(away, axis=1)
        elevation = np.degrees(np.arcsin(away[:, 2] / distance))
        seen = (elevation > lowest) & (elevation < highest)
        ahead = np.array([math.cos(math.radians(headings[row])), math.sin(math.radians(headings[row]))])
        flat = np.linalg.norm(away[:, :2], axis=1)
        seen &= away[:, :2] @ ahead >= flat * math.cos(math.radians(field / 2))
        for other in range(len(quads)):
            if other != number:
                seen &= ~_between(quads[other], eye, away)
        facing = away @ normal / distance
        angle = np.where(seen, np.abs(facing) * area / distance**2, 0)
        found[:, row] = np.concatenate([np.where(facing < 0, angle, 0), np.where(facing > 0, angle, 0)])
    return found


def _between(quad, eye, away):
    """Return True (n,) where a rectangle cuts the way from the eye to the end of a vector (n, 3)."""
    corner, along, up = _frame(quad)
    normal = np.cross(along, up)
    slope = away @ normal
    share = np.divide((corner - eye) @ normal, slope, out=np.full(len(away), math.inf), where=slope != 0)
    cut = eye + np.where(np.isfinite(share), share, 0)[:, None] * away - corner
    inside = [(cut @ edge >= 0) & (cut @ edge <= edge @ edge) for edge in (along, up)]
    return (share > 0) & (share < 1) & inside[0] & inside[1]


def _frame(quad):
    return quad[0], quad[1] - quad[0], quad[3] - quad[0]
