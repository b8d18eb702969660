"""Fetching from a server on this machine that breaks, stalls, cheats and refuses."""

from __future__ import annotations

import errno
import gzip
import hashlib
import io
import re
import sys
import tarfile
import threading
import time
from functools import partial
from http.client import HTTPResponse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.error import URLError

import cv2
import numpy as np
import pytest

import siamloc.data
from siamloc.cli import main
from siamloc.data import Protocol, Role, fetching
from siamloc.data.archives import archives
from siamloc.errors import ConfigError, DataError, StorageError

NAME, PATH = "freiburg_a_seq2_cloudy3", "/db/cold-freiburg/part_a/seq2_cloudy3.tar"
IMAGES = [f"t{time}.5_x{time}.25_y-0.5_a1e-05.jpeg" for time in range(3)]


PLACE = "cold-freiburg/part_a/seq2_cloudy3"
CAMERAS = ("std_cam", "omni_cam")


INSIDE, BLANK = ("seq2_cloudy3",), bytes(20_000)


def tar(listed=IMAGES, images=IMAGES, inside=INSIDE, places="places.lst", further=(), content=BLANK, cameras=CAMERAS):
    """An archive as the database has them, of the sequences inside, with the content of each image and more members."""
    rooms = "".join(f"{image} CR-A\n" for image in listed).encode()
    files = {f"{name}/localization/{places}": rooms for name in inside}
    files |= {f"{name}/{camera}/{image}": content for name in inside for camera in cameras for image in images}
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
        for member in further:
            archive.addfile(member, io.BytesIO(bytes(member.size)))
    return buffer.getvalue()


class Handler(BaseHTTPRequestHandler):
    """Answers from `server.files`; `server.steps` says for each request how it goes wrong."""

    protocol_version = "HTTP/1.1"

    def do_GET(self):
        server = self.server
        server.asked.append((self.path, self.headers.get("Range"), self.headers.get("If-Range")))
        step = server.steps.pop(0) if server.steps else ""
        content = server.files.get(self.path)
        if content is None or step in ("503", "429"):
            self.send_error(404 if content is None else int(step))
            return
        tag = f'"{hashlib.sha256(content).hexdigest()[:8]}"'
        begin = int(self.headers.get("Range", "bytes=0-")[6:-1])
        if step == "no ranges" or self.headers.get("If-Range", tag) != tag:
            begin = 0
        if begin and begin >= len(content):
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{len(content)}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_response(206 if begin else 200)
        if begin:
            self.send_header("Content-Range", f"bytes {begin}-{len(content) - 1}/{len(content)}")
        if step == "gzip":
            self.send_header("Content-Encoding", "gzip")
        self.send_header("ETag", tag)
        self.send_header("Content-Length", len(content) - begin)
        self.end_headers()
        half = begin + (len(content) - begin) // 2
        self.wfile.write(content[begin:half])
        if step == "stall":
            self.wfile.flush()
            server.go_on.wait(5)
        if step in ("cut", "stall"):
            self.close_connection = True
            return
        if step == "slow":
            time.sleep(0.2)
        self.wfile.write(content[half:])

    def log_message(self, *_):
        pass


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr(fetching, "_LONGEST_PAUSE", 0.0)
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.files, server.steps, server.asked, server.go_on = {PATH: tar()}, [], [], threading.Event()
    thread = threading.Thread(target=server.serve_forever, args=[0.01], daemon=True)
    thread.start()
    server.address = f"http://127.0.0.1:{server.server_port}/db"
    server.fetch = partial(siamloc.data.fetch, "cold", NAME, mirror=server.address)
    yield server
    server.go_on.set()
    server.shutdown()
    server.server_close()


