"""What the commands are and what their help says."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command's function, and its help.

    Commands that Hydra configures are in `siamloc.cli.commands`, the others in `siamloc.cli.robot`.
    """

    function: str
    summary: str
    details: str
    example: str
    inherits: bool = False  # takes its settings from the run that is named
    config: str | None = "config"  # the configuration file it begins with; None where Hydra is not needed
    reads_data: bool = True  # needs to know where the data are
    takes: str | None = None  # the key of a word that stands alone, and --list is list=true

    @property
    def begins_with(self) -> str:
        """The configuration file of a command that Hydra configures."""
        assert self.config is not None
        return self.config


COMMANDS = {
    "simulate": Command(
        "simulate",
        "render a made-up building in COLD's layout",
        """
        Renders drives of a robot with an omnidirectional camera under cloudy, night and sunny light, and writes them
        as COLD's folders and file names. One seed gives the same bytes again, whatever the number of workers.

        building=freiburg_like      or annex, mini, random, or a YAML file
        out=data                    where to
        runs=[cloudy1,night1]       lightings with numbers; each number is another hour of another day
        path=path2                  the way through the building
        trajectory=FILE.places.lst  a COLD list instead: one image for each listed pose
        spacing=0.15                metres between frames
        camera=omnidirectional      640 x 480, or panorama: 512 x 128, unwrapped already
        workers=2 seed=0
        preview=true                only a contact sheet and a floor plan
        """,
        "siamloc simulate camera=panorama",
        config="simulate",
    ),
    "prepare": Command(
        "prepare",
        "check a data set and decode its images once",
        """
        Reads the frames, says what they are and what is wrong with them, and decodes (unwraps, resizes) every image
        into the panorama store, where training and evaluation find them.

        data=manifest|cold|folder   kind of data set
        data.manifest=FILE          the CSV of data=manifest
        data.root=FOLDER            the folder of data=cold and data=folder
        data.image_size=[128,512]   rows and columns of a panorama
        data.circular=false         for ordinary cameras, whose columns do not wrap around
        unwrap=none|polar|hyperbolic  how omnidirectional images become panoramas
        data.on_error=raise         stop at the first unreadable image instead of leaving it out
        """,
        "siamloc prepare data=manifest data.manifest=my_robot.csv",
    ),
    "train": Command(
        "train",
        "train a siamese network",
        """
        Writes the folder of a run: checkpoints (best on the validation sequence, last), training curves, and the
        settings that the other commands take over.

        run=FOLDER                        where the run is written
        protocol.train.sequences=[...]    what it learns from; names or patterns
        protocol.validation.sequences=[...]  what the best checkpoint is chosen on
        experiment=modern|fine_tuning|photographs|rooms
                                          our recipes, for panoramas with positions (from random weights, and
                                          shorter from those that come along), for pictures of an ordinary camera, and
                                          for such pictures with room labels; keys still change them
        model/branch=vgg16                one of simple1 simple2 alexnet densenet121 vgg11 vgg13 vgg16 vgg19 vgg*_bn
                                          panoresnet
        model/head=fc500_500_5            or fc500_100_10, fc1000_1000_10, fc4096_4096_1000, fc4096_4096; flat, gem,
                                          bands, fourier, magnitudes
        model.circular=true               the network wraps around the azimuth
        model.branch.weights=siamloc      start from pretrained weights; or imagenet, or the path of a run or a file
        model.normalize=local             takes the light out of the picture first; or channels, image, local_brightness
        pairs=room|distance|in_batch      pairs with binary labels, or metric ones; or all pairs of a batch, which goes
                                          with loss=soft_contrastive|metric_calibrated|triplet|circle|multi_similarity
        pairs=frames loss=cross_entropy   learn to name the room of a frame; experiment=rooms_classifier does so
        loss.miner=batch_hard loss.distance=cosine
                                          which pairs count, and how they are compared, by triplet and its like
        pairs.by=sequence pairs.radius=1    batches without positions; loss.room=0.5 for rooms learned from, too
        pairs.same_room_share=0.4 pairs.epoch_pairs=10000
        pairs.lightings={night:2}         batches with twice as many images by night as under other lightings
        augment=thesis|lighting|strong|any_light
                                          what happens to training images; augment.where=cpu|gpu says on which device
        epochs=30 batch_size=16 optimizer.learning_rate=0.001 seed=0
        monitor=error|recall|room|accuracy|loss
                                          what the best checkpoint is chosen by in the validation; recall_radius=0.5
        compile=auto|true|false           torch compiles the network for the steps; auto does so on a GPU
        patience=5                        stop after so many epochs without a better validation
        debug=one_batch|overfit|profile   look at the training instead: one step, one batch learned, where time goes
        resume=true                       go on from the last checkpoint; checkpoint_every=200 writes it within epochs
        -m model/branch=vgg11,vgg13       a sweep, each run in a folder of its own inside run=runs/sweep; `siamloc map`,
                                          `evaluate` and `report` take that folder, `siamloc compare` makes a table
        """,
        "siamloc train experiment=modern data=cold data.root=/data/COLD protocol=freiburg run=runs/freiburg",
    ),
    "pretrain": Command(
        "pretrain",
        "train a network on random buildings, before it sees any data",
        """
        Draws, furnishes, lights and renders one building after another while the network learns from those that are
        there. All follows from the seed. The weights are where `siamloc train` can start from.

        run=runs/pretrained         where the run is written
        epochs=12                   of 500 batches each; a new building comes every views.batches=15
        views.processes=1           how many processes render alongside the training
        seed=0 resume=true
        trainer.devices=2 trainer.strategy=ddp   each process has buildings of its own
        """,
        "siamloc pretrain run=runs/pretrained",
        config="pretrain",
        reads_data=False,
    ),
    "map": Command(
        "map_frames",
        "describe the map frames of a run",
        """
        Writes map.npz into the run: descriptors, poses and rooms of the frames that the robot knows.

        run=FOLDER                      the run; analytic descriptors need none. Of a sweep: each of its runs
        protocol.map.sequences=[...]    the training sequences if not given
        protocol.map.every=5            or protocol.map.spacing=0.5
        descriptor=pretrained           the network that comes with siamloc, without training; 64 x 256 pixels
        descriptor=hog|gist|wisurf|...  or an analytic one
        heading=hog|fs|gist|radon_fourier
                                        what gives headings for a network that finds none itself (fourier and
                                        magnitudes with circular=true do); heading.step=4 halves its part of the map
        build=incremental|spectral|som|sample|rooms
                                        group the frames into nodes as well, and write that coarse layer
        build.nodes=40 build.y=1.5      its parameters; `siamloc map build=... --cfg job` shows them
        projector=true                  TensorBoard shows the descriptors as points, coloured by room
        -m descriptor.bins=8,16         a sweep: each map in a folder of its own, evaluation/hog/descriptor.bins-8,
                                        where an evaluation of the same sweep finds it
        """,
        "siamloc map run=runs/vgg16 protocol.map.every=5",
        inherits=True,
    ),
    "evaluate": Command(
        "evaluate",
        "measure localization and room retrieval",
        """
        Locates the query frames in the map and writes results.json, queries.csv and plots. Baselines are measured by
        the same evaluator on the same frames.

        run=FOLDER                        the run; analytic descriptors need none. Of a sweep: each of its runs
        protocol.query.sequences=[...]    the frames to be located
        task=localization|absolute|room_retrieval|hierarchical|mapping|compact|robustness|buildings
        distance=cosine                   how descriptors are compared: manhattan, euclidean, correlation or cosine
        task.radii=[0.5,1.0]              recall: how near a map frame must be
        task.baselines=[hog,thumbnail,untrained]
        descriptor=pretrained|hog|gist|wisurf|briefgist|fs|radon_fourier|radon_poc|thumbnail
                                          measure something else than the trained network, without training
        task.filter=true                  beside each frame's own estimate, that of a robot followed on its way;
                                          task.filter_tune=true learns from protocol.validation
        task.refine=interpolate           a pose between the three nearest map frames (task.neighbours=3)
        task.refine=relative              one by comparing with each of them, for a network with model.relative=true
                                          (descriptor=pretrained is one); with task.filter=true followed as well
        task.error_model=true             the expected error of each query, learned from protocol.validation, and
                                          whether it is lost: above task.lost_above=1.0, or of another building
        heading=hog|fs|gist|radon_fourier
                                          what gives headings for a network; the map's own if not given
        task=hierarchical build=incremental|spectral|som|sample|rooms
                                          search the nodes of a map first, then the frames inside the nearest
        task.candidates=3                 that many nodes; task.coarse.ratio=1.3 leaves out those much farther than
                                          the nearest, task.along=2 adds two frames of the drive on either side of
                                          the nearest, where they lie in another node
        task.coarse.descriptor=hog_mapping task.coarse.by=representatives|vote|classifier
                                          how nodes are ranked
        task=compact task.nodes=[10,20,40] task.ways=[spectral,som,sample]
                                          how well maps of so few nodes locate, each with one descriptor;
                                          task.clusters=gist groups the frames by another descriptor
        task=mapping build=incremental    measure the nodes of a map instead: see `siamloc map --help`
        task=robustness                   error against noise, occlusion, turns and effects
        task=buildings task.maps=[runs/a,runs/b]
                                          which building a query is in, by the maps of several
        -m descriptor.bins=8,16 distance=euclidean,correlation
                                          a sweep: results of each in a folder of its own, such as
                                          evaluation/hog-euclidean/descriptor.bins-8; compared by `siamloc compare`
        """,
        "siamloc evaluate run=runs/vgg16 protocol.query.sequences=['*cloudy2','*night2','*sunny2']",
        inherits=True,
    ),
    "export": Command(
        "export",
        "write the model file for the robot",
        """
        Writes a bundle: what describes images (the network as ONNX, or an analytic descriptor), the map, and how
        images are prepared; and compares its output with the original's. With a map that holds headings the robot knows
        its own, and after an evaluation with task.error_model=true its expected error and whether it is lost. After one
        with task.refine its poses are finer than the map in the same way.

        run=FOLDER              the run
        bundle=FOLDER           where to; the run's own folder if not given; robot.zip makes one file
        descriptor=hog          another map of the run: of an analytic descriptor, or of the network that comes with
                                siamloc, descriptor=pretrained
        precision=int8          numbers of 8 bits, a faster bundle, or float16: both are shorter and take less memory;
                                auto takes the smallest that loses at most 2 % of the error on protocol.validation,
                                and shows what each loses
        build=spectral          the coarse layer that `siamloc map build=spectral` made, for the robot to search first;
                                task=hierarchical task.candidates=1 says how
        thumbnails=true         small pictures of the map frames, which `siamloc live` shows
        """,
        "siamloc export run=runs/vgg16",
        inherits=True,
    ),
    "localize": Command(
        "localize",
        "locate image files with an exported bundle",
        """
        Works where only numpy, OpenCV and onnxruntime are installed. Prints a line for each image as soon as it is
        located: position and room, and heading, expected error and verdict where the bundle holds what gives them;
        covariance and agreement of refined poses; how far off it is, where names carry poses as COLD's do. Ctrl-C
        keeps what there is.

        images=[a.jpeg,folder]   files, folders, videos, or cameras such as camera:0
        run=FOLDER               the run whose bundle is used
        bundle=FOLDER            another bundle, or FILE.zip
        top=3                    map frames to list
        track=true               follow the robot from image to image; each folder, video and camera is a drive
        format=table|jsonl|csv   lines to read, or for other programs
        out=FILE                 a .csv or .jsonl file as well; locations.csv where lines to read are printed
        on_error=skip|raise      go on after an image that cannot be read, or stop there
        threads=2                of onnxruntime
        hierarchical=false       search the whole map, also where the bundle has a coarse layer
        """,
        "siamloc localize run=runs/vgg16 images=[photo.jpeg]",
        config=None,
    ),
    "live": Command(
        "live",
        "a page that shows where the robot is, while it drives",
        """
        Locates images as localize does, and serves a page for the browser: the plan with pose, uncertainty and way so
        far, the picture of the camera beside that of the map, room, expected error and time. It can be watched and not
        changed, from this machine alone unless host= says otherwise. Needs `pip install siamloc[live]`.

        images=[drive.mp4]   files, folders, videos, or cameras such as camera:0
        bundle=FOLDER        the bundle, or FILE.zip; export it with thumbnails=true to see the map's pictures
        run=FOLDER           or the run whose bundle is used
        track=true           follow the robot from image to image
        fps=5                images a second at most, 0 for all speed; cameras keep their own pace
        port=8000            0 takes a free one
        host=127.0.0.1       0.0.0.0 lets everybody in the network watch
        """,
        "siamloc live run=runs/vgg16 images=[drive.mp4]",
        config=None,
    ),
    "report": Command(
        "report",
        "one HTML page of a run's results",
        """
        Writes a page that opens from disk, without a network: tables, floor plan with every error and the pictures
        behind it, error curves, the worst queries, confusion matrix, training curves, configuration.

        run=FOLDER       the run; the newest one if not given. The folder of a sweep: its runs side by side
        runs=[a,b,c]     several runs side by side; sweeps and single evaluations as well
        out=FILE         where to; report.html in the run's folder if not given
        """,
        "siamloc report runs=[runs/vgg16,runs/hog] out=comparison.html",
        config="report",
    ),
    "compare": Command(
        "compare",
        "a table and a plot of a sweep, the best first",
        """
        Prints a row for each run of a sweep: the settings in which the runs differ, the best figure of validation and
        its epoch, and how many epochs are finished. Of evaluations: the settings that were swept, the mean error,
        overall and by lighting, the hit rate, recall@1 and the share of rooms found. Names the best one. Writes the
        table as CSV, and a plot of the figure against the first swept setting with numbers, a line for each
        combination of the others.

        runs=FOLDER      the folder of a sweep, or any folder with runs or evaluations in it
        runs=[a,b,c]     several of them
        by=val/error     the figure that counts: of trainings; what checkpoints are chosen by if not given
        by=recall@1      or of evaluations: error, error.night, hit_rate, room, recall@5_0.5 within 0.5 m, cost.bytes,
                         or any number in results.json by its place, such as absolute.overall.error.median
        out=FILE.csv     where to, with FILE.png; trainings.csv or evaluations.csv in the folder if not given
        """,
        "siamloc compare runs=runs/sweep by=error out=sweep.csv",
        config="compare",
    ),
    "reproduce": Command(
        "reproduce",
        "measure a published table or figure again",
        """
        Runs the experiments of a published table or figure, writes ours beside the published numbers (ID.md, ID.csv,
        ID.png) and says which claims of the text our numbers bear out. What was measured before on the same data is not
        measured again.

        ID                     such as table_4_2 or figure_3_11; all for everything, with a report
        --list                 what there is, and what each needs
        data=freiburg_sim      or mini, small and quick, or cold, with root=FOLDER
        scale=short            smoke takes seconds, short minutes, full what was published
        out=reproduced         where to
        page=FOLDER            with all: where the report and its pictures go, if not to out
        measure=false          only read what was measured before
        """,
        "siamloc reproduce figure_3_11 data=mini scale=smoke",
        config="reproduce",
        reads_data=False,
        takes="id",
    ),
    "augment expand": Command(
        "expand",
        "write an augmented data set in the input's own layout",
        """
        Makes `depth` pictures of every frame (the original, spots of light and darkness, global light, blur and the
        other effects, their combinations, rotations) and writes them as the data set was: COLD's folders and names
        with the turned heading, a manifest, or an image folder. augmentation.csv holds the parameters of every
        picture. Pictures are panoramas of data.image_size, unwrapped already.

        data=manifest|cold|folder   kind of data set, with data.manifest=FILE or data.root=FOLDER
        out=FOLDER                  where to
        depth=16                    pictures of every frame; 16, 44, 128, 129 and 246 in the thesis
        sequences=[...]             names or patterns of the sequences to expand; all if not given
        resume=true                 go on in a folder that was interrupted; only what is missing is made
        seed=0 workers=2
        data.on_error=raise         stop at the first unreadable image instead of leaving it out
        """,
        "siamloc augment expand data=cold data.root=/data/COLD sequences=['*seq2_cloudy3'] depth=16 out=expanded",
        config="expand",
    ),
    "augment preview": Command(
        "preview",
        "draw every effect at several strengths on one sheet",
        """
        Without images and data it shows rooms of the simulated building.

        out=augmentation.png      the picture; .jpg and .webp too
        images=[a.jpeg,folder]    panoramas to show the effects on
        data=... unwrap=...       or frames spread over a data set
        count=6                   how many panoramas take turns
        """,
        "siamloc augment preview out=augmentation.png",
        config="preview",
    ),
    "demo": Command(
        "demo",
        "the whole main job on a small made-up building",
        """
        Draws a building, trains a small network on it, makes its map, measures localization, exports the model,
        locates an image and writes a page for the browser. Everything lies in one folder afterwards.

        run=FOLDER       where to; runs/demo if not given
        seed=0
        overwrite=true   replace what is there
        """,
        "siamloc demo",
        config="demo",
    ),
}


def overview() -> str:
    """Return the answer to `siamloc --help`."""
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {command.summary}" for name, command in COMMANDS.items())
    return (
        "siamloc: siamese place recognition for robots with omnidirectional cameras\n\n"
        "usage: siamloc <command> [key=value ...]\n\n"
        f"{lines}\n\n"
        "siamloc <command> --help          what a command takes, with an example\n"
        "siamloc <command> --cfg job       the whole configuration, of all but localize and live\n"
        "siamloc completion bash|zsh|fish  the tab key completes commands, groups and keys\n"
        "siamloc --version\n\n"
        "--debug shows the traceback of an error."
    )
