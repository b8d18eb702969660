import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.data.protocol import Protocol, Role
from siamloc.errors import ConfigError


@pytest.fixture
def table():
    names = ["cloudy1", "cloudy2", "night1"]
    return FrameTable(
        path=[f"{name}/{i}" for name in names for i in range(10)],
        x=np.tile(np.arange(10.0), 3),
        y=np.zeros(30),
        room=np.tile(["A"] * 5 + ["B"] * 5, 3),
        sequence=np.repeat(names, 10),
        lighting=np.repeat(["cloudy", "cloudy", "night"], 10),
    )


def protocol(**roles):
    kind = roles.pop("kind", "cross_run")
    return Protocol.of({"kind": kind, **{role: {"sequences": names} for role, names in roles.items()}})


def test_roles_select_by_sequence_pattern_room_lighting_and_step(table):
    chosen = Role(sequences=["*1"], rooms=["B"], lightings=["night"], every=2).select(table)
    assert chosen.path.tolist() == ["night1/5", "night1/7", "night1/9"]
    assert Role(sequences=["cloudy1"], spacing=4.0).select(table).x.tolist() == [0, 4, 8]
    assert len(Role().select(table)) == 30


def test_the_map_is_made_of_the_training_sequences_unless_told(table):
    given = Protocol.of({"train": {"sequences": ["cloudy1"]}, "map": {"every": 5}})
    assert given.frames("map", table).path.tolist() == ["cloudy1/0", "cloudy1/5"]


def test_one_name_may_stand_without_a_list(table):
    assert len(Protocol.of({"train": {"sequences": "cloudy1"}}).frames("train", table)) == 10


def test_queries_may_share_the_run_of_the_map_only_if_the_protocol_says_so(table):
    with pytest.raises(ConfigError, match=r"cloudy1.*protocol.query and in protocol.map"):
        protocol(map=["cloudy1"], query=["cloudy1"]).frames("query", table)
    same_run = protocol(kind="same_run", map=["cloudy1"], query=["cloudy1"])
    assert len(same_run.frames("query", table)) == 10


@pytest.mark.parametrize(
    ("roles", "asked"),
    [
        ({"train": ["cloudy1"], "query": ["cloudy*"]}, "query"),
        ({"train": ["*1"], "validation": ["night1"]}, "validation"),
        ({"validation": ["night1"], "query": ["night1"]}, "validation"),
        ({"kind": "same_run", "validation": ["night1"], "query": ["night1"]}, "query"),
    ],
)
def test_what_must_stay_apart_is_kept_apart(table, roles, asked):
    with pytest.raises(ConfigError, match="not be honest"):
        protocol(**roles).frames(asked, table)


@pytest.mark.parametrize(
    ("config", "says"),
    [
        ({"kind": "crossrun"}, "protocol.kind must be cross_run or same_run, got 'crossrun'"),
        ({"trian": {}}, "did you mean 'train'"),
        ({"train": {"sequence": ["a"]}}, "did you mean 'sequences'"),
        ({"train": {"sequences": ["a"], "every": 2, "spacing": 1.0}}, "not both"),
    ],
)
def test_mistaken_protocols_are_one_sentence(config, says):
    with pytest.raises(ConfigError, match=says):
        Protocol.of(config)


def test_an_unfilled_role_says_what_there_is(table):
    with pytest.raises(ConfigError, match=r"protocol.query.sequences is not set.*cloudy1 10, cloudy2 10, night1 10"):
        protocol(train=["cloudy1"]).frames("query", table)
    with pytest.raises(ConfigError, match="did you mean 'night1'"):
        protocol(query=["nigth1"]).frames("query", table)
    with pytest.raises(ConfigError, match=r"^protocol\.query: no frame has room 'C'; valid: A, B"):
        Protocol.of({"query": {"sequences": ["night1"], "rooms": ["C"]}}).frames("query", table)
