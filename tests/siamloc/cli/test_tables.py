"""What is printed after an evaluation."""

from siamloc.cli.tables import print_summary


def measured(told):
    group = {
        "queries": 32,
        "error": {"mean": 0.5, "median": 0.4, "p95": 0.9},
        "floor": {"mean": 0.2},
        "excess": {"mean": 0.3},
        "recall": [],
    }
    if told:
        group["heading_error"] = {"count": told, "mean": 2.125}
    return {"absolute": {"unit": "m", "radii": [], "map_frames": 8, "overall": group, "lighting": {"night": group}}}


def test_headings_of_some_queries_say_how_many(capsys):
    print_summary({"hog": measured(10), "fs": measured(32), "thumbnail": measured(0)})
    said = capsys.readouterr().out.splitlines()
    assert [line.split()[-2:] for line in said if line.startswith(("hog", "fs", "thumbnail"))] == [
        ["2.1", "32"],
        ["2.1", "32"],
        ["-", "32"],
    ]
    assert [line for line in said if line.startswith("heading,")] == [
        "heading, hog: 10 of 32 queries, where theta is known on both sides"
    ]


def test_rooms_count_under_lightings_without_any_position(capsys):
    accuracy = {label: {"accuracy": share} for label, share in (("cloudy", 0.5), ("night", 1.0))}
    rooms = {"room_retrieval": {"overall": {"accuracy": 0.75}, "lighting": accuracy}}
    print_summary({"hog": {**measured(10), **rooms}, "fs": {**measured(0), **rooms}})
    said = capsys.readouterr().out.splitlines()
    lines = [line.split() for line in said if line.startswith(("hog", "fs "))]
    assert [line[1] for line in lines] == ["cloudy", "night", "all"] * 2
    assert lines[0][2:] == ["-"] * 7 + ["50.0", "%"]
    assert lines[1][-3:] == ["32", "100.0", "%"]
    assert lines[2][-3:] == ["32", "75.0", "%"]
    assert lines[3][2:] == ["-"] * 7 + ["50.0", "%"]
