import json
from collections import defaultdict
from pathlib import Path

import pytest
import yaml

import siamloc.reproduce
from benchmarks.spreads import spreads_of
from siamloc.errors import ConfigError
from siamloc.reproduce.claims import claim, claims, combined, examine, spread_of
from siamloc.reproduce.published import Record, contents, measures, over_seeds, published

FOLDER = Path(siamloc.reproduce.__file__).parent
SETTINGS = yaml.safe_load((FOLDER / "published.yaml").read_text(encoding="utf-8"))["settings"]
CONTRADICTED = {
    "t_hog_maps_better",
    "t_more_same_pairs_different",
    "t_best_same_share_rooms",
    "t_more_epochs",
    "t_small_batches_every_row",
    "t_room_head_each_network",
    "t_hierarchical_cloudy_7",
    "t_hierarchical_sunny",
    "t_more_augmentation_night",
    "t_more_augmentation_sunny",
    "t_analytic_own_lighting",
    "t_single_network_other_lighting",
    "i_hog_maps_better",
}
RECORDS = [
    Record("error", 0.1 * place + (0.05 if name == "b" else 0), {"descriptor": name, "place": place})
    for name in "ab"
    for place in (1, 2, 3)
]


def test_ids_are_unique_and_say_their_document():
    listed = [one["id"] for one in yaml.safe_load((FOLDER / "claims.yaml").read_text(encoding="utf-8"))["claims"]]
    assert len(listed) == len(set(listed))
    assert all(one.id.startswith(f"{one.source.document.lower()}_") for one in claims())


@pytest.mark.parametrize("one", claims(), ids=lambda one: one.id)
def test_a_claim_names_what_there_is(one):
    check = one.check
    assert one.sentence.endswith(".")
    assert check["measure"] in measures()
    assert all(published(entry).rows for entry in one.entries)
    sides = [check[name] for name in ("where", "more", "less") if isinstance(check.get(name), dict)]
    named = {name for side in sides for name in side} | set(check.get("match", ()))
    assert named | ({check["along"]} if "along" in check else set()) <= set(SETTINGS)
    examine(check, [])
    if check.get("factor", 1) < 1:
        assert "at most" in one.reading
    if "factor" in check or check.get("goes") == "flat":
        assert measures()[check["measure"]]["unit"] != "1"  # never negative, as silhouettes may be


def test_which_claims_the_documents_own_numbers_bear_out():
    found = {one.id: one.printed() for one in claims()}
    assert {name for name, result in found.items() if result is False} == CONTRADICTED
    assert all(result is not None for name, result in found.items() if claim(name).entries)
    assert sum(result is True for result in found.values()) >= 35


def test_an_unknown_claim_kind_or_key_is_refused():
    with pytest.raises(ConfigError, match="unknown claim 't_more_epoch': did you mean 't_more_epochs'"):
        claim("t_more_epoch")
    with pytest.raises(ConfigError, match="unknown kind of check 'ordre': did you mean 'order'"):
        examine({"kind": "ordre", "measure": "error"}, RECORDS)
    for key, valid in (("allong", "along"), ("mach", "match")):
        with pytest.raises(ConfigError, match=f"of kind trend has no key '{key}'; did you mean '{valid}'"):
            examine({"kind": "trend", "measure": "error", key: "place"}, RECORDS)


A, B = {"descriptor": "a"}, {"descriptor": "b"}
ORDER, TREND, THRESHOLD = ({"kind": kind, "measure": "error"} for kind in ("order", "trend", "threshold"))


@pytest.mark.parametrize(
    ("check", "expected"),
    [
        (ORDER | {"more": B, "less": A}, False),  # 0.15 is not above 0.3
        (ORDER | {"more": B, "less": A, "match": ["place"]}, True),
        (ORDER | {"more": B, "less": A, "pick": "mean"}, True),
        (ORDER | {"more": B, "less": A, "pick": "max", "factor": 1.1}, True),
        (ORDER | {"more": B, "less": A, "pick": "max", "factor": 1.2}, False),
        (ORDER | {"more": {"place": 3}, "less": "others"}, True),
        (ORDER | {"more": "others", "less": {"place": 1}}, True),
        (ORDER | {"more": {"place": {"above": 1}}, "less": {"place": {"not": [2, 3]}}}, True),
        (ORDER | {"more": {"descriptor": "c"}, "less": A}, None),
        (ORDER | {"more": {"color": "red"}, "less": A}, None),
        (TREND | {"along": "place", "goes": "up"}, True),
        (TREND | {"along": "place", "goes": "down"}, False),
        (TREND | {"along": "place", "goes": "down", "within": 1.0}, True),
        (TREND | {"along": "place", "goes": "up", "match": ["descriptor"]}, True),
        (TREND | {"along": "place", "goes": "up", "where": {"place": 1}}, None),
        (TREND | {"along": "depth", "goes": "up"}, None),
        (TREND | {"along": "place", "goes": "flat", "within": 2.0}, True),
        (TREND | {"along": "place", "goes": "flat", "within": 1.5}, False),
        (TREND | {"along": "descriptor", "goes": "flat", "within": 0.6, "pick": "min"}, True),
        (TREND | {"along": "descriptor", "goes": "flat", "within": 0.4, "pick": "min"}, False),
        (THRESHOLD | {"below": 0.3}, False),
        (THRESHOLD | {"below": 0.3, "pick": "mean"}, True),
        (THRESHOLD | {"above": 0.1, "pick": "min"}, False),
        (THRESHOLD | {"at_least": 0.1, "at_most": 0.36}, True),
        (THRESHOLD | {"below": 0.3, "where": {"place": [1, 2]}}, True),
        (THRESHOLD | {"below": 0.3, "where": {"place": 4}}, None),
        (THRESHOLD | {"measure": "seconds", "below": 1}, None),
    ],
)
def test_checks(check, expected):
    assert examine(check, RECORDS).holds is expected