def test_a_sequence_is_loaded_checked_and_read(server, tmp_path):
    found = server.fetch(tmp_path / "COLD")
    assert found.there == {NAME: 3}
    assert not found.missing
    assert "3 frames, and 2778 are known" in found.notes[0]
    frames = siamloc.data.read("cold", root=tmp_path / "COLD")
    assert set(frames.sequence.tolist()) == {NAME}
    assert frames.x.tolist() == [0.25, 1.25, 2.25]
    digest = hashlib.sha256(server.files[PATH]).hexdigest()
    assert (tmp_path / "COLD/SHA256SUMS").read_text() == f"{digest}  cold-freiburg/part_a/seq2_cloudy3.tar\n"
    server.fetch(tmp_path / "COLD")
    assert len(server.asked) == 1, "what is there is not loaded again"
    assert sorted(path.name for path in (tmp_path / "COLD").rglob("*") if "tar" in path.name) == []


@pytest.mark.parametrize(
    ("steps", "ranges"),
    [(["cut", "cut"], 2), (["stall"], 1), (["slow"], 0), (["503", "429"], 0), (["cut", "no ranges"], 1)],
)
def test_a_break_is_resumed(server, tmp_path, steps, ranges):
    server.steps[:] = steps
    assert server.fetch(tmp_path, timeout=0.5, keep=True).there == {NAME: 3}
    assert sum(asked is not None for _, asked, _ in server.asked) == ranges
    assert (tmp_path / "cold-freiburg/part_a/seq2_cloudy3.tar").read_bytes() == server.files[PATH]


def test_a_later_call_goes_on_unless_the_file_changed(server, tmp_path):
    for changed in (False, True):
        out, server.files[PATH] = tmp_path / str(changed), tar()
        server.steps[:], server.asked[:] = ["cut", "503"], []
        with pytest.raises(DataError, match=r"seq2_cloudy3\.tar cannot be fetched .* bytes are here, and the same"):
            server.fetch(out, tries=1)
        if changed:
            server.files[PATH] = tar(inside=["another"])
        assert server.fetch(out).there == {NAME: 3}
        assert server.asked[-1][1].startswith("bytes=")
        assert server.asked[-1][2].startswith('"')
    for more in (b"", bytes(512)):  # all of it is here, but not unpacked; or more than all of it
        part = tmp_path / f"{len(more)} more/{PLACE}.tar.part"
        part.parent.mkdir(parents=True)
        part.write_bytes(server.files[PATH] + more)
        assert server.fetch(part.parents[2]).there == {NAME: 3}


LINK = tarfile.TarInfo("seq2_cloudy3/link")
LINK.type, LINK.linkname = tarfile.SYMTYPE, "/etc/passwd"
NO_ARCHIVE = {"empty": b"", "page": b"<html>Log in to the network</html>"}
NOT_WHOLE = r"is not a whole tar archive \(.+\)"
BAD = [
    (NOT_WHOLE, tar()[:100_000]),
    (NOT_WHOLE, gzip.compress(tar())),
    ("lacks 1 of the 3 images .*, the first t2.5.*, and holds 2 in omni_cam and 2 in std_cam", tar(images=IMAGES[:2])),
    ("lacks 3 of the 3 .* t0.5.*, and holds 3 in Omni_cam, the first Omni_cam/t0.5", tar(cameras=["Omni_cam"])),
    (
        "lacks 3 of the 3 .* t0.5_.*, and holds 3 in omni_cam .* the first omni_cam/t0.5.jpeg",
        tar(images=[f"t{time}.5.jpeg" for time in range(3)]),
    ),
    ("holds another sequence, seq2_night3", tar(inside=["seq2_night3"])),
    ("holds another sequence, saarbruecken/seq2_cloudy3", tar(inside=["saarbruecken/seq2_cloudy3"])),
    ("holds another sequence, a/b/seq2_night3", tar(inside=["a/b/seq2_night3"])),
    ("holds another sequence, freiburg/part_b/seq2_cloudy3", tar(inside=["freiburg/part_b/seq2_cloudy3"])),
    ("holds 2 sequences: seq2_cloudy2, seq2_cloudy3", tar(inside=["seq2_cloudy3", "seq2_cloudy2"])),
    ("holds ../evil, which lies outside of its own folder", tar(further=[tarfile.TarInfo("../evil")])),
    ("holds seq2_cloudy3/link, which is neither a file nor a folder", tar(further=[LINK])),
    ("holds no list localization/places.lst, but seq2_cloudy3", tar(places="places.txt")),
    (r"places\.lst, line 3: expected t<seconds>", tar(listed=[*IMAGES[:2], IMAGES[2][:9]])),
]


