"""`Renderer`: draw and render random buildings in other processes before they are needed."""

from __future__ import annotations

from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from siamloc.errors import DataError
from siamloc.simulate.produce import rendering_processes
from siamloc.simulate.views import Views, draw_views

_PATIENCE = 10.0  # seconds for a process to end
Wanted = tuple[Any, ...]
"""Arguments of `draw_views`."""


class Renderer:
    """Render buildings, several at once.

    Args:
        processes: number of rendering processes; 0 renders in this one, when a building is requested.
    """

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool: ProcessPoolExecutor | None = None
        self._coming: dict[Wanted, Future[Views]] = {}

    def begin(self, wanted: Wanted) -> None:
        """Start rendering a building, unless that was done already.

        Raises:
            DataError: a rendering process has died.
        """
        if not self._processes or wanted in self._coming:
            return
        if self._pool is None:
            self._pool = rendering_processes(self._processes)
        try:
            self._coming[wanted] = self._pool.submit(draw_views, *wanted)
        except BrokenProcessPool as error:
            raise self._died() from error

    def views(self, wanted: Wanted) -> Views:
        """Return the images of a building; waits if they are not ready.

        Raises:
            DataError: a rendering process has died.
        """
        if not self._processes:
            return draw_views(*wanted)
        self.begin(wanted)
        try:
            return self._coming.pop(wanted).result()
        except BrokenProcessPool as error:
            raise self._died() from error

    def _died(self) -> DataError:
        self.close()
        return DataError(
            "a process that renders buildings died, perhaps for lack of memory: call it again with fewer "
            "views.processes, or with 0; in your own script, call pretrain under `if __name__ == '__main__':`"
        )

    def close(self) -> None:
        """End the processes at once; unfinished work is discarded."""
        pool, self._pool = self._pool, None
        self._coming.clear()
        if pool is not None:
            # The executor would let each finish its building; before Python 3.14 it has no public way to stop them.
            processes = list((getattr(pool, "_processes", None) or {}).values())
            results = getattr(pool, "_result_queue", None)
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            for process in processes:
                process.join(_PATIENCE)
                process.kill()
            if results is not None:
                # A building that was half sent would never end; with no writer left, the reader notices.
                results._writer.close()
