"""The commands: each reads its configuration, calls the library, and prints the result."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from siamloc.cli import robot
from siamloc.cli.compose import composed, plain
from siamloc.cli.inherit import by_network, label_of, map_file, map_of_job
from siamloc.cli.objects import (
    data_of,
    descriptor_of,
    figures_in,
    files_in,
    further_steps,
    heading_of,
    images_named,
    loss_of,
    network_of,
    open_roles,
    preprocessing_of,
    run_of,
    search_of,
    training_folder,
    training_of,
    way_of,
)
from siamloc.cli.sweeps import evaluates, of_layer, of_results, own_folder, sweep_suffix, swept, with_swept
from siamloc.data import Protocol
from siamloc.errors import ConfigError, DataError


def simulate(config: DictConfig) -> None:
    """Render a made-up building."""
    from siamloc.simulate import SimulateConfig
    from siamloc.simulate import simulate as render

    summary = render(SimulateConfig.of(plain(config)))
    for path in summary.files:
        print(f"picture: {path}")
    for sequence, count in summary.sequences.items():
        print(f"{sequence}: {count} frames")
    if summary.sequences:
        rate = f", {summary.rendered / summary.seconds:.1f} frames/s" if summary.rendered else ""
        print(f"{summary.folder}: {summary.rendered} frames rendered in {summary.seconds:.0f} s{rate}")


def prepare(config: DictConfig) -> None:
    """Check a data set and decode its images once."""
    from siamloc.data import check, summary

    data = data_of(config)
    frames = data.read()
    print(summary(frames))
    images = data.library(frames, plain(config.unwrap))
    rows, columns = images.image_size
    print(f"decoded: {len(images)} panoramas of {rows} x {columns} px in {images.settings()['cache']}")
    for finding in check(frames, images):
        print(f"note: {finding}")


def train(config: DictConfig) -> None:
    """Train a siamese network."""
    from siamloc import models, training
    from siamloc.training.fitting import process_rank
    from siamloc.training.trainer import check_trainer

    validated = config.protocol.validation.sequences is not None
    loss, further = loss_of(config), plain(config.trainer)
    check_trainer(further)  # before any image is decoded
    images, roles = open_roles(config, "train", *(["validation"] if validated else []))
    network = models.build(**network_of(config), image_size=images.image_size, seed=config.seed)
    run = training.fit(
        network,
        images,
        roles["train"],
        run=training_folder(config),
        validation=roles.get("validation"),
        loss=loss,
        augmentation={key: value for key, value in plain(config.augment).items() if key != "where"},
        trainer=further,
        protocol=Protocol.of(plain(config.protocol)).plain(),
        resume=config.resume,
        overwrite=config.overwrite,
        debug=config.debug,
        settings=training_of(config),
    )
    if process_rank() == 0 and config.debug is None:
        print(f"next: siamloc map run={run.folder}")


def pretrain(config: DictConfig) -> None:
    """Train a network on random buildings."""
    from siamloc import models, pretraining
    from siamloc.training.fitting import process_rank

    network = models.build(**network_of(config), image_size=plain(config)["image_size"], seed=config.seed)
    run = pretraining.pretrain(
        network,
        run=training_folder(config),
        views=plain(config.views),
        loss=loss_of(config),
        augmentation={key: value for key, value in plain(config.augment).items() if key != "where"},
        trainer=plain(config.trainer),
        resume=config.resume,
        overwrite=config.overwrite,
        settings=training_of(config),
    )
    if process_rank() == 0:
        print(f"next: siamloc train experiment=fine_tuning model.branch.weights={run.weights}")


def map_frames(config: DictConfig) -> None:
    """Describe the map frames of a run, and group them into nodes if requested."""
    from siamloc import maps

    run, label = run_of(config), label_of(config.descriptor)
    described, heading = descriptor_of(config, run), heading_of(config)  # before any image is decoded
    images, roles = open_roles(config, "map")
    made = {"role": plain(config.protocol.map)}
    known = maps.build(described, images, roles["map"], heading=heading, distance=config.distance, made=made)
    target = map_of_job(run, config)
    known.save(target)
    run.record_written([target])
    print(f"map: {target}, {len(known)} frames, descriptors of {known.width} numbers")
    if config.projector:
        run.record_written(maps.write_projector(known, run.tensorboard))
        print(f"projector: tensorboard --logdir {run.tensorboard}, color by room")
    if known.heading is not None:
        size = known.heading.values[0].nbytes
        print(f"headings: by {known.heading.identity['name']}, {size} bytes a frame")
    if config.build.name == "none":
        if swept():
            return
        print(f"next: siamloc evaluate run={run.folder}{'' if by_network(config) else f' descriptor={label}'}")
        return
    folder = own_folder(run.layer(label, label_of(config.build)), config, of_layer)
    built = maps.group(known, folder=folder, **way_of(config))
    run.record_written(files_in(folder))
    print(built.summary(folder))
    if not swept():
        print(f"next: siamloc evaluate run={run.folder} task=hierarchical build={label_of(config.build)}")


def evaluate(config: DictConfig) -> None:
    """Measure a task: call `siamloc.evaluation`, write the files and print the table."""
    from siamloc.cli.tasks import result_of

    run = run_of(config)
    name, result = result_of(config, run)
    folder = own_folder(run.evaluation(name), config, of_results)
    if folder != run.evaluation(name):
        result = replace(result, name=with_swept(result.name))
    if swept():
        result = replace(result, about={**result.about, "swept": swept()})
    pictures = result.save(folder, pictures=config.task.plots)
    run.record_written(files_in(folder))
    print(f"data: {data_of(config).summary()}")
    print(result.table())
    for path in pictures:
        print(f"picture: {path}")
    print(f"results: {folder / 'results.json'}, one row each in {folder / next(iter(result.tables))}.csv")


def export(config: DictConfig) -> None:
    """Write the bundle for the robot."""
    from siamloc import runtime
    from siamloc.maps import Built, ErrorModel, LayerSearch, Refinement, VisualMap

    label, precision = label_of(config.descriptor), config.precision
    run = run_of(config)
    described, path = descriptor_of(config, run), map_file(run, label)
    known = VisualMap.load(path, described) if path.is_file() else None
    further: dict[str, Any] = {}
    if known is None:
        further["preprocessing"] = preprocessing_of(config)
    else:
        evaluation = run.evaluation(label)
        further["errors"] = ErrorModel.saved(evaluation / "error_model.json", known)
        further["refinement"] = Refinement.saved(evaluation / "refinement.json", known)
        further["figures"] = figures_in(evaluation / "results.json")
        if config.build.name != "none":
            further["layer"] = Built.load(run.layer(label, label_of(config.build)))
            further["search"] = LayerSearch.of(search_of(config))
        if config.thumbnails or precision in ("int8", "auto"):
            roles = ["validation"] if precision == "auto" else []
            images, opened = open_roles(config, *roles, known=known)
            further |= {"images": images, "thumbnails": config.thumbnails, **opened}
    folder = Path(config.bundle) if config.bundle is not None else run.bundle
    bundle = runtime.export(described, known, folder, precision=precision, **further)
    if folder == run.bundle:
        run.record_written(files_in(folder))
    if compared := runtime.precision_table(bundle):
        print(compared)
    print(bundle.summary())
    for line in further_steps(run, known, further.get("errors"), further.get("refinement"), label):
        print(line)
    if known is not None:
        where = f"run={run.folder}" if folder == run.bundle else f"bundle={folder}"
        print(f"next: siamloc localize {where} images=[photo.jpeg]")


def report(config: DictConfig) -> None:
    """Write one page with everything about a run, or several runs side by side."""
    from siamloc.report import write_report
    from siamloc.runs import newest_run

    if config.runs is not None and not config.runs:
        raise ConfigError("runs=[] names no run: name several as runs=[A,B], or leave it out for the newest")
    several = [config.runs] if isinstance(config.runs, str) else list(config.runs or [])
    if several and config.run is not None:
        raise ConfigError(f"give run={config.run} or runs=[...], not both")
    folders = [Path(name) for name in several or [config.run or newest_run().folder]]
    default = folders[0] / "report.html" if len(folders) == 1 else Path("report.html")
    out = Path(config.out or default)
    if config.out is not None and sweep_suffix():
        out = out.with_stem(f"{out.stem}-{sweep_suffix()}")
    path = write_report(folders, out)
    print(f"report: {path}, {path.stat().st_size / 1e6:.1f} MB; open it in a browser")


def compare(config: DictConfig) -> None:
    """Print a row for each training or evaluation of a sweep, best first, and plot the figure."""
    from siamloc import evaluation, training
    from siamloc.comparison import files_named
    from siamloc.runs import Run

    folders = config.runs if isinstance(config.runs, str) else list(config.runs)
    measured = evaluates(folders, config.by)
    found = (evaluation if measured else training).compare(folders, by=config.by)
    print(found.table())
    print(found.verdict())
    if not measured and files_named(folders, "results.json"):
        print(f"to compare the evaluations of these runs: siamloc compare runs={config.runs} by=error")
    name = "evaluations.csv" if measured else "trainings.csv"
    inside = Path(folders) / name if isinstance(folders, str) else None
    out = inside if config.out is None else Path(config.out)
    if out is None:
        return
    written = [found.save(out.with_suffix(".csv") if out.suffix == ".png" else out)]
    print(f"table: {written[0]}")
    try:
        written.append(found.save_picture(out.with_suffix(".png")))
        print(f"picture: {written[1]}")
    except DataError as error:
        print(f"no picture: {error}")
    if out == inside:
        Run(out.parent).record_written(written)


def reproduce(config: DictConfig) -> None:
    """Reproduce a published table or figure, or all of them."""
    from siamloc.errors import DataError
    from siamloc.reproduce import listing, recipe, recipes, write_report
    from siamloc.reproduce import reproduce as measure_again

    if config.list or config.id is None:
        print(listing(config.data, config.scale))
        return
    options = {key: config[key] for key in ("data", "root", "scale", "out", "measure")}
    if config.id != "all":
        chosen = recipe(config.id)
        if chosen.id != config.id:
            print(f"{config.id} is measured by {chosen.id}")
        result = measure_again(chosen, **options)
        print(result.table())
        for path in result.save(config.out):
            print(f"written: {path}")
        return
    results, missing = [], {}
    for one in recipes():
        try:
            results.append(measure_again(one, **options))
        except DataError as error:  # the others can still be measured
            missing[one.id] = str(error)
            continue
        print(f"{results[-1].summary()}: {results[-1].save(config.out)[0]}")
    for reason in dict.fromkeys(missing.values()):
        print(f"left out, because {reason}: {', '.join(id for id, said in missing.items() if said == reason)}")
    if not results:
        raise DataError("nothing was measured, see above")
    print(f"report: {write_report(results, Path(config.page or config.out) / 'report.md', missing)}")


def expand(config: DictConfig) -> None:
    """Write an augmented data set in the layout of the original."""
    from siamloc import data

    settings = data_of(config)
    frames = settings.read()
    if config.sequences:
        frames = frames.select(sequence=[str(name) for name in config.sequences])
    expanded = data.expand(
        frames,
        config.out,
        unwrap=plain(config.unwrap),
        **{key: getattr(settings, key) for key in ("image_size", "circular", "on_error")},
        **{key: config[key] for key in ("depth", "seed", "resume", "workers")},
    )
    print(expanded.summary())


def preview(config: DictConfig) -> None:
    """Draw a labelled contact sheet of all effects at several strengths."""
    import torch

    import augment
    from siamloc import simulate
    from siamloc.files import write_picture

    paths = [str(path) for path in images_named(config.images)] if config.images else []
    if not paths and (config.data.get("manifest") or config.data.get("root")):
        paths = data_of(config).read().path.tolist()
    if paths:
        panoramas = preprocessing_of(config).panoramas(paths, config.count)
    else:
        panoramas = simulate.panoramas(config.count)
    write_picture(config.out, augment.preview(torch.from_numpy(panoramas)))
    print(f"{config.out}: {len(augment.EFFECTS)} effects on {len(panoramas)} panoramas")


def demo(config: DictConfig) -> None:
    """Simulate, train, map, evaluate, export, localize, report."""
    from siamloc.data.frames import image_files
    from siamloc.runs import Run
    from siamloc.training.run_folder import check_folder

    run, data, begin = Run(config.run), Path(config.data), time.monotonic()
    if run.record.is_file() and not config.overwrite:
        raise ConfigError(f"{run.folder} holds a run already: replace it with overwrite=true, or choose another run=")
    check_folder(run, resume=False, overwrite=config.overwrite)  # before a minute of rendering
    overwrite = ["overwrite=true"] if config.overwrite else []
    mini = ["building=mini", f"seed={config.seed}", f"out={data}"]
    runs = "cloudy1,cloudy2,cloudy3,night1,night2,sunny1,sunny2"
    _step("simulate", [*mini, "camera=panorama", f"runs=[{runs}]", "spacing=0.2", *overwrite])
    _step("simulate", [*mini, "runs=[cloudy1,night1,sunny1]", "preview=true"])
    here = [f"run={run.folder}"]
    _step("train", ["experiment=demo", f"data.root={data / 'mini'}", f"seed={config.seed}", *overwrite, *here])
    _step("map", here)
    _step("evaluate", [*here, "task.radii=[0.5]", "task.baselines=[hog,thumbnail,untrained]", "task.error_model=true"])
    _step("export", [*here, "thumbnails=true"])
    photograph = image_files(next((data / "mini").glob("part_*/*night2/omni_cam")))[0]
    _step("localize", [*here, f"images=['{photograph}']"])
    _step("report", here)
    print(f"\nThe run is in {run.folder}, the building in {data / 'mini'} with images in preview; curves for")
    print(f"tensorboard --logdir {run.tensorboard}; {time.monotonic() - begin:.0f} s in all.")
    print(f"To watch a drive at night: siamloc live run={run.folder} images=['{photograph.parent}']")


def _step(command: str, words: list[str]) -> None:
    """Show a command as a user would type it, and run it."""
    from siamloc.cli.help import COMMANDS

    print(f"\n$ siamloc {command} {' '.join(words)}", flush=True)
    function = COMMANDS[command].function
    if COMMANDS[command].config is None:
        getattr(robot, function)(words)
    else:
        globals()[function](composed(command, words))