@pytest.mark.parametrize("content", NO_ARCHIVE.values(), ids=NO_ARCHIVE)
def test_what_is_no_archive_is_loaded_again_unless_the_user_put_it_there(server, tmp_path, content):
    server.files[PATH] = content
    out = tmp_path / "a/b/COLD"
    with pytest.raises(DataError, match=rf"{NOT_WHOLE}: the same command loads it again"):
        server.fetch(out)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    server.files[PATH] = tar()
    assert server.fetch(out).there == {NAME: 3}
    lying = tmp_path / f"own/{PLACE}.tar"
    lying.parent.mkdir(parents=True)
    lying.write_bytes(content)
    with pytest.raises(DataError, match=rf"{NOT_WHOLE}: not used; look at {lying}, and remove it to load it again"):
        server.fetch(tmp_path / "own")
    assert lying.is_file()


@pytest.mark.parametrize(("says", "content"), BAD, ids=[says for says, _ in BAD])
def test_a_bad_archive_is_refused_and_kept(server, tmp_path, says, content):
    server.files[PATH] = content
    out = tmp_path / "a/b/COLD"
    kept = out / f"{PLACE}.tar"
    for _ in range(2):
        with pytest.raises(DataError, match=rf"{says}.*: not used; look at {kept}, and remove it to load it again"):
            server.fetch(out)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [kept]
    assert kept.read_bytes() == content
    assert len(server.asked) == 1
    kept.unlink()
    server.files[PATH] = tar()
    assert server.fetch(out).there == {NAME: 3}


@pytest.mark.parametrize(
    "inside",
    [
        "freiburg_seq2_cloudy3",
        "COLD/cold-freiburg/part_a/seq2_cloudy3",
        "www/COLD/db/cold-freiburg/part_a/seq2_cloudy3",
        "cold-freiburg_part_a_seq2_cloudy3",
        "part_a/seq2_cloudy3",
        "./part_a/seq2_cloudy3",
        "COLD/seq2_cloudy3",
        "extended/seq2_cloudy3",
        "seq2_cloudy3/seq2_cloudy3",
        ".",
    ],
)
def test_a_sequence_may_lie_anywhere_in_its_archive(server, tmp_path, inside):
    server.files[PATH] = tar(inside=[inside])
    assert server.fetch(tmp_path).there == {NAME: 3}
    assert sorted(path.name for path in (tmp_path / PLACE).iterdir()) == ["localization", *sorted(CAMERAS)]


def laid(folder, listed=IMAGES, images=IMAGES):
    """A sequence that the user unpacked."""
    for name, content in {"notes.txt": "mine", "places.lst": "".join(f"{image} CR-A\n" for image in listed)}.items():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    for image in images:
        (folder / "omni_cam").mkdir(exist_ok=True)
        (folder / "omni_cam" / image).write_bytes(b"mine")


