"""`siamloc evaluate`: calls the function of `siamloc.evaluation` that the task asks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import quote

from analytic import Descriptor
from analytic.descriptors.fused import SIGN
from foundation.files import check_writable, real_path
from foundation.settings import Text
from foundation.words import as_words
from siamloc import evaluation, maps
from siamloc.data import FrameTable, PanoramaLibrary, Protocol, Role, read_occupancy
from siamloc.data.frames import fitting
from siamloc.data.reading import path_keys
from siamloc.errors import ConfigError, hint
from siamloc.evaluation import Result
from siamloc.evaluation.compact_maps import Compact
from siamloc.evaluation.hierarchy import Hierarchical
from siamloc.evaluation.layers import MapMeasures
from siamloc.evaluation.localize import Localization
from siamloc.jobs.choices import OF_A_RUN, DescriptorChoice, names_in
from siamloc.jobs.job import Say, quiet
from siamloc.jobs.options import choices, is_fused
from siamloc.jobs.replacing import measured_otherwise
from siamloc.jobs.run_job import RunJob, by_name, files_in
from siamloc.jobs.stored import map_file, map_known
from siamloc.jobs.sweep import own_folder, sweep_suffix, swept, with_swept
from siamloc.jobs.tasks import BuildingsTask, CompactTask, HierarchicalTask, MappingTask, RobustnessTask, Task
from siamloc.maps import Built, VisualMap
from siamloc.maps.history import UPKEEP
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.runs import Run


@dataclass(frozen=True, kw_only=True)
class Evaluate(RunJob):
    """Measure localization and room retrieval.

    Locates the query frames in the map and writes results.json, queries.csv and plots. Baselines are measured with
    the same evaluator on the same frames.

        run=FOLDER                        the run, or a sweep: each of its runs; only a trained network needs one
        protocol.query.sequences=[...]    sequences of the frames to locate
        task=localization|absolute|room_retrieval|hierarchical|mapping|compact|robustness|buildings
        distance=cosine                   how descriptors are compared: manhattan, euclidean, correlation or cosine
        task.radii=[0.5,1.0]              for recall: how near a map frame must be
        task.baselines=[hog,thumbnail,untrained]
        descriptor=pretrained|hog|...     measure a descriptor other than the trained network, without training; all
                                          groups are listed below
        descriptor=[pretrained,hsv,hog]   several as one; the weights of the map, or learned on protocol.validation
        task.filter=true                  also follow the robot along its drive with a filter;
                                          task.filter_tune=true tunes it on protocol.validation
        task.refine=interpolate           a pose between the three nearest map frames (task.neighbours=3)
        task.refine=relative              a pose from comparing the query with each of them, for a network with
                                          model.relative=true, such as descriptor=pretrained; with task.filter=true
                                          it is filtered as well
        task.error_model=true             the expected error of each query, learned from protocol.validation, and
                                          whether it is lost: above task.lost_above=1.0, or from another building
        heading=hog                       estimates headings for a network; as the map does if not given
        mounting.yaw=90                   how the camera is mounted, as for `siamloc map`; that of the map if not given
        task=hierarchical build=incremental|incremental_sparse|spectral|som|sample|rooms
                                          search the nodes of a map first, then the frames inside the nearest ones
        task.candidates=3                 number of nodes; task.coarse.ratio=1.3 leaves out those much farther than
                                          the nearest, task.along=2 adds two frames of the drive on either side of
                                          the nearest if they are in another node
        task.coarse.descriptor=hog_mapping task.coarse.by=representatives|vote|classifier
                                          how nodes are ranked
        task=compact task.nodes=[10,20,40] task.ways=[spectral,som,sample]
                                          how well maps of so few nodes locate, with one descriptor per node;
                                          task.clusters=gist groups the frames by another descriptor
        task=mapping build=incremental    measure the nodes of a map instead: see `siamloc map --help`
        task=robustness                   error under noise, occlusion, turns and effects
        task=buildings task.maps=[runs/a,runs/b]
                                          which building a query is in, given the maps of several
        plan=map.yaml                     the building, from a map server, to draw behind floor plans
        out=FOLDER                        where results are written; in the run if not given
        overwrite=true                    replace results of other frames, or those in out=FOLDER
        -m descriptor.bins=8,16 distance=euclidean,correlation
                                          a sweep: each result in its own folder, such as
                                          evaluation/hog-euclidean/descriptor.bins-8; `siamloc compare` compares them

    Example:
        $ siamloc evaluate run=runs/vgg16 protocol.query.sequences=['*cloudy2','*night2','*sunny2']
    """

    GROUPS: ClassVar[Mapping[str, str]] = {**RunJob.GROUPS, "task": "localization"}

    task: Task
    out: Text | None = None
    plan: Path | None = None
    overwrite: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        known = choices("descriptor")
        for name in getattr(self.task, "baselines", ()):
            if name not in known and not is_fused(name):
                raise ConfigError(f"unknown descriptor {name!r} in task.baselines: {hint(name, known)}")

    def run(self, say: Say = quiet) -> Result:
        """Measure the task and write its results."""
        run = self.here
        shared = run.evaluation(self.name) if self.out is None else Path(self.out)
        if self.out is None:
            folder = own_folder(shared, self.titles, lambda key: key != "distance")  # which the name of `shared` says
        else:
            folder = shared / sweep_suffix()  # of all swept keys, since `out` says nothing about the run
        self._check_folder(folder)
        occupancy = None if self.plan is None else read_occupancy(self.plan)  # refused before anything is measured
        result = self._measure(say)
        if folder != shared:
            result = replace(result, name=with_swept(result.name))
        if swept():
            result = replace(result, about={**result.about, "swept": dict(swept())})
        result.save(folder, pictures=False)
        self._record(folder)
        say(f"data: {self.data.summary()}")
        say(result.table())
        say(f"results: {folder / 'results.json'}, one row each in {folder / next(iter(result.tables))}.csv")
        if self.task.plots:  # last: a picture that cannot be drawn must not cost the measures
            from siamloc.report.draw import save_all

            try:
                for path in save_all(folder, result.layer, occupancy):
                    say(f"picture: {path}")
            finally:
                self._record(folder)
        return result

    def _record(self, folder: Path) -> None:
        """Record the files of a result folder in the run, unless the user chose the folder."""
        if self.out is None:
            self.here.record_written(files_in(folder))

    @property
    def label(self) -> str:
        """The descriptor's title, with the distance if the user gave one."""
        title = self.descriptor.title
        return title if self.distance is None else f"{title}-{self.distance}"

    @cached_property
    def _other(self) -> tuple[DescriptorChoice | None, str]:
        """The descriptor that ranks or makes nodes, None if it is the map's own; and the label of that descriptor."""
        named: str | None = None
        if isinstance(self.task, HierarchicalTask):
            named = self.task.coarse.descriptor
        elif isinstance(self.task, CompactTask):
            named = self.task.clusters
        if named is None or named == self.descriptor.title:
            return None, self.label
        if (Path(named) / "run.json").is_file():
            return DescriptorChoice.of({"name": "network", "run": named}), f"network-{real_path(named).name}"
        return by_name(named), by_name(named).title

    @property
    def _title(self) -> str:
        """How frames are described, and how nodes are ranked and made: the name of the results in tables."""
        other, label = self._other
        if isinstance(self.task, HierarchicalTask):
            by = [] if self.task.coarse.by == "representatives" else [self.task.coarse.by]
            return "-".join(dict.fromkeys([self.label, label, self.build.title, *by]))
        return self.label if other is None else f"{self.label}-by-{label}"

    @property
    def name(self) -> str:
        """The name of the folder of the results, inside the run's folder `evaluation`."""
        if "absolute" in self.task.names:
            return self._title
        (kind,) = self.task.names
        built = kind == "mapping" or (kind == "buildings" and self.build.name != "none")
        return "-".join([kind, self._title, *([self.build.title] if built else [])])

    def _check_folder(self, folder: Path) -> None:
        """Refuse to replace results of other frames, or any results in the folder `out`, unless requested."""
        check_writable(folder / "results.json")
        if self.overwrite or not (folder / "results.json").is_file():
            return
        if self.out is not None:
            raise ConfigError(f"{folder} holds results already: choose another out=, or replace them by overwrite=true")
        mapping = isinstance(self.task, MappingTask)
        if other := measured_otherwise(folder, self.protocol, self.data.plain(), only_map=mapping):
            raise ConfigError(
                f"{folder} holds results of other frames ({', '.join(other)}): write to another folder with "
                "out=FOLDER, or replace them with overwrite=true"
            )

    @property
    def _common(self) -> dict[str, Any]:
        """Arguments that the calls of most tasks share."""
        return {"protocol": self.protocol, "name": self._title}

    def _measure(self, say: Say) -> Result:
        """Measure the task."""
        task = self.task
        if isinstance(task, MappingTask):
            return self._mapping(say, task)
        if isinstance(task, BuildingsTask):
            return self._buildings(say, task)
        if isinstance(task, HierarchicalTask):
            return self._hierarchical(say, task)
        if isinstance(task, CompactTask):
            return self._compact(say, task)
        common = {**self._common, "seed": self.seed}
        if isinstance(task, RobustnessTask):
            known, images, roles = self._known(say, "query")
            common |= {"baselines": self._baselines(say), "settings": task.robustness}
            return evaluation.robustness(known, images, roles["query"], **common)
        settings = task.narrowed(Localization)
        learned = settings.error_model or settings.filter_tune
        learned |= settings.refine == "relative" and self.protocol.validation != Role()
        known, images, roles = self._known(say, "query", *(["validation"] if learned else []))
        common |= {"baselines": self._baselines(say), "validation": roles.get("validation")}
        return evaluation.localization(known, images, roles["query"], settings=settings, **common)

    def _mapping(self, say: Say, task: MappingTask) -> Result:
        known, _, _ = self._known(say)
        built, folder = self._layer(say, known, self.label)
        name = f"{self.build.title} over {self.label}"
        return replace(evaluation.mapping(known, built, name=name, settings=task.narrowed(MapMeasures)), layer=folder)

    def _hierarchical(self, say: Say, task: HierarchicalTask) -> Result:
        known, images, roles = self._known(say, "query")
        known = known.placed()
        coarse, (other, label) = None, self._other
        if other is not None:
            coarse = maps.build(self.make_descriptor(other), images, known.frames, distance=self.distance)
        ranking = known if coarse is None else coarse
        if ranking.aligned and task.coarse.by == "representatives":
            raise ConfigError(
                f"descriptors of {label} are compared after turning, so their means are meaningless: use "
                "task.coarse.by=vote, or another task.coarse.descriptor"
            )
        built, _ = self._layer(say, ranking, label)
        given = {**self._common, "coarse_map": coarse, "settings": task.narrowed(Hierarchical)}
        return evaluation.hierarchical(known, images, roles["query"], built, **given)

    def _compact(self, say: Say, task: CompactTask) -> Result:
        known, images, roles = self._known(say, "query")
        other, _ = self._other
        clusters = None if other is None else maps.build(self.make_descriptor(other), images, known.frames)
        given = {**self._common, "seed": self.seed, "settings": task.narrowed(Compact)}
        return evaluation.compact(known, images, roles["query"], clusters=clusters, **given)

    def _buildings(self, say: Say, task: BuildingsTask) -> Result:
        label = self.label
        if task.maps is None:
            known, images, roles = self._known(say, "query")
            candidates = [known]
        else:
            images, roles = self.open_roles("query")
            saved = _saved_maps(task.maps, self.descriptor.title, self.make_descriptor())
            candidates = [known.with_distance(self.distance) for known in saved]
        layers = None
        if self.build.name != "none":
            layers = {}
            for building, part in evaluation.by_building(candidates).items():
                # A building may have any name.
                folder = self.layer_folder(f"{label}-{quote(building, safe=' ')}")
                layers[building] = self.group(part, folder).layer
            label = f"{label}-{self.build.title}"
        return evaluation.buildings(
            candidates, images, roles["query"], layers=layers, protocol=self.protocol, name=label
        )

    def _known(self, say: Say, *roles: str) -> tuple[VisualMap, PanoramaLibrary, dict[str, FrameTable]]:
        """Return the saved map, or one made from the configured frames, with the frames of some roles.

        Nothing is written: only `siamloc map` creates and replaces maps.

        Raises:
            ConfigError: the saved map has another descriptor or mounting, or other frames than protocol.map asks for.
        """
        described, heading = self.make_descriptor(), self.make_heading(say)
        path = map_known(self.here, self.titles)
        known = self.load_map(path, described)
        if known is not None and self._is_wanted(known):
            images, frames = self.open_roles(*roles, known=known)
            self._note_what_training_saw(say, frames.get("query"))
            return known.with_heading(heading).with_distance(self.distance), images, frames
        if known is not None and roles:
            raise ConfigError(
                f"{path} was made of other frames than protocol.map asks for: leave the protocol.map keys out, or run "
                "`siamloc map` again with the intended ones"
            )
        images, frames = self.open_roles("map", *dict.fromkeys([*roles, *self.learned_from]))
        self._note_what_training_saw(say, frames.get("query"))
        given: dict[str, Any] = {"heading": heading, "distance": self.distance, "mounting": self.mounting.known}
        known = maps.build(described, images, frames["map"], validation=frames.get("validation"), **given)
        if "fusion" in known.made:
            say(f"weights: {known.made['fusion']}")
        return known, images, frames

    def _note_what_training_saw(self, say: Say, queries: FrameTable | None) -> None:
        """Say which drive of the queries trained the network or chose its checkpoint, by the record of its run."""
        chosen = self.descriptor
        run = Run(Path(chosen.parameters["run"])) if chosen.parameters.get("run") else self.here
        if "network" not in names_in(chosen.plain()) or queries is None or not run.record.is_file():
            return
        stored, places = run.settings, path_keys()
        if any(stored.get("data", {}).get(key) != queries.source.get(key) for key in places):
            return  # drives of the same names in other data
        for role in ("validation", *(["train"] if self.protocol.kind == "cross_run" else [])):
            labels = Protocol.of(stored.get("protocol", {})).plain()[role]["sequences"] or []
            drives = queries.rows_by("sequence")
            if seen := [name for label in labels for name in fitting(label, drives)]:
                say(
                    f"note: the network of {run.folder} had sequence {seen[0]!r} in protocol.{role}: as a query it "
                    "gives better results than a new drive"
                )

    def _is_wanted(self, known: VisualMap) -> bool:
        """Whether a saved map was made, before any update, from the frames that the protocol asks for."""
        role = known.made.get("role", {})  # empty for a map made in Python
        if Protocol.of({"map": role}).map == self.protocol.map:
            return True
        asked = self.protocol.frames("map", self.data.read()).identities()
        if UPKEEP not in known.made:
            return asked == known.frames.identities()
        left = known.frames.take(~known.history.joined).identities()  # updates may have forgotten some
        return set(left) <= set(asked) and len(asked) == known.made[UPKEEP].get("before")

    def _layer(self, say: Say, known: VisualMap, label: str) -> tuple[Built, Path]:
        """Return the nodes over a map, and their folder; nodes that are saved there are read if they fit the map.

        Nodes over another map than the saved one get a folder of their own.
        """
        if self.build.name == "none":
            ways = "|".join(maps.WAYS)
            raise ConfigError(f"task={self.task.names[0]} needs a coarse layer: choose one with build={ways}")
        folder, saved = self.layer_folder(label), map_file(self.here, label)
        shared = folder == self.here.layer(label, self.build.title)
        if shared and saved.is_file() and VisualMap.load(saved).digest != known.digest:
            folder = self.here.evaluation(f"layer-{folder.name}")
        before = _changed(folder / "layer.npz")
        built = self.group(known, folder)
        if _changed(folder / "layer.npz") != before:
            say(built.summary(folder))
        return built, folder

    def _baselines(self, say: Say) -> dict[str, Descriptor]:
        """Return the baseline descriptors by name, without networks of the run if it has none."""
        main, found = self.descriptor.title, {}
        for name in getattr(self.task, "baselines", ()):
            if name == main:
                continue
            if set(name.split(SIGN)) & set(OF_A_RUN) and not self.here.record.is_file():
                say(f"baseline {name} left out: {self.here.folder} holds no trained network")
                continue
            size = _size_of(name, self.here)
            if size is not None and size != list(self.data.image_size):
                say(f"baseline {name} left out: it takes panoramas of {size[0]} x {size[1]}, unlike {main}")
                continue
            started = name == "untrained" and self.here.settings["model"].get("weights") is not None
            label = "before_training" if started else name  # it had learned elsewhere
            found[label] = self.make_descriptor(by_name(name))
        return found


