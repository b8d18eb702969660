from pathlib import Path

import pytest
import yaml

import siamloc.reproduce
from siamloc.errors import ConfigError
from siamloc.reproduce.claims import claim, claims, holds
from siamloc.reproduce.published import Record, measures, published

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
    holds(check, [])


def test_which_claims_the_documents_own_numbers_bear_out():
    found = {one.id: one.printed() for one in claims()}
    assert {name for name, result in found.items() if result is False} == CONTRADICTED
    assert all(result is not None for name, result in found.items() if claim(name).entries)
    assert sum(result is True for result in found.values()) >= 35


def test_an_unknown_claim_kind_or_key_is_refused():
    with pytest.raises(ConfigError, match="no claim 't_more_epoch'; did you mean 't_more_epochs'"):
        claim("t_more_epoch")
    with pytest.raises(ConfigError, match="unknown kind of check 'ordre'; did you mean 'order'"):
        holds({"kind": "ordre", "measure": "error"}, RECORDS)
    for key, valid in (("allong", "along"), ("mach", "match")):
        with pytest.raises(ConfigError, match=f"of kind trend has no key '{key}'; did you mean '{valid}'"):
            holds({"kind": "trend", "measure": "error", key: "place"}, RECORDS)


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
    assert holds(check, RECORDS) is expected