@pytest.mark.parametrize("layout", [PLACE, "freiburg/part_a/seq2_cloudy3", "freiburg_seq2_cloudy3"])
def test_a_sequence_that_the_user_unpacked_is_there(server, tmp_path, layout):
    laid(tmp_path / layout)
    assert server.fetch(tmp_path).there == {NAME: 3}
    assert not server.asked
    assert (tmp_path / layout / "notes.txt").read_text() == "mine"
    assert set(siamloc.data.read("cold", root=tmp_path).sequence.tolist()) == {NAME}


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda place: laid(place, images=[]), "lacks 3 of the 3 images in its list, the first t0.5.*, and holds none"),
        (lambda place: laid(place, images=IMAGES[:1]), "lacks 2 of the 3 .*, and holds 1 in omni_cam"),
        (lambda place: (laid(place), (place / "places.lst").unlink()), "has no list localization/places.lst"),
        (
            lambda place: (laid(place), (place / "places.lst").write_text("a b c")),
            "has no list that can be used: .*line 1",
        ),
        (lambda place: (place.mkdir(parents=True), (place / "notes.txt").touch()), "holds notes.txt, and no sequence"),
        (lambda place: (place.parent.mkdir(parents=True), place.touch()), "is a file"),
    ],
)
def test_nothing_of_the_user_is_replaced(server, tmp_path, make, says):
    place = tmp_path / PLACE
    make(place)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(DataError, match=rf"{place} {says}.*: it is not replaced; move it away, or choose another"):
        server.fetch(tmp_path)
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert not server.asked
    listed = server.fetch(tmp_path, only_list=True)
    assert listed.missing == [NAME]
    assert "it is not replaced" in listed.notes[0]


def test_a_list_without_a_folder_is_named(server, tmp_path):
    laid(tmp_path, images=[])
    place = (tmp_path / "places.lst").rename(tmp_path / "freiburg_seq2_cloudy3.places.lst")
    with pytest.raises(DataError, match=f"^{place} has no folder freiburg_seq2_cloudy3 with its images next to it: it"):
        server.fetch(tmp_path)
    assert not server.asked
    assert siamloc.data.read("cold", root=tmp_path).sequence.tolist() == [NAME] * 3


@pytest.mark.parametrize("copy", ["freiburg/part_a/seq2_cloudy3", "freiburg_seq2_cloudy3.places.lst"])
def test_a_second_copy_is_noted(server, tmp_path, copy):
    laid(tmp_path / PLACE)
    copy = tmp_path / copy
    if copy.suffix:
        copy.write_bytes((tmp_path / PLACE / "places.lst").read_bytes())
    else:
        laid(copy, images=[])
    found = server.fetch(tmp_path)
    assert found.there == {NAME: 3}
    note = f"sequence {NAME} appears twice, as {tmp_path / PLACE} and as {copy}: remove one, or data=cold refuses both"
    assert found.notes[1:] == [note]
    with pytest.raises(DataError, match=f"sequence {NAME} appears twice"):
        siamloc.data.read("cold", root=tmp_path)


def test_folders_of_one_camera_each_are_no_copies(server, tmp_path):
    for camera, place in {"omni_cam": PLACE, "std_cam": "freiburg/part_a/seq2_cloudy3"}.items():
        laid(tmp_path / place)
        (tmp_path / place / "omni_cam").rename(tmp_path / place / camera)
    assert len(server.fetch(tmp_path).notes) == 1, "of the number of frames"
    assert len(siamloc.data.read("cold", root=tmp_path)) == 3


def test_what_is_put_there_during_the_loading_is_not_replaced(server, tmp_path, monkeypatch):
    load = fetching._load
    monkeypatch.setattr(fetching, "_load", lambda *words: (load(*words), laid(tmp_path / PLACE)))
    with pytest.raises(StorageError, match="not empty"):
        server.fetch(tmp_path)
    assert (tmp_path / PLACE / "notes.txt").read_text() == "mine"


@pytest.mark.skipif(sys.version_info >= (3, 14), reason="which extracts by a filter of its own")
@pytest.mark.filterwarnings("ignore:Python 3.14 will:DeprecationWarning")
def test_archives_are_checked_by_an_older_python_too(server, tmp_path, monkeypatch):
    for name in ("data_filter", "FilterError"):
        monkeypatch.delattr(tarfile, name, raising=False)
    for outside in ("../evil", "/evil"):
        server.files[PATH] = tar(further=[tarfile.TarInfo(outside)])
        with pytest.raises(DataError, match=f"holds {outside}, which lies outside of its own folder"):
            server.fetch(tmp_path)
        (tmp_path / f"{PLACE}.tar").unlink()
    server.files[PATH] = tar()
    assert server.fetch(tmp_path).there == {NAME: 3}


