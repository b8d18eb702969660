"""The page that shows where the robot is: what it serves, to whom, and what a browser shows."""

from __future__ import annotations

import http.client
import json
import shutil
import socket
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

import siamloc
from siamloc import maps, runtime
from siamloc.cli import main
from siamloc.errors import ConfigError, DataError
from siamloc.jobs import Watch
from siamloc.models import as_descriptor, build
from siamloc.runtime import live as live_module
from tests.siamloc.report.browser import CHROMIUM, DRIVER, Browser
from tests.siamloc.report.pages import write_occupancy


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A bundle with pictures, and a folder of images with poses in their names."""
    example = siamloc.data.example()
    folder = tmp_path_factory.mktemp("live")
    images = siamloc.data.PanoramaLibrary(example.frames, folder / "cache", image_size=(32, 64))
    monday, tuesday = (example.frames.select(sequence=day) for day in ("monday", "tuesday"))
    exported(folder / "bundle", images, monday)
    drive = folder / "drive"
    drive.mkdir()
    for row, path in enumerate(tuesday.path.tolist()):
        x, y = tuesday.xy[row]
        name = f"t{1000 + row}.000000_x{x:.6f}_y{y:.6f}_a0.100000.png"
        shutil.copy(path, drive / name)
    return folder, len(tuesday)


def exported(folder, images, frames):
    """Export a bundle with pictures, whose map holds these frames."""
    network = as_descriptor(build("simple1", "fourier", (32, 64), circular=True))
    known = maps.build(network, images, frames, progress=False)
    runtime.export(network, known, folder, images=images, thumbnails=True)


@pytest.fixture
def played(world):
    """A page whose images have all been located."""
    with served(world, fps=0) as page:
        assert page.join(30)
        yield page


def state_of(page):
    """Return the first state that a browser receives."""
    events = Events(page)
    state = next(events)
    events.close()
    return state


def served(world, images=None, **options):
    """Return a page on the bundle that locates the images at once."""
    return runtime.Live(runtime.Localizer(world[0] / "bundle"), images or world[0] / "drive", port=0, **options)


def asked(page, path, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    try:
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


class Events:
    """The events that a browser receives."""

    def __init__(self, page):
        self._connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
        self._connection.request("GET", "/events")
        self._answer = self._connection.getresponse()
        assert self._answer.getheader("Content-Type") == "text/event-stream"

    def __next__(self):
        while not (line := self._answer.readline()).startswith(b"data: "):
            assert line, "the stream has ended"
        return json.loads(line.removeprefix(b"data: "))

    def close(self):
        self._answer.close()
        self._connection.close()


def test_a_late_browser_gets_the_whole_state(world, played):
    _, count = world
    state = state_of(played)
    assert (state["status"], state["number"], state["first"]) == ("ended", count, True)
    assert len(state["track"]) == count
    assert state["off_by"] == pytest.approx(np.hypot(state["x"] - state["pose"]["x"], state["y"] - state["pose"]["y"]))
    assert state["picture"] is True
    assert state["candidates"][0]["row"] >= 0
    assert "/" not in json.dumps(state), "no folders"


def test_what_is_served(world, played):
    status, headers, body = asked(played, "/")
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert b"siamloc" in body
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    for path in ("/live.css", "/live.js", "/icon.svg"):
        assert asked(played, path)[0] == 200
    known = json.loads(asked(played, "/map.json")[2])
    assert known["bundle"] == "bundle"
    assert len(known["x"]) == len(known["y"]) == len(known["room"]) == known["frames"]
    for path in ("/live.jpg", "/map/0.jpg"):
        status, headers, body = asked(played, path)
        assert (status, headers["Content-Type"]) == (200, "image/jpeg")
        assert cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_COLOR) is not None


def test_the_building_is_served_behind_the_plan(world, tmp_path):
    xy = runtime.Localizer(world[0] / "bundle").map.frames.xy
    file = write_occupancy(tmp_path, xy.min(axis=0) - 1)
    with served(world, plan=file) as page:
        known = json.loads(asked(page, "/map.json")[2])["plan"]
        status, headers, body = asked(page, "/plan.png")
    expected = siamloc.data.read_occupancy(file)
    assert {key: known[key] for key in expected.placed()} == expected.placed()
    np.testing.assert_allclose(np.array(known["around"]).T, expected.around(xy))
    assert (status, headers["Content-Type"], body) == (200, "image/png", expected.png())
    with pytest.raises(DataError, match="no position lies on the occupancy map"):
        served(world, plan=write_occupancy(tmp_path, xy.min(axis=0) - 1e4))


def test_nothing_else_is_served_or_taken(played):
    for path in ("/map/99999.jpg", "/map/-1.jpg", "/map/x.jpg", "/../bundle.json", "/bundle.json", "/no", "/plan.png"):
        assert asked(played, path)[0] == 404, path
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
        for path in ("/", "/events", "/map.json"):
            assert asked(played, path, method)[0] == 405, (method, path)
    # the name of another site for this machine
    assert asked(played, "/map.json", Host="evil.example:80")[0] == 403
    assert asked(played, "/map.json", Host=f"localhost:{played.port}")[0] == 200


def test_every_image_is_told_while_it_happens(world):
    _, count = world
    with served(world, fps=20) as page:
        events, numbers, way = Events(page), [], []
        state = {}
        while state.get("status") != "ended":
            state = next(events)
            numbers.append(state["number"])
            way = ([] if state["first"] else way) + state["track"]
        events.close()
        assert numbers == sorted(numbers)
        assert numbers[-1] == count == len(way)
        assert page.count == count
    with pytest.raises(ConnectionRefusedError):
        asked(page, "/")


def test_a_browser_that_does_not_read_holds_nobody_up(world):
    with served(world, [world[0] / "drive"] * 20, fps=0) as page:
        idle = socket.create_connection(("127.0.0.1", page.port))
        idle.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert page.join(60)
        assert asked(page, "/map.json")[0] == 200
        idle.close()


def test_browsers_that_leave_at_once_leave_no_trace(played, caplog):
    for _ in range(20):
        with socket.create_connection(("127.0.0.1", played.port)) as hasty:
            hasty.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert asked(played, "/map.json")[0] == 200
    assert caplog.text == ""


def test_the_way_is_bounded(world, monkeypatch):
    monkeypatch.setattr(live_module, "_TRACK", 5)
    _, count = world
    with served(world, fps=0) as page:
        page.join(30)
        state = state_of(page)
        assert len(state["track"]) == min(5, count)


def test_images_that_cannot_be_read_are_left_out_and_said(world, tmp_path):
    (tmp_path / "a.png").write_bytes(b"nothing")
    with served(world, tmp_path, fps=0) as page:
        page.join(30)
        state = state_of(page)
        assert (state["number"], state["status"]) == (1, "ended")
        assert state["text"] == page.summary
        assert page.summary.startswith("1 of 1 images could not be located, the first: ")
        assert "not an image" in page.summary
        assert asked(page, "/live.jpg")[0] == 404


def test_after_an_image_that_cannot_be_read_the_last_location_stays(world, played, tmp_path):
    (tmp_path / "z.png").write_bytes(b"nothing")
    with served(world, [world[0] / "drive", tmp_path], fps=0) as page:
        page.join(30)
        state, before = state_of(page), state_of(played)
        assert (state["number"], state["located"]) == (before["number"] + 1, before["located"])
        changed = {key for key in before if state[key] != before[key]}
        assert changed <= {"number", "text", "ms"}
        assert asked(page, "/live.jpg")[2] == asked(played, "/live.jpg")[2]


def test_an_empty_video_ends_in_a_sentence(world, tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"")
    with served(world, tmp_path / "a.mp4") as page:
        with pytest.raises(DataError, match=r"a\.mp4 cannot be read as a video"):
            page.join(30)
        state = state_of(page)
        assert (state["status"], "cannot be read" in state["text"]) == ("fault", True)


def test_a_port_in_use_and_an_unknown_address_are_one_sentence(world, played):
    localizer, drive = runtime.Localizer(world[0] / "bundle"), world[0] / "drive"
    for options, says in (
        ({"port": played.port}, f"port {played.port} of 127.0.0.1 is in use: choose another, such as port="),
        ({"host": "192.0.2.1", "port": 0}, r"this machine cannot serve at host=192\.0\.2\.1"),
        ({"port": 70_000}, "port must be a whole number from 0 to 65,535"),
        ({"fps": -1}, "fps must be 0, or a number from 0.001 to 1,000"),
    ):
        with pytest.raises(ConfigError, match=says):
            runtime.Live(localizer, drive, **options)
    with pytest.raises(DataError, match="there is no image"):
        runtime.Live(localizer, drive / "none.png", port=0)


def test_without_images_or_a_bundle_the_command_says_so(world, capsys):
    assert main(["live", f"bundle={world[0] / 'bundle'}"]) == 2
    assert "no images given" in capsys.readouterr().err
    assert main(["live", "prot=3"]) == 2
    assert "did you mean 'port'" in capsys.readouterr().err
    assert Watch.of({"images": ["a"]}).port == 8000


def test_the_command_serves_until_it_is_interrupted(world):
    folder, count = world
    command = [sys.executable, "-m", "siamloc", "live", f"bundle={folder / 'bundle'}", f"images=[{folder / 'drive'}]"]
    process = subprocess.Popen([*command, "port=0", "fps=0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        url = process.stdout.readline()
        assert url.startswith("http://127.0.0.1:")
        assert process.stdout.readline() == f"{count} images, all located; the page stays until Ctrl-C\n"
        process.send_signal(2)
        assert process.wait(20) == 130
        assert process.stderr.read() == ""
    finally:
        process.kill()
        process.stdout.close()
        process.stderr.close()
        process.wait()


def test_without_the_framework_the_extra_is_named(world):
    code = (
        "import sys\nsys.modules['aiohttp'] = None\nfrom siamloc.cli import main\n"
        f"sys.exit(main(['live', 'bundle={world[0] / 'bundle'}', 'images=[{world[0] / 'drive'}]']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install '.[live]'" in done.stderr


def test_a_lost_robot_is_nowhere(world, monkeypatch):
    folder, _ = world
    localizer = runtime.Localizer(folder / "bundle")
    locate = localizer.locate
    monkeypatch.setattr(localizer, "locate", lambda *given, **more: replace(locate(*given, **more), lost=True))
    with runtime.Live(localizer, folder / "drive", port=0, fps=0) as page:
        assert page.join(30)
        state = state_of(page)
    assert state["lost"] is True
    assert state["text"] == f"{state['number']} images, {state['number']} lost, the others located"
    assert len(state["candidates"]) == 3
    assert {state[key] for key in ("x", "y", "theta", "room", "error_m", "off_by", "covariance")} == {None}


with_browser = pytest.mark.skipif(CHROMIUM is None or DRIVER is None, reason="there is no chromium here")


@with_browser
@pytest.mark.parametrize("width", [600, 1400])
def test_the_plan_names_every_room_and_draws_in_pixels(world, tmp_path, width):
    monday = siamloc.data.example().frames.select(sequence="monday")
    rooms = [f"a room with a long name {row}" for row in range(len(monday))]
    frames = siamloc.data.FrameTable(path=monday.path, x=[0, 20] * 6, y=np.repeat(range(6), 2), room=rooms)
    exported(tmp_path / "bundle", siamloc.data.PanoramaLibrary(frames, image_size=(32, 64)), frames)
    with (
        runtime.Live(runtime.Localizer(tmp_path / "bundle"), world[0] / "drive", port=0, fps=0) as page,
        Browser(tmp_path / "profile", width) as browser,
    ):
        browser.go(page.url)
        browser.wait("document.querySelector('#plan .body')")
        names, inside, dot, text, robot = browser.run(
            "const box = (kind) => document.querySelector(`#plan ${kind}`).getBBox();"
            "const names = [...document.querySelectorAll('#plan .names text')];"
            "const { width } = document.getElementById('plan').getBoundingClientRect();"
            "const inside = ({ x, width: long }) => x >= 0 && x + long <= width;"
            "return [names.map((text) => text.textContent), names.every((text) => inside(text.getBBox())),"
            "  box('.dot').width, box('.scale text').height, box('.body').width]"
        )
        assert sorted(names) == sorted(rooms)
        assert inside
        assert (dot, robot) == pytest.approx((4.4, 13), abs=1e-3)  # in pixels; boxes are in single precision
        assert 10 < text < 20
        assert browser.complaints() == []


@with_browser
def test_a_map_without_positions_has_no_plan(world, tmp_path):
    frames = siamloc.data.example().frames.select(sequence="monday")
    frames = siamloc.data.FrameTable(path=frames.path, room=frames.room)
    exported(tmp_path / "bundle", siamloc.data.PanoramaLibrary(frames, image_size=(32, 64)), frames)
    with (
        runtime.Live(runtime.Localizer(tmp_path / "bundle"), world[0] / "drive", port=0, fps=0) as page,
        Browser(tmp_path / "profile") as browser,
    ):
        browser.go(page.url)
        browser.wait("document.getElementById('status').dataset.state === 'ended'")
        shown = browser.run("return ['no-plan', 'legend'].map((id) => !document.getElementById(id).hidden)")
        assert shown == [True, False]
        assert browser.run("return document.getElementById('position').textContent") == "unknown"
        assert browser.complaints() == []


@with_browser
def test_a_browser_watches_a_drive(world, tmp_path):
    folder, count = world
    (tmp_path / "profile").mkdir()
    hostile = tmp_path / "<img src=x onerror=alert(1)>"
    hostile.mkdir()
    shutil.copy(next((folder / "drive").iterdir()), hostile / "<b>a.png")
    images = [folder / "drive", hostile]
    with served(world, images, fps=20) as page, Browser(tmp_path / "profile") as browser:
        browser.go(page.url)
        browser.wait("document.getElementById('status').dataset.state === 'ended'")
        told = browser.run(
            "const text = (id) => document.getElementById(id).textContent;"
            "return [text('status'), text('number'), text('name'), text('room'), text('position'), text('banner'),"
            "document.querySelectorAll('#plan .dot').length, document.querySelectorAll('#plan .body').length,"
            "document.querySelectorAll('#candidates tr').length]"
        )
        assert told[:3] == ["end of the drive", str(count + 1), "<b>a.png"]
        assert told[3] != "–"
        assert len(told[4].split(", ")) == 2
        assert told[5] == f"End of the drive: {count + 1} images, all located"
        assert told[6:] == [json.loads(asked(page, "/map.json")[2])["frames"], 1, 3]
        browser.wait("document.getElementById('match').complete && document.getElementById('match').naturalWidth > 0")
        places = {url.split("?")[0].rpartition("/")[0] for url in browser.requests() if url.startswith("http")}
        assert places == {page.url[:-1], f"{page.url}map"}
        assert browser.complaints() == []
        page.close()
        browser.wait("document.getElementById('status').dataset.state === 'away'")
