"""A headless Chromium for tests, driven over WebDriver's plain HTTP."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import urllib.error
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
_SECONDS = 60.0


class Browser:
    """A browser with one window, and a log of everything it requested or complained about.

    Args:
        profile: empty folder for the browser's own files.
        width: width of the window in pixels.
    """

    def __init__(self, profile: Path, width: int = 1000) -> None:
        assert CHROMIUM is not None
        assert DRIVER is not None
        # The driver chooses a free port itself and says which.
        self._driver = subprocess.Popen([DRIVER, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        try:
            self._base = f"http://127.0.0.1:{self._port()}/session"
            arguments = [
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--disable-background-networking",
                "--no-first-run",
                "--hide-scrollbars",
                "--force-device-scale-factor=1",
                f"--window-size={width},1400",
                f"--user-data-dir={profile}",
            ]
            wanted = {
                "browserName": "chrome",
                "goog:chromeOptions": {"binary": CHROMIUM, "args": arguments},
                "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"},
                "timeouts": {"script": 20_000, "pageLoad": 40_000},
            }
            made = self._ask("POST", "", {"capabilities": {"alwaysMatch": wanted}})
        except BaseException:
            self._stop()
            raise
        self._base += f"/{made['sessionId']}"

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        try:
            self._ask("DELETE", "")
        finally:
            self._stop()

    def open(self, page: Path) -> None:
        """Open a file and wait until it is loaded."""
        self.go(page.resolve().as_uri())

    def go(self, url: str) -> None:
        """Open an address and wait until it is loaded."""
        self._ask("POST", "/url", {"url": url})

    def run(self, script: str, *arguments: Any) -> Any:
        """Run the body of a JavaScript function and return what it returns."""
        return self._ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, condition: str) -> None:
        """Wait until a JavaScript expression holds, looked at with every frame; the driver limits the time."""
        script = f"""
            const done = arguments[arguments.length - 1];
            const look = () => ({condition}) ? done(true) : requestAnimationFrame(look);
            look();
        """
        self._ask("POST", "/execute/async", {"script": script, "args": []})

    def key(self, selector: str, *keys: str) -> None:
        """Type keys into an element."""
        element = self._ask("POST", "/element", {"using": "css selector", "value": selector})
        (identifier,) = element.values()
        self._ask("POST", f"/element/{identifier}/value", {"text": "".join(keys)})

    def point(self, x: float, y: float, click: bool = False) -> None:
        """Move the mouse to a place in the window, and press it there."""
        moves: list[dict[str, Any]] = [{"type": "pointerMove", "duration": 0, "x": round(x), "y": round(y)}]
        if click:
            moves += [{"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}]
        pointer = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": moves}
        self._ask("POST", "/actions", {"actions": [pointer]})

    def devtools(self, command: str, **parameters: Any) -> Any:
        """Run a command of the DevTools protocol."""
        return self._ask("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def complaints(self) -> list[str]:
        """Return messages of the console since the last call."""
        return [f"{entry['level']}: {entry['message']}" for entry in self._ask("POST", "/se/log", {"type": "browser"})]

    def requests(self) -> list[str]:
        """Return the addresses requested since the last call."""
        entries = self._ask("POST", "/se/log", {"type": "performance"})
        messages = [json.loads(entry["message"])["message"] for entry in entries]
        return [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]

    def _port(self) -> int:
        assert self._driver.stdout is not None
        said = b""
        for line in self._driver.stdout:
            if found := re.search(rb"started successfully on port (\d+)", line):
                return int(found[1])
            said += line
        raise RuntimeError(f"chromedriver did not start: {said.decode(errors='replace')}")

    def _ask(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self._base + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=_SECONDS) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            with error:
                value = json.load(error)["value"]
            raise RuntimeError(f"{method} {path}: {value['error']}: {value['message']}") from error

    def _stop(self) -> None:
        self._driver.terminate()
        try:
            self._driver.wait(10)
        except subprocess.TimeoutExpired:
            self._driver.kill()
            self._driver.wait()
        if self._driver.stdout is not None:
            self._driver.stdout.close()
