"""`siamloc report`: one page with everything about a run, or about several side by side."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from siamloc.errors import ConfigError
from siamloc.report import write_report
from siamloc.runs import newest_run


def main(config: DictConfig) -> None:
    """Write the page of the named runs, or of the newest."""
    several = [config.runs] if isinstance(config.runs, str) else list(config.runs or [])
    if several and config.run is not None:
        raise ConfigError(f"give run={config.run} or runs=[...], not both")
    folders = [Path(name) for name in several or ([config.run] if config.run is not None else [newest_run().folder])]
    default = folders[0] / "report.html" if len(folders) == 1 else Path("report.html")
    out = default if config.out is None else Path(config.out)
    if out.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"out={out} must be a page, with the ending .html")
    path = write_report(folders, out)
    print(f"report: {path}, {path.stat().st_size / 1e6:.1f} MB; open it in a browser")
