"""Every study runs, at its smallest, on drawn rooms; and no published number gets into what is measured."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from siamloc.cli import main
from siamloc.errors import ConfigError, DataError, StorageError
from siamloc.reproduce import listing, reproduce, studies, study, write_report
from siamloc.reproduce.claims import claim, claims
from siamloc.reproduce.drawing import shown
from siamloc.reproduce.experiments import KINDS, Data, measured
from siamloc.reproduce.page import report
from siamloc.reproduce.published import Record, published
from siamloc.reproduce.reproduction import CONTRADICTED, Reproduction
from siamloc.reproduce.running import open_data
from siamloc.reproduce.study_book import experiment, seconds_of, without_measurement
from tests.drawn import write_cold

ROOT = Path(__file__).parents[3]
RUNS = {"cloudy1": 0, "cloudy2": 1, "cloudy3": 2, "night1": 5, "night2": 3, "sunny1": 6, "sunny2": 4}
FRAMES = 36  # in each of three rooms
NOT_ASKED = {"t_sun_needs_sunny_frames"}  # compares trainings of sizes that a scale below full does not keep


@pytest.fixture(scope="session")
def root(tmp_path_factory):
    """A data set in COLD's layout, with the runs that studies name, and another building next to it."""
    beside = tmp_path_factory.mktemp("drawn")
    write_cold(beside / "mini" / "part_a", RUNS, FRAMES, size=(128, 512))
    write_cold(beside / "freiburg_like" / "part_a", {"cloudy3": 12}, FRAMES // 2, size=(128, 512))
    return beside / "mini"


@pytest.fixture(scope="session")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("reproduced")


@pytest.fixture(scope="session")
def smoke(root, out):
    """Reproduce at the smallest scale; later tests find what earlier ones measured."""
    return partial(reproduce, data="mini", root=root, scale="smoke", out=out, progress=False)


@pytest.fixture
def refuse(monkeypatch):
    """Let every measurement fail with the name of its experiment."""

    def measured(job, data):
        raise AssertionError(f"{job.experiment} is measured again")

    monkeypatch.setattr("siamloc.reproduce.experiments.measured", measured)


@pytest.mark.slow
@pytest.mark.timeout(900)  # a hundred experiments
def test_every_study_runs_and_is_written(smoke, out):
    results = []
    for one in studies():
        found = smoke(one.id)
        assert found.records, one.id
        assert f"### {one.title}" in found.table()
        rows = list(csv.DictReader(io.StringIO(found.as_csv())))
        assert sum(row["ours"] != "" for row in rows) >= len(found.records)
        assert {row["data"] for row in rows} == {"mini"}
        results.append(found)
    page = write_report(results, out / "page" / "report.md", {"table_9_9": "no such data"})
    assert {path.suffix for path in page.parent.iterdir()} == {".md", ".png"}
    text = page.read_text()
    assert results[0].machines[0] in text
    assert "table_9_9 | not measured: no such data" in text
    assert text.count("![") == sum(bool(one.figure) for one in studies())
    for one in results:
        assert (page.parent / f"{one.study.id}.png").is_file() == bool(one.study.figure)
    files = {path.name for one in results[:2] for path in one.save(out / "saved")}
    assert files == {path.name for path in (out / "saved").iterdir()}


def test_what_was_measured_is_not_measured_again(smoke, request):
    smoke("figure_3_11")
    request.getfixturevalue("refuse")
    assert len(smoke("figure_3_11").records) > 20


def test_what_was_not_measured_may_be_left_out(smoke, root, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("siamloc.reproduce.studies", lambda: (study("figure_3_16"), study("table_4_2")))
    with pytest.raises(DataError, match="not all of it was measured before on these data"):
        smoke("figure_3_16", out=tmp_path, measure=False)
    words = ["data=mini", f"root={root}", "scale=smoke", f"out={tmp_path}"]
    assert main(["reproduce", "all", *words, "measure=false"]) == 2
    said = capsys.readouterr()
    assert said.out.count("left out, because not all of it was measured before") == 1
    assert "nothing was measured" in said.err
    assert main(["reproduce", "figure_3_16", *words]) == 0
    assert main(["reproduce", "all", *words, "measure=false", f"page={tmp_path / 'page'}"]) == 0
    page = tmp_path / "page"
    assert {path.name for path in page.iterdir()} == {"report.md", "figure_3_16.png"}
    assert "| table_4_2 | not measured: not all of it" in (page / "report.md").read_text()


@pytest.mark.slow
def test_a_table_of_the_mapper_shows_the_share_of_frames_in_no_node(smoke):
    rows = [line for line in smoke("table_4_2").table().splitlines() if line.startswith("|") and "unassigned" in line]
    assert len(rows) == 6, "two descriptors, three drives"


def test_a_bound_has_no_difference_and_a_protocol_its_scale(smoke):
    found = smoke("figure_3_17")
    rows = {row.settings["descriptor"]: row for row in found.rows if row.settings["size"] == "largest"}
    assert rows["wisurf"].published.relation == ">"
    assert rows["wisurf"].ours is not None
    assert rows["wisurf"].difference is None
    assert rows["hog"].difference < 0
    assert "frames 1.2 m apart" in found.table()
    assert "40 cm" in experiment(found.study.experiments[0]).protocol_in_words("full")["map"]


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text[: len(text) // 2],  # as on a disk that became full
        lambda text: "[]",
        lambda text: json.dumps({**json.loads(text), "records": [{"measure": "error", "value": 1, "settings": {}}]}),
        lambda text: json.dumps({key: value for key, value in json.loads(text).items() if key != "key"}),
    ],
)
def test_kept_numbers_that_were_altered_are_measured_again(smoke, out, request, change):
    smoke("figure_3_11")
    file = next((out / "measured" / "hits_hog").iterdir())
    held = file.read_text()
    file.write_text(change(held))
    request.getfixturevalue("refuse")
    with pytest.raises(AssertionError, match="hits_hog is measured again"):
        smoke("figure_3_11")
    file.write_text(held)


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(smoke, tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("a file")
    monkeypatch.setattr("siamloc.reproduce.experiments.measured", None)
    with pytest.raises(StorageError, match="a file stands where a folder is needed"):
        smoke("figure_3_11", out=tmp_path / "taken")


def test_no_published_number_is_ever_ours(smoke, out, monkeypatch):
    before = smoke("section_3_5_1")

    def poisoned(entry):
        found = published(entry)
        rows = tuple({key: 9731 if key == "hit_rate" else value for key, value in row.items()} for row in found.rows)
        return type(found)(**{**vars(found), "rows": rows})

    monkeypatch.setattr("siamloc.reproduce.reproduction.published", poisoned)
    after = smoke("section_3_5_1", out=out / "poisoned")
    ours = [[(one.measure, one.value) for one in each.records if one.measure != "seconds"] for each in (before, after)]
    assert ours[0] == ours[1]
    assert {row.published.value for row in after.rows} == {97.31}
    assert [row.ours.value for row in after.rows] == [row.ours.value for row in before.rows]
    assert "97.31" not in "".join(path.read_text() for path in (out / "poisoned" / "measured").rglob("*.json"))


def test_studies_name_what_there_is():
    for one in studies():
        for name in one.experiments:
            assert 0 < len(experiment(name).jobs("smoke")) <= len(experiment(name).jobs("full"))
        assert all(claim(name).check for name in one.claims)
        assert all(published(name).rows for name in one.entries)
        assert all(len(note) > 30 for note in one.notes)
        for job in one.jobs("short", "freiburg_sim"):
            assert job.kind in KINDS
            assert seconds_of(job, "smoke") < seconds_of(job, "short") < seconds_of(job, "full")
    assert {one.id for one in claims()} - {name for one in studies() for name in one.claims} <= NOT_ASKED
    ids = [id for one in studies() for id in (one.id, *one.covers)] + list(without_measurement())
    assert len(set(ids)) == len(ids), "an id has two meanings"


NUMBERED = [
    *(f"table_5_{number}" for number in range(5, 20)),
    *("table_4_2", "table_4_3", "c_table_2", "i_figure_9", "i_figure_10", "i_figure_s1", "i_figure_s2"),
    *(f"figure_4_{number}" for number in range(6, 21)),
    *(f"figure_3_{number}" for number in range(10, 50)),
    *(f"c_figure_{number}" for number in range(6, 22)),
]


@pytest.mark.parametrize("id", NUMBERED)
def test_every_number_is_measured_or_says_why_not(id):
    if id in without_measurement():
        with pytest.raises(ConfigError, match=f"^there is nothing to measure for {id}: it .{{20,}}"):
            study(id)
    else:
        found = study(id)
        assert found.id == id or id in found.covers
    listed = listing("mini", "smoke")
    assert sum(line.startswith(f"{id} ") for line in listed.splitlines()) == 1


def test_the_listing_says_what_an_id_is_needs_and_takes():
    lines = listing("freiburg_sim", "short").splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("figure_4_7 "))
    assert lines[at].endswith("Nodes and silhouette of the incremental mapper with gist, by y and omega")
    assert (
        lines[at + 1].strip() == "[T] figure 4.7; drives cloudy3; frames every 5 cm; folder annex random_1; 21 minutes"
    )
    assert any("1 training; " in line for line in lines)
    at = next(number for number, line in enumerate(lines) if line.startswith("c_figure_19 "))
    assert "; the same drive of annex; " in lines[at + 1]
    assert max(map(len, lines)) <= 160
    assert "hours each on a graphics card" in listing("cold", "full")


def test_a_bound_stands_beside_the_smallest_or_largest_of_ours(smoke):
    found = smoke("figure_4_8")
    ours = [one.value for one in found.records if one.measure == "silhouette"]
    rows = {row.settings["bound"]: row for row in found.rows if row.settings["data"] == "freiburg"}
    assert rows["lowest"].ours.value == min(ours)
    assert rows["highest"].ours.value == max(ours)
    assert {row.settings["descriptor"] for row in found.rows} == {"hog"}
    assert {row.settings["method"] for row in found.rows} == {"spectral"}


def test_as_many_nodes_by_both_methods(smoke):
    found = smoke("table_4_3")
    named = {(row.settings["descriptor"], row.settings.get("method")) for row in found.rows if row.ours}
    assert named == {(name, way) for name in ("hog", "gist") for way in (None, "incremental", "spectral")}


@pytest.mark.parametrize("id", [f"table_5_{number}" for number in range(15, 20)])
def test_errors_beside_those_of_cold_have_maps_as_dense_in_metres(id):
    assert {job.roles["map"]["spacing"] for job in study(id).jobs("short", "freiburg_sim")} == {0.15}
    rows = json.loads((ROOT / "benchmarks/results/floors.json").read_text(encoding="utf-8"))["rows"]
    cold, ours = rows["COLD freiburg_seq2, map night1"]["maps"]["1 in 5"], rows["freiburg_like"]["maps"]["15 cm apart"]
    assert ours["apart_m"] == pytest.approx(cold["apart_m"], abs=0.03)
    for name in ("cloudy", "sunny"):  # floors of different drives in the same light differ by up to 2 cm
        assert ours["floor_m"][f"{name}2"] == pytest.approx(cold["floor_m"][f"{name}1"], abs=0.025)


def test_another_seed_draws_other_noise(root, tmp_path):
    data, job = Data("mini", root, (128, 512), tmp_path), experiment("heading_hog").jobs("smoke")[0]
    first, again, other = (
        [
            one.value
            for one in measured(replace(job, options={**job.options, "seed": seed}), data)
            if "noise" in one.settings
        ]
        for seed in (0, 0, 1)
    )
    assert first == again != other


def test_claims_that_their_document_contradicts_come_first_and_are_counted_apart():
    settings = {"method": "incremental", "version": 1, "data": "freiburg", "descriptor": "hog"}
    records = tuple(Record("silhouette", 0.1 * omega, {**settings, "omega": omega}) for omega in (1.7, 1.85, 2.3))
    chosen = study("table_4_2")
    made = Reproduction(chosen, "freiburg_sim", "short", records, (), dict.fromkeys(chosen.experiments, 1.0))
    assert [one.counted for one in made.verdicts] == [CONTRADICTED, "does not hold", "not decidable"]
    claimed = made.table().partition("| claim |")[2].splitlines()[2:5]
    assert ["**contradict it**" in line for line in claimed] == [True, False, False]
    assert claimed[2].endswith("| not decidable: the numbers that it compares are missing |")
    page = report([made, made])  # a claim of several studies counts once
    assert "Of 3 claims the documents' own numbers contradict 1. Of the other 2, 0 hold here, 1 do not, and 1 " in page
    assert "Of 24 published numbers, 2 have one of ours next to them." in page


def test_another_building_that_is_missing_is_named(smoke, root, tmp_path):
    (tmp_path / "mini").symlink_to(root)
    with pytest.raises(DataError, match=r"freiburg_like needs the folder .*freiburg_like, which does not exist"):
        smoke("c_figure_19", root=tmp_path / "mini", out=tmp_path)


def test_a_panel_shows_only_what_it_is_drawn_over(smoke):
    found = smoke("figure_3_34")
    (figure,) = found.study.figure
    assert all("noise" in one.settings for one in shown(figure, found.records))
    assert {one.get_title("left") for one in found.plot().axes} == {"noise 0 [°]", "noise 0.02 [°]"}
    assert "hidden" not in found.table()
    disturbed = smoke("figure_3_25")
    assert {one.settings["information"] for one in disturbed.records} == {8 * 8 / (128 * 512)}


def test_the_largest_descriptor_has_the_finest_steps():
    def largest(id):
        return [dict(job.settings) for job in experiment(id).jobs("full") if job.settings.get("size") == "largest"]

    sized = {"size": "largest"}
    assert largest("hits_radon_fourier") == [{"descriptor": "radon_fourier", "k11": 64, "p1": 1.0, **sized}]
    assert largest("heading_hog") == [{"descriptor": "hog", "l1": 128, "d1": 1, **sized}]
    assert [one["filter"] for one in largest("disturbed_hog")] == [False, True]  # not a number


def test_bars_and_noise_of_the_map_are_shown_beside_the_published_choice(smoke):
    found = smoke("figure_3_27")
    assert {job.options["bars"] for job in found.study.jobs("full", "mini") if "filter" in job.settings} == {1}
    assert {"bars", "bar_colour"} <= {name for one in found.beside for name in one.settings}
    assert not any("bars" in one.settings for one in found.records)
    best, by_bars = found.study.figure[1:]
    every = [*found.records, *found.beside]
    assert all("bars" not in one.settings for one in shown(best, every))
    assert {one.settings["bars"] for one in shown(by_bars, every)} == {1, 2}
    assert "number nor the colour" in found.table()
    noisy = smoke("figure_3_26")
    clean = next(one for one in noisy.records if one.settings.get("noise") == 0.02)
    assert "map_noise" not in clean.settings
    (own,) = (one for one in noisy.beside if one.measure == "error")
    assert own.settings["map_noise"] == 0.0004


def test_a_study_reads_the_places_that_stand_for_others(tmp_path):
    runs = {"": {"cloudy3": 2}, "annex": {"cloudy2": 1, "cloudy3": 3}, "random_1": {"cloudy3": 4}}
    for place, some in runs.items():
        write_cold(tmp_path / (place or "freiburg_like") / "part_a", some, 12, size=(128, 512))
        dense = {"cloudy3": some["cloudy3"]}
        write_cold(tmp_path / "dense" / (place or "freiburg_like") / "part_a", dense, 12, size=(128, 512))
    ask = partial(reproduce, root=tmp_path / "freiburg_like", scale="smoke", out=tmp_path, progress=False)
    assert {one.settings["data"] for one in ask("figure_3_48").records} == {"saarbruecken"}
    assert {one.settings["data"] for one in ask("figure_4_13").records} == {"freiburg", "saarbruecken", "innova"}
    with pytest.raises(DataError, match=r"needs the folder .*grid/freiburg_like, which does not exist: render it"):
        ask("figure_3_16")
    grid = tmp_path / "grid" / "freiburg_like" / "part_a"
    write_cold(grid, {"cloudy1": 2, "cloudy2": 1, "cloudy8": 3}, 12, size=(128, 512))
    for run in ("cloudy1", "cloudy2", "cloudy8"):
        (grid / f"seq2_{run}").rename(grid / f"seq1_{run}")
    assert ask("figure_3_16").records
    assert {job.at for job in study("table_4_3").jobs("short", "cold")} == {"", "saarbruecken"}, "COLD has no INNOVA"


@pytest.mark.parametrize("prefix", ["", "cold-"])
@pytest.mark.parametrize("root", ["", "freiburg"])
def test_cold_is_found_as_it_is_fetched_and_without_the_prefix(tmp_path, prefix, root):
    buildings = [tmp_path / f"{prefix}{name}" for name in ("freiburg", "saarbruecken")]
    for folder in buildings:
        folder.mkdir()
    given = tmp_path / f"{prefix}{root}" if root else tmp_path
    opened = [open_data(job, "cold", given, tmp_path, {}) for job in study("table_4_2").jobs("smoke", "cold")]
    assert {data.root for data in opened} == set(buildings)
    assert {data.other.root for data in opened} == {buildings[1]}


def test_notes_on_simulated_data_say_so():
    for one in studies():
        for note in one.notes:
            of_simulated = "simulated" in note or "annex" in note
            assert not of_simulated or "in the simulated" in note.lower(), f"{one.id}: {note}"


def test_a_role_may_keep_a_part_of_what_it_selects(root, tmp_path):
    data = Data("mini", root, (128, 512), tmp_path)
    role = {"runs": ["cloudy3"], "spacing": 0.6, "rest": True}
    every, some = data.role(role), data.role({**role, "one_in": 10})
    assert some.path.tolist() == every.path.tolist()[::10]


def test_what_stands_beside_ours_is_left_out_of_claims(smoke):
    found = smoke("section_3_5_1")
    assert {one.settings["descriptor"] for one in found.beside} == {"pretrained"}
    assert "pretrained" not in {one.settings["descriptor"] for one in found.records}


@pytest.mark.parametrize(
    ("options", "kind", "says"),
    [
        ({"id": "table_5_77"}, ConfigError, "there is no study 'table_5_77'; did you mean 'table_5_7' or 'table_5_"),
        ({"id": "x"}, ConfigError, "there is no study 'x'; `siamloc reproduce --list` lists all"),
        ({"id": "figure_4_16"}, ConfigError, "there is nothing to measure for figure_4_16: it is a drawing"),
        ({"scale": "long"}, ConfigError, "scale must be smoke or short or full, got 'long'"),
        ({"data": "colt"}, ConfigError, "data must be cold or freiburg_sim or mini, got 'colt'"),
        ({"data": "cold"}, ConfigError, "say where COLD Freiburg, part A, path 2 is: root=FOLDER"),
        ({"data": "mini", "root": "nowhere"}, DataError, "which does not exist: render it with `siamloc demo`"),
    ],
)
def test_what_is_missing_is_said_in_one_sentence(tmp_path, options, kind, says):
    with pytest.raises(kind, match=says):
        reproduce(**{"id": "figure_3_11", "out": tmp_path, "progress": False, **options})


def test_a_drive_that_is_missing_is_named(smoke, root, tmp_path):
    fewer = tmp_path / "mini"
    (fewer / "part_a").mkdir(parents=True)
    (fewer / "part_a" / "seq2_cloudy3").symlink_to(root / "part_a" / "seq2_cloudy3")
    with pytest.raises(DataError, match=r"lacks a drive that the study needs .*cloudy2"):
        smoke("figure_3_11", root=fewer, out=tmp_path / "out")


def test_the_command_lists_and_measures(root, out, capsys):
    assert main(["reproduce", "--list", "data=mini", "scale=smoke"]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n{one.id} " in f"\n{listed}" for one in studies())
    words = ["reproduce", "figure_3_16", "data=mini", f"root={root}", "scale=smoke", f"out={out / 'command'}"]
    assert main(words) == 0
    assert f"written: {out / 'command'}/figure_3_16.png" in capsys.readouterr().out
    kept = json.loads(next((out / "command" / "measured" / "hits_radon_poc").iterdir()).read_text())
    assert kept["job"]["data"] == "mini"
    words[1:2] = ["figure_3_19"]
    assert main([*words, f"out={out}"]) == 0
    assert capsys.readouterr().out.startswith("figure_3_19 is measured by figure_3_17\n")
    for ids, says in ((["figure_3_166"], "did you mean 'figure_3_16'"), (["a", "b"], "takes one id, got a b")):
        assert main(["reproduce", *ids]) == 2
        assert says in capsys.readouterr().err
