"""`siamloc export`."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from foundation.words import as_words
from siamloc.data import Protocol
from siamloc.errors import SiamlocError
from siamloc.evaluation.estimates import refinement
from siamloc.evaluation.localize import Localization
from siamloc.jobs.choices import Folder
from siamloc.jobs.job import Say, quiet
from siamloc.jobs.replacing import measured_otherwise
from siamloc.jobs.run_job import RunJob, files_in
from siamloc.jobs.stored import map_file
from siamloc.jobs.tasks import HierarchicalTask, Task
from siamloc.maps import Built, ErrorModel, Refinement, VisualMap
from siamloc.results import read_results


@dataclass(frozen=True, kw_only=True)
class Export(RunJob):
    """Write the model file for the robot.

    Writes a bundle with the descriptor (the network as ONNX, or an analytic descriptor), the map and the image
    preprocessing, and compares its output with the original's. If the map holds headings, the robot also gets its
    own. After an evaluation with task.error_model=true it gets its expected error and whether it is lost; after one
    with task.refine its poses are refined in the same way, finer than the map, with covariances that are learned if it
    had a validation drive.

        run=FOLDER              the run
        bundle=FOLDER           output folder; inside the run if not given
        descriptor=hog          another map of the run: of an analytic descriptor, or of the network that ships with
                                siamloc, descriptor=pretrained
        precision=int8          8-bit numbers, for a smaller and faster bundle; float16 for a smaller map only;
                                auto takes the smallest that loses at most 2 % of the error on protocol.validation,
                                and shows what each loses
        build=spectral          the coarse layer that `siamloc map build=spectral` made, for the robot to search first,
                                as set by task=hierarchical task.candidates=1
        task.refine=relative    poses finer than the map without any evaluation; task.neighbours=3. Without a drive
                                with positions nothing is learned, and their covariances are too small
        thumbnails=true         small images of the map frames, which `siamloc live` shows
        overwrite=true          replace a bundle even if robots updated its map

    Example:
        $ siamloc export run=runs/vgg16
    """

    GROUPS: ClassVar[Mapping[str, str]] = {**RunJob.GROUPS, "task": "localization"}

    task: Task
    bundle: Folder | None = None
    precision: Literal["float32", "float16", "int8", "auto"] = "float32"
    thumbnails: bool = False
    overwrite: bool = False

    def run(self, say: Say = quiet) -> Any:
        """Write the bundle for the robot."""
        from siamloc import runtime

        run, label, precision = self.here, self.descriptor.title, self.precision
        described, path = self.make_descriptor(), map_file(run, label)
        known = self.load_map(path, described)
        further: dict[str, Any] = {}
        if known is None:
            further["preprocessing"] = self.preprocessing
        else:
            if self.preprocessing.level and "images" in known.identity:  # the robot would not level its pictures
                known.check_descriptor({**known.identity, "images": self.preprocessing.parameters()})
            evaluation = run.evaluation(label)
            further["errors"] = ErrorModel.saved(evaluation / "error_model.json", known)
            further["refinement"] = self._refinement(evaluation / "refinement.json", known)
            further["figures"] = _figures_in(evaluation / "results.json")
            if self.build.name != "none":
                further["layer"] = Built.load(run.layer(label, self.build.title))
                if isinstance(self.task, HierarchicalTask):
                    further["search"] = self.task.search
            if self.thumbnails or precision in ("int8", "auto"):
                roles = ["validation"] if precision == "auto" else []
                images, opened = self.open_roles(*roles, known=known)
                further |= {"images": images, "thumbnails": self.thumbnails, **opened}
        folder = Path(self.bundle) if self.bundle is not None else run.bundle
        bundle = runtime.export(described, known, folder, precision=precision, overwrite=self.overwrite, **further)
        if folder == run.bundle:
            run.record_written(files_in(folder))
        if compared := runtime.precision_table(bundle):
            say(compared)
        say(bundle.summary())
        if known is not None:
            for line in self._further_steps(known, further["errors"], further["refinement"]):
                say(line)
            where = {"run": str(run.folder)} if folder == run.bundle else {"bundle": str(folder)}
            say(f"next: siamloc localize {as_words({**where, 'images': ['photo.jpeg']})}")
        return bundle

    def _refinement(self, path: Path, known: VisualMap) -> Refinement | None:
        """Return how an evaluation of the map refined poses; or how the task asks for, where that differs."""
        saved = Refinement.saved(path, known)
        if not isinstance(self.task, Localization) or self.task.refine == "none":
            return saved
        asked = refinement(self.task, known.placed())
        assert asked is not None
        wanted = asked.neighbours  # the default asks for no number
        if saved and saved.method == asked.method and wanted in (saved.neighbours, Localization().neighbours):
            return saved
        return asked

    def _further_steps(self, known: VisualMap, errors: ErrorModel | None, refinement: Refinement | None) -> list[str]:
        """Return lines that say what else could be exported for the robot."""
        folder, named, lines = self.here.evaluation(self.descriptor.title), as_words(self.named), []
        none = known.orientation is None and np.isfinite(known.frames.theta).any()
        if none and known.made.get("data", {}).get("circular", True):
            heading = "" if known.descriptor.tells_heading else " heading=hog"
            frames = self.not_stored(self.protocol, "train", "validation", "query")  # which a map does not hand on
            again = f"{named} {as_words(frames)}" if frames else named
            lines.append(f"for a heading as well: siamloc map {again}{heading}, then export again")
        if not known.frames.has_position.any():
            return lines
        if errors is None:
            if (folder / "error_model.json").is_file():
                lines.append("error_model.json left out, it was learned on another map")
            step = self._evaluation(known, named, None if refinement is None else refinement.method)
            lines.append(f"for expected errors, by drives with positions: {step}, then export again")
        if refinement is None:
            if (folder / "refinement.json").is_file():
                lines.append("refinement.json left out, it was learned on another map")
            if getattr(known.descriptor, "compares", False) and known.unit == "m":
                again = "export again with task.refine=relative"
                if errors is not None or not isinstance(self.task, Localization):  # is of poses that are not refined
                    again = f"{self._evaluation(known, named, 'relative')}, then export again"
                lines.append(f"for poses finer than the map: {again}")
        return lines

    def _evaluation(self, known: VisualMap, named: str, refine: str | None) -> str:
        """Return the command that learns the expected errors, by the query drives of the last evaluation.

        If drives are missing, or the data cannot be read, it has names to be filled in.
        """
        protocol = self.protocol
        more: dict[str, Any] = {} if refine is None else {"task.refine": refine}
        folder, words = self.here.evaluation(self.descriptor.title), None
        with suppress(SiamlocError):
            if (folder / "results.json").is_file():
                before = Protocol.of(read_results(folder).get("config", {}).get("protocol") or {})
                protocol = replace(before, train=protocol.train, map=protocol.map)
                if measured_otherwise(folder, protocol, self.data.plain(), only_map=False):
                    more["overwrite"] = True
            frames = self.data.read()
            others = frames.take(frames.has_position & ~np.isin(frames.sequence, known.frames.sequence))
            words = self.for_evaluation(protocol, lambda: others, "query", "validation")
        if words is None:
            words = {f"protocol.{role}.sequences": ["NAME"] for role in ("validation", "query")}
        return f"siamloc evaluate {named} {as_words({**words, 'task.error_model': True, **more})}"


def _figures_in(path: Path) -> dict[str, Any] | None:
    """Return the date of an evaluation and its errors; None if there is no evaluation."""
    if not path.is_file():
        return None
    found = read_results(path.parent)
    overall = {name: part.get("overall") for name, part in found["measures"].items()}
    errors = {name: one["error"] for name, one in overall.items() if isinstance(one, dict) and one.get("error")}
    return {"created": found.get("created"), "errors": errors}
