"""Augmentation pixel by pixel, as the formulas are written. A picture is (3, H, W), float64, 0 ... 255."""

import colorsys
import math

import numpy as np


def short_way(column, centre, width):
    """How far a column is from another one, the shorter way around."""
    steps = [column - centre + turn * width for turn in (-2, -1, 0, 1, 2)]
    return min(steps, key=abs)


def every_pixel(picture, function):
    out = np.zeros_like(picture)
    channels, height, width = picture.shape
    for c in range(channels):
        for y in range(height):
            for x in range(width):
                out[c, y, x] = function(c, y, x, picture[c, y, x])
    return np.clip(out, 0, 255)


def spot(picture, p, distance):
    _, height, width = picture.shape
    tall = p["radius"] * height / 128 / math.sqrt(p["aspect"])
    wide = tall * p["aspect"]
    rim = min(p["rim"], p["intensity"])

    def lit(c, y, x, value):
        u, v = short_way(x, p["column"], width) / wide, (y - p["row"]) / tall
        rho = distance(u, v, p)
        if rho > 1:
            return value
        amount = p["intensity"] * (1 - rho) + rim * rho
        return value + amount if p["light"] else value - amount

    return every_pixel(picture, lit)


def round_distance(u, v, p):
    return math.hypot(u, v)


def square_distance(u, v, p):
    return max(abs(u), abs(v))


def trapezoid_distance(u, v, p):
    half = (1 + p["taper"] * max(-1, min(1, v))) / (1 + abs(p["taper"]))
    return max(abs(v), abs(u) / half)


def brighten(picture, p):
    return every_pixel(picture, lambda c, y, x, value: value + p["amount"])


def darken(picture, p):
    return every_pixel(picture, lambda c, y, x, value: value - p["amount"])


def contrast(picture, p):
    return every_pixel(picture, lambda c, y, x, value: p["pivot"] + p["factor"] * (value - p["pivot"]))


def gamma(picture, p):
    return every_pixel(picture, lambda c, y, x, value: 255 * (value / 255) ** p["gamma"])


def exposure(picture, p):
    def exposed(c, y, x, value):
        v = value / 255
        light = v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4
        light = min(1.0, light * 2 ** p["stops"])
        return 255 * (12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055)

    return every_pixel(picture, exposed)


def white_balance(picture, p):
    stops = [p["temperature"] / 2 + p["tint"] / 3, -2 * p["tint"] / 3, -p["temperature"] / 2 + p["tint"] / 3]
    return every_pixel(picture, lambda c, y, x, value: value * 2 ** stops[c])


def saturate(picture, p):
    out = np.zeros_like(picture)
    for y in range(picture.shape[1]):
        for x in range(picture.shape[2]):
            hue, saturation, value = colorsys.rgb_to_hsv(*(picture[:, y, x] / 255))
            out[:, y, x] = colorsys.hsv_to_rgb(hue, min(1, saturation * p["factor"]), value)
    return out * 255