def spread(values, spread):
    """Return records at the places 0, 1, ... with some values and one spread."""
    return [Record("error", value, {"place": place}, spread=spread) for place, value in enumerate(values)]


UP = TREND | {"along": "place", "goes": "up"}
LAST = ORDER | {"more": {"place": 2}, "less": {"place": [0, 1]}}


@pytest.mark.parametrize(
    ("check", "records", "expected", "why"),
    [
        (UP, spread([41, 41, 41], 0), None, "all compared values are 41"),
        (UP, spread([1.0, 1.1, 1.2], 0.3), None, "1 and 1.2 differ by less than the spread of such differences, 0.3"),
        (UP, spread([1.0, 1.1, 1.4], 0.3), True, ""),  # small steps that add up
        (UP, spread([1.0, 2.0, 1.9], 0.3), None, "a step the other way, 0.1, is smaller than the spread"),
        (UP, spread([1.0, 2.0, 1.9], 0.05), False, ""),
        (UP, spread([2.0, 1.0, 3.0], 0.3), False, ""),
        (UP | {"goes": "flat", "within": 0.5}, spread([1.0, 1.0, 1.2], 0.3), True, ""),
        (UP | {"goes": "flat", "within": 0.1}, spread([1.0, 1.0, 1.2], 0.3), None, "1 and 1.2 differ by less"),
        (LAST, spread([2.214, 1.0, 2.212], 0.1), None, "2.212 and 2.214 differ by less than the spread"),
        (LAST, spread([0.866, 0.8, 0.866], 0), None, "all compared values are 0.866"),
        (LAST, spread([1.0, 1.0, 1.2], 0.1), True, ""),
        (LAST, spread([1.3, 1.0, 1.2], 0.05), False, ""),
        (LAST | {"factor": 2}, spread([1.0, 1.0, 2.1], 0.1), None, "2 and 2.1 differ by less than the spread"),
        (LAST | {"factor": 0.97}, spread([1.0, 1.0, 0.98], 0.1), True, ""),  # about alike
        (LAST | {"factor": 0.97}, spread([1.0, 1.0, 0.96], 0.1), None, "0.96 and 1 differ by less than the spread"),
        (LAST | {"factor": 0.97}, spread([1.0, 1.0, 0.96], 0.03), False, ""),
        (LAST | {"pick": "mean"}, spread([1.0, 2.0, 1.6], 0.2), None, "1.5 and 1.6 differ by less than the spread"),
    ],
)
def test_numbers_that_are_equal_or_differ_by_less_than_their_spread_decide_nothing(check, records, expected, why):
    found = examine(check, records)
    assert found.holds is expected
    assert found.why.startswith(why) if why else not found.why


def test_one_group_that_decides_nothing_leaves_a_claim_open_and_one_that_fails_refutes_it():
    holding, failing, open_, nothing = (
        examine(LAST, spread([0, 1, value], 0.1)[: None if value else 1]) for value in (3, 0.5, 1.05, 0)
    )
    assert [one.holds for one in (holding, failing, open_, nothing)] == [True, False, None, None]
    assert combined([holding, nothing]) == holding
    assert combined([holding, open_]) == open_
    assert combined([open_, holding, failing]) == failing
    assert combined([]) == nothing


def test_records_of_several_seeds_become_their_mean_with_a_spread():
    records = [Record("error", value, {"seed": seed, "head": "a"}) for seed, value in enumerate([1.0, 1.2, 1.4])]
    alone = Record("error", 3.0, {"head": "a"}, spread=0.5)
    mean, kept = over_seeds([*records, alone])
    assert (mean.value, mean.settings) == (pytest.approx(1.2), {"head": "a"})
    assert mean.spread == pytest.approx(0.2)
    assert kept == alone


def test_stated_spreads_are_those_that_were_measured():
    results = FOLDER.parents[1] / "benchmarks/results"
    rows = json.loads((results / "spreads.json").read_text(encoding="utf-8"))["rows"].values()
    measured = defaultdict(dict)
    for row in rows:
        for measure, value in row["spread"].items():
            measured[row["kind"]][measure] = max(value, measured[row["kind"]].get(measure, 0))
    trained = json.loads((results / "augmentation_training.json").read_text(encoding="utf-8"))["rows"]
    errors = [
        Record("error", one[lighting], {"of": [row, lighting], "seed": seed})
        for row, seeds in trained.items()
        for seed, one in enumerate(seeds)
        for lighting in ("cloudy", "night", "sunny")
    ]
    measured["trained"] |= spreads_of(errors)
    measured |= {"matched": measured["mapping"], "growing": measured["mapping"], "named_rooms": measured["trained"]}
    stated = contents("claims")["spreads"]
    assert stated == measured
    assert spread_of("retrieval", Record("error", -2.0, {})) == 2 * stated["retrieval"]["error"]
    assert spread_of("retrieval", Record("hit_rate", 0.5, {})) == stated["retrieval"]["hit_rate"]
    assert spread_of("retrieval", Record("floor", 0.5, {})) == 0
