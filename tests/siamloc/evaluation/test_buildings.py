import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from siamloc.data.frames import FrameTable
from siamloc.evaluation.building_choice import evaluate_buildings
from siamloc.report.draw import pictures

NAMES = (["p", "q"], ["r", "s", "t"])


def result(building, apart, lighting=None, rows=None):
    rows = np.zeros((len(building), 2), dtype=int) if rows is None else np.array(rows)
    frames = FrameTable([f"{i}.png" for i in range(len(building))], building=building, lighting=lighting)
    return evaluate_buildings(frames, ["a", "b"], np.array(apart, dtype=float), rows, NAMES)


def test_the_nearest_building_is_chosen_and_the_first_of_equals():
    found = result(["a", "a", "b"], [[1, 2], [3, 2], [2, 2]], rows=[[1, 2], [0, 2], [1, 0]])
    assert found.columns["predicted_building"].tolist() == ["a", "b", "a"]
    assert found.columns["correct"].tolist() == [True, False, False]
    assert found.columns["match"].tolist() == [1, 2, 1]
    assert found.columns["match_name"].tolist() == ["q", "t", "q"]
    assert found.columns["descriptor_distance"].tolist() == [1, 2, 2]
    assert found.columns["next_distance"].tolist() == [2, 3, 2]
    assert found.columns["distance_b"].tolist() == [2, 2, 2]


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.sampled_from(["cloudy", "night"])), min_size=1, max_size=20))
def test_shares_are_pooled_over_queries(cases):
    building = ["b" if true else "a" for true, _, _ in cases]
    apart = [[1, 0] if chosen else [0, 1] for _, chosen, _ in cases]
    measures = result(building, apart, [lighting for _, _, lighting in cases]).parts["buildings"]
    groups = {"overall": cases} | {name: [c for c in cases if c[2] == name] for name in ("cloudy", "night")}
    for name, part in groups.items():
        if not part:
            assert name not in measures["lighting"]
            continue
        group = measures["overall"] if name == "overall" else measures["lighting"][name]
        right = sum(true == chosen for true, chosen, _ in part)
        assert (group["accuracy"], group["correct"], group["queries"]) == (right / len(part), right, len(part))
        for label, wanted in (("a", False), ("b", True)):
            own = [true == chosen for true, chosen, _ in part if true == wanted]
            if own:
                assert group["building"][label]["accuracy"] == sum(own) / len(own)
            else:
                assert label not in group["building"]
    counts = np.zeros((2, 2), dtype=int)
    for true, chosen, _ in cases:
        counts[int(true), int(chosen)] += 1
    assert measures["confusion"]["counts"] == counts.tolist()
    assert np.sum(list(measures["confusion"]["lighting"].values()), axis=0).tolist() == counts.tolist()


def test_without_lightings_there_are_no_groups():
    measures = result(["a", "b"], np.eye(2)).parts["buildings"]
    assert measures["lighting"] == {}
    assert measures["overall"]["accuracy"] == 0
    made = pictures({"buildings": measures}, {})
    assert [axes.get_title("left") for axes in made["confusion"]().axes] == ["all queries\n0.0 % of 2 right"]