def _size_of(name: str, run: Run) -> list[int] | None:
    """Return the size of panoramas that a named network takes; None for any."""
    parts = name.split(SIGN)
    if "pretrained" in parts:
        return list(PRETRAINED_SIZE)
    size = run.settings["model"].get("image_size") if set(parts) & set(OF_A_RUN) else None
    return None if size is None else list(size)


def _saved_maps(named: Sequence[str], label: str, described: Descriptor) -> list[VisualMap]:
    """Return saved maps, each given by its file or the folder of its run.

    Raises:
        ConfigError: a map that does not exist, or one with another descriptor.
    """
    loaded = []
    for path in map(Path, named):
        file = path if path.is_file() else map_file(Run(path), label)
        if not file.is_file():
            others = [other.parent.name for other in sorted(path.glob("evaluation/*/map.npz"))]
            held = f"it holds one by {' and one by '.join(others)}; choose that descriptor, or " if others else ""
            raise ConfigError(
                f"{path} holds no map by {label}: {held}make it with `siamloc map {as_words({'run': path})}`, with the "
                "same descriptor and data"
            )
        try:
            loaded.append(VisualMap.load(file, described))
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from error
    return loaded


def _changed(path: Path) -> int | None:
    """Return when a file was last written; None if it does not exist."""
    return path.stat().st_mtime_ns if path.is_file() else None
