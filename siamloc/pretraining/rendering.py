"""`Renderer`: random buildings, drawn and rendered by other processes before they are needed."""

from __future__ import annotations

from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from siamloc.errors import DataError
from siamloc.simulate.processes import rendering_processes
from siamloc.simulate.views import Views, draw_views

_PATIENCE = 10.0  # seconds for a process to end
Wanted = tuple[Any, ...]
"""Arguments of `draw_views`."""


class Renderer:
    """Render buildings, several at once.

    Args:
        processes: how many processes render; 0 renders in this one, when a building is asked for.
    """

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool: ProcessPoolExecutor | None = None
        self._coming: dict[Wanted, Future[Views]] = {}

    def begin(self, wanted: Wanted) -> None:
        """Let a building be rendered, unless it is already.

        Raises:
            DataError: a process that renders has died.
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
        """Return the pictures of a building; waits where they are not ready.

        Raises:
            DataError: a process that renders has died.
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
            "views.processes, or with 0; in a script of your own, call pretrain under `if __name__ == '__main__':`"
        )

    def close(self) -> None:
        """End the processes at once; what they are at is given up."""
        pool, self._pool = self._pool, None
        self._coming.clear()
        if pool is not None:
            # The executor itself would let each end its building; before Python 3.14 it has no public way to stop them.
            processes = list((getattr(pool, "_processes", None) or {}).values())
            results = getattr(pool, "_result_queue", None)
            pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            for process in processes:
                process.join(_PATIENCE)
                process.kill()
            if results is not None:
                # A building of which half was sent never ends; with no writer left, who reads it knows that.
                results._writer.close()