def equalize(picture, p):
    out = np.zeros_like(picture)
    for c in range(3):
        values = [int(v) for v in picture[c].ravel()]
        counts = [values.count(level) for level in range(256)]
        step = (len(values) - counts[max(values)]) // 255
        for i, v in enumerate(values):
            new = v if step == 0 else min(255, (sum(counts[:v]) + step // 2) // step)
            out[c].ravel()[i] = v + p["strength"] * (new - v)
    return out


def convolve(picture, mask, circular=True):
    """Columns wrap or repeat, rows repeat."""
    _, height, width = picture.shape
    rows, columns = len(mask) // 2, len(mask[0]) // 2

    def at(c, y, x):
        x = x % width if circular else min(max(x, 0), width - 1)
        return picture[c, min(max(y, 0), height - 1), x]

    def summed(c, y, x, value):
        total = 0.0
        for i in range(-rows, rows + 1):
            for j in range(-columns, columns + 1):
                total += mask[i + rows][j + columns] * at(c, y + i, x + j)
        return total

    return every_pixel(picture, summed)


def rotate(picture, p):
    width = picture.shape[2]
    return every_pixel(picture, lambda c, y, x, value: picture[c, y, (x - p["shift"]) % width])


def vignette(picture, p, circular=True):
    _, height, width = picture.shape
    k = 1 / math.sqrt(1 - p["strength"]) - 1

    def square(y, x):
        down = (y - p["centre"] * (height - 1)) ** 2
        return down if circular else down + (x - (width - 1) / 2) ** 2

    farthest = max(square(y, x) for y in range(height) for x in range(width))
    return every_pixel(picture, lambda c, y, x, value: value / (1 + k * square(y, x) / farthest) ** 2)


def smooth(t):
    t = min(1.0, max(0.0, t))
    return 3 * t**2 - 2 * t**3


def shadow(picture, p):
    """From the directions that pixels look in."""
    _, height, width = picture.shape
    tilt = math.radians(p["tilt"])
    towards = 2 * math.pi * p["column"] / width
    normal = np.array([math.cos(tilt) * math.cos(towards), math.cos(tilt) * math.sin(towards), math.sin(tilt)])

    def shaded(c, y, x, value):
        azimuth = 2 * math.pi * x / width
        elevation = ((height - 1) / 2 - y) * 2 * math.pi / width
        direction = np.array(
            [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
        )
        beyond = normal @ direction - p["offset"]
        return value * (1 - p["depth"] * smooth(beyond / p["softness"] + 0.5))

    return every_pixel(picture, shaded)


def sun_patch(picture, p):
    """From the points of the floor, one camera height below, that pixels look at."""
    _, height, width = picture.shape
    sun, pixel = (1.0, 0.93, 0.78), 2 * math.pi / width
    turn = math.radians(p["turn"])

    def lit(c, y, x, value):
        below = (y - p["horizon"] * (height - 1)) * pixel
        if below <= 1e-3:
            return value
        reach = 1 / math.tan(below)
        azimuth = short_way(x, p["column"], width) * pixel
        point = np.array([reach * math.cos(azimuth) - p["distance"], reach * math.sin(azimuth)])
        along = abs(point @ [math.cos(turn), math.sin(turn)]) / (p["length"] / 2)
        across = abs(point @ [-math.sin(turn), math.cos(turn)]) / (p["breadth"] / 2)
        inside = smooth((1 - along) / 0.12) * smooth((1 - across) / 0.12)
        panes = smooth((along - 0.05) / 0.05) * smooth((across - 0.05) / 0.05)
        return value * (1 + (p["gain"] - 1) * sun[c] * inside * panes)

    return every_pixel(picture, lit)


def relight(picture, p):
    """Stops of light at each viewing direction; a pixel is light to the power of 1 / 2.2."""
    _, height, width = picture.shape

    def lit(c, y, x, value):
        azimuth = 2 * math.pi * short_way(x, p["column"], width) / width
        above = 1 - 2 * y / (height - 1)
        stops = p["stops"] * p["slope"] * above
        for n in (1, 2, 3, 4):
            stops += p["stops"] * math.cos(n * azimuth + p[f"phase{n}"]) * (1 + p[f"tilt{n}"] * above) / n
        stops += p["warmth"] * (1, 0, -1)[c] * math.cos(azimuth)
        return 255 * ((value / 255) ** 2.2 * 2**stops) ** (1 / 2.2)

    return every_pixel(picture, lit)


def doorway(picture, p):
    """Columns up to half the share from the middle, with an edge of 2 % of the width."""
    width = picture.shape[2]

    def lit(c, y, x, value):
        aside = abs(short_way(x, p["column"], width)) / width
        inside = min(max((p["share"] / 2 - aside + 0.01) / 0.02, 0), 1)
        return value + inside * (value * 2 ** (p["stops"] / 2.2) - value)

    return every_pixel(picture, lit)


def windows(picture, p):
    """The brightest pixels, as many as fit the share; those that are equally bright stay together."""
    bright = picture.sum(axis=0).round()
    threshold = 0
    while (bright >= threshold).sum() > np.float32(p["share"]) * bright.size:
        threshold += 1
    return np.where(bright >= threshold, picture + p["strength"] * (p["level"] - picture), picture)


def view(picture, p, circular=True):
    """Where each pixel comes from, undoing the move, then the roll, then the growth; linear between pixels."""
    _, height, width = picture.shape
    middle_row, middle = (height - 1) / 2, (width - 1) / 2
    roll, wide, tall = math.radians(p["roll"]), p["zoom"] * p["stretch"], p["zoom"] / p["stretch"]

    def at(c, y, x):
        return picture[c, y, x % width if circular else x] if 0 <= y < height and (circular or 0 <= x < width) else 0

    def seen(c, y, x, value):
        below = y - middle_row - p["down"] * height
        if circular:
            azimuth = 2 * math.pi * short_way(x, p["column"], width) / width
            row, column = (below - roll * math.cos(azimuth) * width / (2 * math.pi)) / tall + middle_row, float(x)
        else:
            aside = x - middle - p["across"] * width
            column = (math.cos(roll) * aside + math.sin(roll) * below) / wide + middle
            row = (math.cos(roll) * below - math.sin(roll) * aside) / tall + middle_row
        i, j = math.floor(row), math.floor(column)
        v, u = row - i, column - j
        upper = (1 - u) * at(c, i, j) + u * at(c, i, j + 1)
        return (1 - v) * upper + v * ((1 - u) * at(c, i + 1, j) + u * at(c, i + 1, j + 1))

    return every_pixel(picture, seen)


def occlude(picture, p):
    """Bar i of n stands in sector i of n, counted from a column."""
    width, n = picture.shape[2], p["bars"]
    hidden = set()
    for i in range(n):
        begin, end = i * width // n, (i + 1) * width // n
        length = min(math.floor(p["share"] * width / n + 0.5), end - begin)
        start = begin + min(int(p[f"place{i}"] * (end - begin - length + 1)), end - begin - length)
        hidden |= {(start + step + p["column"]) % width for step in range(length)}
    return every_pixel(picture, lambda c, y, x, value: p["level"] if x in hidden else value)


def noise(picture, p, table):
    """From the table of normal numbers, read row by row and channel by channel from two places."""
    _, height, width = picture.shape

    def noisy(c, y, x, value):
        step = (c * height + y) * width + (x - p["column"]) % width
        first, second = (float(table[(p[key] + step) % len(table)]) for key in ("first", "second"))
        return value + 255 * math.sqrt(p["variance"]) * (first + second) / math.sqrt(2)

    return every_pixel(picture, noisy)
