"""Parameters to compare the descriptors with, across the ranges of [T] table 3.1, and the sizes of table 3.2."""

from __future__ import annotations


def named(keys, *rows):
    return [dict(zip(keys.split(), row, strict=True)) for row in rows]


FS = "rows columns orientation_rows orientation_columns turns"
HOG = "rows bins window step orientation_bins"
GIST = "blocks orientations window step orientation_filters orientation_levels normalized"
HSV = "rows hues saturations values window step"
RADON = "step size lines orientation_lines"

# For heights that 16 divides and widths that 64 divides.
SWEEP = {
    "fs": named(FS, (1, 1, 1, 32, 64), (4, 8, 8, 5, 64), (16, 32, 4, 16, 128), (8, 3, 16, 8, 16)),
    "hog": named(HOG, (1, 8, 64, 8, 32), (4, 32, 6, 2, 16), (16, 7, 1, 1, 9), (8, 16, 5, 4, 11)),
    "gist": named(
        GIST,
        (1, 4, 8, 2, 4, 1, True),
        (4, 5, 3, 1, 3, 2, True),
        (8, 8, 16, 8, 16, 2, False),
        (16, 2, 1, 4, 5, 1, False),
    ),
    "wisurf": named("rows windows sampling", (1, 2, "surf"), (1, 64, "pixels"), (2, 16, "pixels"), (4, 32, "pixels")),
    "briefgist": named("rows columns", (1, 64), (2, 16), (8, 2), (16, 8)),
    "radon_fourier": named(RADON, (15.0, 16, 4, 8), (4.0, 32, 16, 2), (3.0, 24, 1, 12), (120.0, 8, 4, 4)),
    "radon_poc": named("step size", (15.0, 16), (4.0, 32), (2.5, 12), (120.0, 8)),
    "hsv": named(HSV, (1, 1, 1, 2, 1, 1), (4, 12, 4, 8, 6, 2), (16, 7, 3, 5, 64, 8), (8, 24, 8, 1, 5, 4)),
}
# For 12 x 45 pixels.
ODD = {
    "fs": named(FS, (3, 7, 4, 22, 45), (12, 20, 6, 4, 15)),
    "hog": named(HOG, (3, 5, 7, 3, 9), (4, 16, 2, 5, 3)),
    "gist": named(GIST, (3, 7, 4, 5, 3, 1, True), (4, 3, 9, 3, 4, 2, False)),
    "wisurf": named("rows windows sampling", (1, 15, "pixels"), (3, 9, "surf")),
    "briefgist": named("rows columns", (6, 15), (1, 45)),
    "radon_fourier": named(RADON, (8.0, 20, 5, 2), (7.2, 14, 7, 7)),
    "radon_poc": named("step size", (8.0, 14), (7.2, 20)),
    "hsv": named(HSV, (3, 5, 7, 3, 9, 3), (4, 16, 2, 5, 3, 5)),
}
SHAPES = {  # [T] table 3.2 for images of a width
    "fs": lambda p, w: ((p["rows"], p["columns"]), (p["orientation_rows"], p["orientation_columns"])),
    "hog": lambda p, w: ((p["rows"] * p["bins"],), (w // p["step"], p["orientation_bins"])),
    "gist": lambda p, w: (
        (2 * p["blocks"] * p["orientations"],),
        (w // p["step"], p["orientation_levels"] * p["orientation_filters"]),
    ),
    "wisurf": lambda p, w: ((p["rows"] * p["windows"] * 64,), (p["windows"], p["rows"] * 64)),
    "briefgist": lambda p, w: ((p["rows"] * p["columns"],), (p["columns"], p["rows"])),
    "radon_fourier": lambda p, w: (
        (round(360 / p["step"]), p["lines"]),
        (round(360 / p["step"]), p["orientation_lines"]),
    ),
    "hsv": lambda p, w: (
        (p["rows"] * (p["hues"] * p["saturations"] + p["values"]),),
        (w // p["step"], p["hues"] + p["values"]),
    ),
    "radon_poc": lambda p, w: ((round(360 / p["step"]), p["size"] // 2),) * 2,
}