def test_one_missing_archive_does_not_stop_the_others(server, tmp_path):
    protocol = Protocol(train=Role(sequences=("freiburg_a_seq2_sunny4", NAME)), query=Role(sequences=NAME))
    with pytest.raises(
        DataError,
        match=r"1 of 2 sequences could not be fetched \(freiburg_a_seq2_sunny4\): http.*sunny4\.tar .* 404 Not Found",
    ):
        siamloc.data.fetch("cold", protocol, tmp_path, mirror=server.address)
    found = siamloc.data.fetch("cold", protocol, tmp_path, only_list=True)
    assert found.table() == f"{NAME}: 3 frames\nfreiburg_a_seq2_sunny4: missing"


def test_the_reason_of_each_failure_is_said(server, tmp_path, caplog):
    server.files[PATH] = tar(further=[tarfile.TarInfo("../evil")])
    with pytest.raises(DataError, match="2 of 2 sequences could not be fetched"):
        siamloc.data.fetch("cold", [NAME, "freiburg_a_seq2_sunny4"], tmp_path, mirror=server.address)
    assert re.search(f"{NAME} cannot be fetched: .* holds ../evil", caplog.text)
    assert re.search("freiburg_a_seq2_sunny4 cannot be fetched: .* 404 Not Found", caplog.text)


def test_an_archive_that_the_server_encodes_is_refused(server, tmp_path, capsys):
    server.steps = ["gzip"]
    with pytest.raises(DataError, match="the server sends it encoded as gzip, and was asked for the file as it is"):
        server.fetch(tmp_path)
    server.fetch(tmp_path)
    size = len(server.files[PATH]) // 1000
    assert f"kB: {size} of {size} in" in capsys.readouterr().err


def test_nobody_there(tmp_path):
    with pytest.raises(DataError, match=r"cannot be fetched \(.*refused.*\): 0 bytes are here"):
        siamloc.data.fetch("cold", NAME, tmp_path, mirror="http://127.0.0.1:1", tries=1)


def test_a_host_that_nobody_reaches_is_not_asked_for_each_sequence(tmp_path, monkeypatch, capsys):
    asked = []

    def unreachable(request, timeout):
        asked.append(request.full_url)
        raise URLError("Name or service not known")

    monkeypatch.setattr(fetching, "urlopen", unreachable)
    monkeypatch.setattr(fetching, "_LONGEST_PAUSE", 0.0)
    lying = tmp_path / "cold-freiburg/part_a/seq2_cloudy2.tar"  # unpacked all the same
    lying.parent.mkdir(parents=True)
    lying.write_bytes(tar(inside=["seq2_cloudy2"]))
    names = [NAME, "freiburg_a_seq2_sunny4"]
    with pytest.raises(DataError, match=rf"2 of 3 sequences could not be fetched \({', '.join(names)}\): http"):
        siamloc.data.fetch("cold", [*names, "freiburg_a_seq2_cloudy2"], tmp_path, tries=3)
    assert len(asked) == 3
    assert (lying.parent / "seq2_cloudy2/localization/places.lst").is_file()
    assert lying.is_file(), "an archive of the user's is kept"
    assert capsys.readouterr().err.count(f"fetching {NAME}: Name or service not known; trying again in 0 s") == 2


def test_an_error_of_the_network_is_not_one_of_the_disk(server, tmp_path, monkeypatch):
    read1, fails = HTTPResponse.read1, [OSError(errno.EHOSTUNREACH, "No route to host"), OSError(errno.EIO, "TLS")]

    def unsteady(self, n=-1):
        if fails:
            raise fails.pop()
        return read1(self, n)

    monkeypatch.setattr(HTTPResponse, "read1", unsteady)
    assert server.fetch(tmp_path).there == {NAME: 3}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({}, r"no sequences given: name them, as sequences=\[freiburg_a_seq2_cloudy3\]"),
        ({"sequences": "freiburg_a_seq2_clody3"}, r"no sequence 'freiburg_a_seq2_clody3'; did you mean"),
        ({"sequences": "*", "mirror": "file:///etc"}, "mirror must be an address such as https"),
        ({"sequences": "*", "mirror": "http://[bad"}, r"mirror must be an address such as https.*got 'http://\[bad'"),
        (
            {"sequences": Protocol(train=Role(sequences=("freiburg_a_*", "*seq2_cloudy3")))},
            r"takes '\*seq2_cloudy3', which begins with no building of COLD \(freiburg, .*\): choose another",
        ),
    ],
)
def test_what_cannot_be_fetched_is_one_sentence(words, says):
    with pytest.raises(ConfigError, match=says):
        siamloc.data.fetch("cold", only_list=True, **words)


