"""The tables printed after an evaluation."""

from siamloc.evaluation import Result


def measured(told):
    error = {"mean": 0.5, "median": 0.4, "p95": 0.9}
    group = {"queries": 32, "error": error, "floor": {"mean": 0.2}, "excess": {"mean": 0.3}, "recall": []}
    if told:
        group["heading_error"] = {"count": told, "mean": 2.125}
    return {"absolute": {"unit": "m", "radii": [], "map_frames": 8, "overall": group, "lighting": {"night": group}}}


def said(first, **others):
    baselines = {name: Result(name, parts, {}) for name, parts in others.items()}
    return Result("hog", first, {}, baselines=baselines).table().splitlines()


def test_headings_of_some_queries_say_how_many():
    lines = said(measured(10), fs=measured(32), thumbnail=measured(0))
    ends = [line.split()[-2:] for line in lines if line.startswith(("hog", "fs", "thumbnail"))]
    assert ends == [["2.1", "32"], ["2.1", "32"], ["–", "32"]]
    notes = [line for line in lines if line.startswith("heading,")]
    assert notes == ["heading, hog: 10 of 32 queries, where theta is known on both sides"]
