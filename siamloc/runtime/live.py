"""`Live`: a web page that shows live where a robot believes itself to be."""

from __future__ import annotations

import asyncio
import errno
import json
import math
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from aiohttp import web
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.columns import spread_rows
from foundation.files import plain
from foundation.settings import Pace, Port, Text
from siamloc.data.frames import room_names
from siamloc.data.occupancy import read_occupancy
from siamloc.errors import ConfigError, DataError, SiamlocError
from siamloc.runtime.localizer import Localizer
from siamloc.runtime.stream import CAMERA, Located, locate_all, named
from siamloc.runtime.thumbnails import jpeg
from siamloc.tables import short_names

_TRACK = 2000  # number of poses of the path so far that a page gets
_DOTS = 4000  # number of map frames that it draws
_COLUMNS = 768  # width of the live image
_SILENCE = 10.0  # seconds without news after which a browser gets a sign of life
_ASSETS = Path(__file__).with_name("assets")
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_STATIC = {
    "/": ("live.html", "text/html"),
    "/live.css": ("live.css", "text/css"),
    "/live.js": ("live.js", "text/javascript"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
_PICTURE = "/map/{row:[0-9]{1,9}}.jpg"
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Live:
    """Locates images one after the other, and serves a web page to watch it: `with Live(...) as page`.

    The page is read-only, and reachable from this machine only, unless `host` says otherwise. Any number of browsers
    may watch; none of them slows the robot down, since a slow one gets only the newest state. What is kept in memory is
    bounded: the last 2,000 poses and one image.

    Args:
        localizer: locates the images.
        images: image files, folders, videos, and cameras such as "camera:0"; or one.
        track: follow the robot from image to image; see `locate_all`.
        odometry: table of the robot's odometry, for `track`; see `locate_all`.
        host: address to listen on; "0.0.0.0" stands for all addresses of this machine.
        port: port to listen on; 0 picks a free one, which `url` shows.
        fps: maximum number of images per second, as on a robot; 0 for as fast as they are located. Cameras keep their
            own pace.
        plan: map.yaml of a map server, which is drawn behind the floor plan; see `siamloc.data.read_occupancy`.

    Raises:
        ConfigError: no images, a bundle that cannot follow a robot, an address that this machine does not have, or a
            port that is in use.
        DataError: a file that does not exist, a folder without images, or a map.yaml that cannot be read or shows
            another part of the world.

    Example:
        with siamloc.runtime.Live(siamloc.runtime.Localizer("bundle"), "drive.mp4") as page:
            print(page.url)
            page.join()
    """

    @typed
    def __init__(
        self,
        localizer: Localizer,
        images: str | Path | Sequence[str | Path],
        *,
        track: bool = False,
        host: Text = "127.0.0.1",
        port: Port = 8000,
        fps: Pace = 5.0,
        odometry: str | Path | None = None,
        plan: str | Path | None = None,
    ) -> None:
        self.host, self.fps = host, fps
        named(images)
        if track:
            localizer.tracker()
        self._plan = None if plan is None else read_occupancy(plan)
        if self._plan is not None:
            self._plan.check(localizer.map.frames.xy, localizer.unit)
        self._localizer, self._images, self._track, self._odometry = localizer, images, track, odometry
        self._socket = _listening(host, port)
        self.port: int = self._socket.getsockname()[1]
        self._lock, self._stopped, self._ended = threading.Lock(), threading.Event(), threading.Event()
        self._state: dict[str, Any] = {"status": "waiting", "number": 0, "text": "waiting for the first image"}
        self._way: deque[tuple[int, list[Any]]] = deque(maxlen=_TRACK)
        self._panorama: NDArray[np.uint8] | None = None
        self._left_out, self._lost, self._why = 0, 0, ""
        self._fault: Exception | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._up = threading.Event()
        self._changed = asyncio.Event()  # set as soon as this state is outdated; the next state gets another event
        self._threads = [threading.Thread(target=target, daemon=True) for target in (self._serve, self._play)]

    def __enter__(self) -> Live:
        self._loop = asyncio.new_event_loop()
        for thread in self._threads:
            thread.start()
        if not self._up.wait(_SILENCE):
            self.close()
            raise ConfigError(f"the page did not come up within {_SILENCE:.0f} s at {self.url}: try another port")
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address of the page."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::") else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    @property
    def count(self) -> int:
        """Number of images so far."""
        return int(self._state["number"])

    @property
    def summary(self) -> str:
        """How many images were located so far and are lost, and why the first that was left out could not be."""
        if not self._left_out:
            return f"{self.count} images, {f'{self._lost} lost, the others located' if self._lost else 'all located'}"
        lost = f"; {self._lost} of the others are lost" if self._lost else ""
        return f"{self._left_out} of {self.count} images could not be located, the first: {self._why}{lost}"

    def join(self, seconds: float | None = None) -> bool:
        """Wait until the last image is located, and return whether it is; the page stays until `close`.

        Args:
            seconds: maximum time to wait; without limit if None.

        Raises:
            DataError, FormatError: the error that stopped it early.
        """
        ended = self._ended.wait(seconds)
        if self._fault is not None:
            raise self._fault
        return ended

    def close(self) -> None:
        """Stop locating, and take the page down."""
        self._stopped.set()
        if self._loop is not None and self._threads[0].is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            for thread in self._threads:
                thread.join(5)
        self._socket.close()

    def _play(self) -> None:
        """Locate the images, and publish each outcome."""
        try:
            located = locate_all(
                self._localizer, self._images, track=self._track, seen=self._keep, odometry=self._odometry
            )
            due = time.monotonic()
            for one in located:
                self._tell(one)
                live = one.image.startswith(CAMERA)
                due = max(due + (0 if live or not self.fps else 1 / self.fps), time.monotonic() - 1)
                if self._stopped.wait(max(0.0, due - time.monotonic())):
                    located.close()
                    break
        except Exception as error:  # a page that stops says why
            ours = isinstance(error, SiamlocError)
            self._fault = error if ours else DataError(f"locating ended ({type(error).__name__}: {error})")
        text = self.summary if self._fault is None else str(self._fault)
        self._publish({**self._state, "status": "fault" if self._fault else "ended", "text": text})
        self._ended.set()

    def _keep(self, panorama: NDArray[np.uint8]) -> None:
        self._panorama = panorama

    def _tell(self, one: Located) -> None:
        number, location = self.count + 1, one.location
        # What is known of the last image that was located stays until another one is.
        state: dict[str, Any] = {**self._state, "status": "running", "number": number, "text": one.fault}
        if location is None:
            state["status"] = "left out"
            self._left_out += 1
            self._why = self._why or one.fault
        else:
            told = one.as_dict()
            for candidate in told["candidates"]:  # viewers need not know the folders
                candidate["image"] = Path(candidate["image"]).name
            state.update({key: value for key, value in told.items() if key != "image"})
            state.update(located=number, name=Path(one.image).name)
            self._lost += bool(location.lost)
            if location.lost:  # nothing is claimed: the candidates are all that is known
                state.update(dict.fromkeys(("x", "y", "theta", "room", "error_m", "off_by", "covariance")))
            state["picture"] = self._localizer.bundle.thumbnail(location.candidates[0].row) is not None
            if not math.isnan(location.x):
                with self._lock:
                    self._way.append((number, plain([location.x, location.y, bool(location.lost)])))
        self._publish(state)

    def _publish(self, state: dict[str, Any]) -> None:
        with self._lock:
            self._state = state
        assert self._loop is not None
        with suppress(RuntimeError):  # the page is already closed
            self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    def _serve(self) -> None:
        """Answer browsers until the loop is stopped."""

        @web.middleware
        async def guarded(request: web.Request, handler: Any) -> web.StreamResponse:
            # A foreign page may point a host name of its own at this machine, and could then read this page.
            try:
                asked = request.url.host
            except ValueError as error:
                raise web.HTTPBadRequest(text="this is not an address") from error
            if self.host in _LOOPBACK and asked not in _LOOPBACK:
                raise web.HTTPForbidden(text="this page can be opened on this machine only")
            answer: web.StreamResponse = await handler(request)
            return answer

        async def headed(request: web.Request, response: web.StreamResponse) -> None:
            response.headers.update(_HEADERS)

        loop = self._loop
        assert loop is not None
        asyncio.set_event_loop(loop)
        application = web.Application(middlewares=[guarded])
        application.on_response_prepare.append(headed)
        pages = {
            "/map.json": self._map,
            "/events": self._events,
            "/live.jpg": self._live,
            "/plan.png": self._building,
            _PICTURE: self._matched,
        }
        for path, handler in {**dict.fromkeys(_STATIC, self._static), **pages}.items():
            application.router.add_get(path, handler)
        runner = web.AppRunner(application, access_log=None, handle_signals=False, shutdown_timeout=0.5)
        loop.run_until_complete(runner.setup())
        loop.run_until_complete(web.SockSite(runner, self._socket).start())
        self._up.set()
        loop.run_forever()
        self._wake()
        loop.run_until_complete(runner.cleanup())
        loop.close()

    async def _static(self, request: web.Request) -> web.StreamResponse:
        name, kind = _STATIC[request.path]
        return web.Response(text=(_ASSETS / name).read_text(encoding="utf-8"), content_type=kind, charset="utf-8")

    async def _map(self, request: web.Request) -> web.StreamResponse:
        """Answer with the constant data: the map's frames and rooms."""
        frames = self._localizer.map.frames
        rows = np.flatnonzero(frames.has_position)
        rows = rows[spread_rows(len(rows), _DOTS)]
        rooms, room = np.unique(room_names(frames)[0][rows], return_inverse=True)
        about: dict[str, Any] = {
            "bundle": self._localizer.bundle.path.name,
            "unit": self._localizer.unit,
            "frames": len(frames),
        }
        x, y = frames.xy[rows].round(3).T
        if self._plan is not None:
            about["plan"] = {**self._plan.placed(), "around": self._plan.around(frames.xy).T}
        return web.json_response(plain({**about, "rooms": short_names(rooms.tolist()), "room": room, "x": x, "y": y}))

    async def _events(self, request: web.Request) -> web.StreamResponse:
        """Send the newest state whenever it changes; a slow browser misses states in between."""
        response = web.StreamResponse(headers={"Content-Type": "text/event-stream"})
        told, last, first = None, 0, True
        with suppress(ConnectionError):  # the browser is closed
            await response.prepare(request)
            while not self._stopped.is_set() or told is not self._state:  # the last state is sent in any case
                changed = self._changed
                with self._lock:
                    state = self._state
                    way = [(number, pose) for number, pose in self._way if number > last]
                if state is told:
                    try:
                        await asyncio.wait_for(changed.wait(), _SILENCE)
                    except asyncio.TimeoutError:
                        await response.write(b": still there\n\n")
                    continue
                message = {**state, "track": [pose for _, pose in way], "first": first}
                await response.write(f"data: {json.dumps(message, allow_nan=False)}\n\n".encode())
                told, first, last = state, False, way[-1][0] if way else last
        return response

    async def _live(self, request: web.Request) -> web.StreamResponse:
        """Answer with the newest panorama."""
        return _picture(None if self._panorama is None else jpeg(self._panorama, _COLUMNS))

    async def _building(self, request: web.Request) -> web.StreamResponse:
        """Answer with the picture of the building."""
        return _picture(None if self._plan is None else self._plan.png(), "image/png")

    async def _matched(self, request: web.Request) -> web.StreamResponse:
        """Answer with the thumbnail of a map frame."""
        row = int(request.match_info["row"])
        return _picture(self._localizer.bundle.thumbnail(row) if row < len(self._localizer.map) else None)


def _picture(content: bytes | None, kind: str = "image/jpeg") -> web.Response:
    """Return the answer with a picture.

    Raises:
        HTTPNotFound: there is none.
    """
    if content is None:
        raise web.HTTPNotFound
    return web.Response(body=content, content_type=kind)


def _listening(host: str, port: int) -> socket.socket:
    """Return a listening socket.

    Raises:
        ConfigError: an address that this machine does not have, or a port that is in use or not allowed.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(f"port {port} of {host} is in use: choose another, such as port={port + 1}") from error
        raise ConfigError(f"this machine cannot serve at host={host} port={port}: {error.strerror or error}") from error