def test_the_table_has_what_the_protocols_need():
    names = [one.sequence for one in archives()]
    assert len([name for name in names if name.startswith("freiburg")]) == 26
    assert len(set(names)) == len(names)
    assert [one.folder for one in archives(["ljubljana_a_seq1_sunny9"])] == ["cold-ljubljana/part_a/seq1_sunny9"]
    assert len(archives(["saarbruecken_*_cloudy2"])) == 4


def test_the_command_knows_protocols_by_name(server, tmp_path, capsys):
    assert main(["fetch", "cold", "protocol=freiburg_cloudy", f"out={tmp_path}", "--list"]) == 0
    missing = [line.removesuffix(": missing") for line in capsys.readouterr().out.splitlines() if "missing" in line]
    assert len(missing) == 5
    where = [f"out={tmp_path}", f"mirror={server.address}"]
    assert main(["fetch", "cold", f"sequences=[{NAME}]", *where]) == 0
    shown = capsys.readouterr()
    assert f"{NAME}: 3 frames\nnote: " in shown.out
    assert "next:" not in shown.out, "no protocol was given"
    assert main(["fetch", "cold", "protocol=freiburg_cloudy", *where]) == 2
    assert f"{NAME}: 3 frames\nfreiburg_a_seq2_cloudy1: missing\n" in capsys.readouterr().out
    for one in archives([name for name in missing if name != NAME]):
        laid(tmp_path / one.folder)
    assert main(["fetch", "cold", "protocol=freiburg_cloudy", *where]) == 0
    shown = capsys.readouterr()
    assert f"next: siamloc train data=cold data.root={tmp_path} protocol=freiburg_cloudy experiment" in shown.out


def test_sequences_do_not_silently_win_over_a_protocol(tmp_path, capsys):
    assert main(["fetch", "cold", "protocol=freiburg", f"sequences=[{NAME}]", f"out={tmp_path}", "--list"]) == 2
    assert "give sequences=[...] or a protocol, not both" in capsys.readouterr().err


@pytest.mark.slow
def test_two_commands_lead_from_the_server_to_a_trained_network(server, tmp_path, monkeypatch):
    """All seven drives of the protocol, each of 12 pictures of noise with the database's size."""
    server.files.clear()
    noise = np.random.default_rng(0).integers(0, 256, (7, 48, 64, 3), dtype=np.uint8)
    for place, run in zip(
        noise, ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny2", "sunny3"), strict=True
    ):
        names = [f"t{time}.0_x{time / 4}_y0.0_a0.0.jpeg" for time in range(12)]
        picture = cv2.imencode(".jpg", cv2.resize(place, (640, 480)))[1].tobytes()
        archive = tar(listed=names, images=names, inside=[f"seq2_{run}"], content=picture)
        server.files[f"/db/cold-freiburg/part_a/seq2_{run}.tar"] = archive
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIAMLOC_CACHE", str(tmp_path / "cache"))
    assert main(["fetch", "cold", "protocol=freiburg", f"mirror={server.address}"]) == 0
    small = ["epochs=1", "pairs.epoch_batches=1", "pairs.places=3", "pairs.images=2", "trainer.accelerator=cpu"]
    words = ["train", "data=cold", "protocol=freiburg", "experiment=modern", *small, "run=run"]
    assert main([*words, "data.image_size=[32,128]"]) == 0
    assert (tmp_path / "run/checkpoints/best.ckpt").is_file()
