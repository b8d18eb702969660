"""The commands and their help texts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command's function and help text.

    Commands configured by Hydra are in `siamloc.cli.commands`, the others in `siamloc.cli.robot`.
    """

    function: str
    summary: str
    details: str
    example: str
    inherits: bool = False  # takes its settings from the given run
    config: str | None = "config"  # its configuration file; None if it does not use Hydra
    reads_data: bool = True  # needs the location of the data
    takes: str | None = None  # the key of a bare argument; --list then means list=true

    @property
    def begins_with(self) -> str:
        """The configuration file of a command that uses Hydra."""
        assert self.config is not None
        return self.config


COMMANDS = {
    "simulate": Command(
        "simulate",
        "render a made-up building in the COLD layout",
        """
        Renders drives of a robot with an omnidirectional camera in cloudy, night and sunny light, and writes them with
        COLD's folders and file names. The same seed gives the same bytes, whatever the number of workers.

        building=freiburg_like      or annex, mini, random, or a YAML file
        out=data                    output folder
        runs=[cloudy1,night1]       lighting and number; each number is a different hour of a different day
        path=path2                  the route through the building
        trajectory=FILE.places.lst  or a COLD list of poses: one image for each
        spacing=0.15                metres between frames
        camera=omnidirectional      640 x 480; or panorama: 512 x 128, already unwrapped
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
        Reads the frames, summarizes them and any problems with them, and decodes (unwraps, resizes) every image into
        the panorama store, where training and evaluation find them.

        data=manifest|cold|folder   kind of data set
        data.manifest=FILE          the CSV, for data=manifest
        data.root=FOLDER            the folder, for data=cold and data=folder
        data.image_size=[128,512]   rows and columns of a panorama
        data.circular=false         for ordinary cameras, whose columns do not wrap around
        unwrap=none|polar|hyperbolic  how omnidirectional images are unwrapped to panoramas
        data.on_error=raise         stop at the first unreadable image instead of leaving it out
        """,
        "siamloc prepare data=manifest data.manifest=my_robot.csv",
    ),
    "train": Command(
        "train",
        "train a siamese network",
        """
        Writes a run folder with checkpoints (best on the validation sequence, last), training curves, and the settings,
        which the other commands read from there.

        run=FOLDER                        where the run is written
        protocol.train.sequences=[...]    training sequences; names or patterns
        protocol.validation.sequences=[...]  sequences for choosing the best checkpoint
        experiment=modern|fine_tuning|photographs|rooms
                                          our recipes: modern for panoramas with positions, from random weights;
                                          fine_tuning for the same, shorter, from the shipped weights; photographs for
                                          images of an ordinary camera; rooms for such images with room labels.
                                          You can still change any key
        model/branch=vgg16                one of simple1 simple2 alexnet densenet121 vgg11 vgg13 vgg16 vgg19 vgg*_bn
                                          panoresnet
        model/head=fc500_500_5            or fc500_100_10, fc1000_1000_10, fc4096_4096_1000, fc4096_4096; flat, gem,
                                          bands, fourier, magnitudes
        model.circular=true               the network wraps around the azimuth
        model.branch.weights=siamloc      start from pretrained weights; or imagenet, or the path of a run or a file
        model.normalize=local             remove lighting from the image first; or channels, image, local_brightness
        pairs=room|distance|in_batch      pairs with binary labels (room) or metric labels (distance); in_batch uses all
                                          pairs of a batch and needs
                                          loss=soft_contrastive|metric_calibrated|triplet|circle|multi_similarity
        pairs=frames loss=cross_entropy   learn to name the room of a frame, as experiment=rooms_classifier does
        loss.miner=batch_hard loss.distance=cosine
                                          for triplet and similar losses: which pairs count and how they are compared
        pairs.by=sequence pairs.radius=1    batches without positions; loss.room=0.5 to learn from rooms as well
        pairs.same_room_share=0.4 pairs.epoch_pairs=10000
        pairs.lightings={night:2}         twice as many night images per batch as images of each other lighting
        augment=thesis|lighting|strong|any_light
                                          augmentation of training images; augment.where=cpu|gpu sets the device
        epochs=30 batch_size=16 optimizer.learning_rate=0.001 seed=0
        monitor=error|recall|room|accuracy|loss
                                          validation figure that picks the best checkpoint; recall_radius=0.5
        compile=auto|true|false           let torch compile the network for training; auto does so on a GPU
        patience=5                        stop after this many epochs without a better validation
        debug=one_batch|overfit|profile   inspect the training instead: one step, learning one batch, where time goes
        resume=true                       continue from the last checkpoint; checkpoint_every=200 writes it within
                                          epochs, too
        -m model/branch=vgg11,vgg13       a sweep, each run in its own folder inside run=runs/sweep; `siamloc map`,
                                          `evaluate` and `report` take that folder, `siamloc compare` makes a table
        """,
        "siamloc train experiment=modern data=cold data.root=/data/COLD protocol=freiburg run=runs/freiburg",
    ),
    "pretrain": Command(
        "pretrain",
        "train a network on random buildings, before it sees any data",
        """
        Draws, furnishes, lights and renders one building after another while the network learns from those already
        there. Everything follows from the seed. `siamloc train` can start from the resulting weights.

        run=runs/pretrained         where the run is written
        epochs=12                   of 500 batches each; a new building every views.batches=15
        views.processes=1           number of processes that render alongside the training
        seed=0 resume=true
        trainer.devices=2 trainer.strategy=ddp   each process has its own buildings
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

        run=FOLDER                      the run, or a sweep: each of its runs; only a trained network needs one
        protocol.map.sequences=[...]    sequences of the map; the training sequences if not given
        protocol.map.every=5            or protocol.map.spacing=0.5
        descriptor=pretrained           the network that ships with siamloc, no training needed; 64 x 256 pixels
        descriptor=hog|gist|wisurf|...  or an analytic descriptor
        heading=hog|fs|gist|radon_fourier
                                        estimates headings for a network that cannot (fourier and magnitudes with
                                        circular=true can); heading.step=4 halves the size of its part of the map
        build=incremental|spectral|som|sample|rooms
                                        also group the frames into nodes, and write that coarse layer
        build.nodes=40 build.y=1.5      its parameters; `siamloc map build=... --cfg job` lists them
        projector=true                  show the descriptors in TensorBoard as points, coloured by room
        -m descriptor.bins=8,16         a sweep: each map in its own folder, evaluation/hog/descriptor.bins-8, where an
                                        evaluation of the same sweep finds it
        """,
        "siamloc map run=runs/vgg16 protocol.map.every=5",
        inherits=True,
    ),
    "evaluate": Command(
        "evaluate",
        "measure localization and room retrieval",
        """
        Locates the query frames in the map and writes results.json, queries.csv and plots. Baselines are measured with
        the same evaluator on the same frames.

        run=FOLDER                        the run, or a sweep: each of its runs; only a trained network needs one
        protocol.query.sequences=[...]    sequences of the frames to locate
        task=localization|absolute|room_retrieval|hierarchical|mapping|compact|robustness|buildings
        distance=cosine                   how descriptors are compared: manhattan, euclidean, correlation or cosine
        task.radii=[0.5,1.0]              for recall: how near a map frame must be
        task.baselines=[hog,thumbnail,untrained]
        descriptor=pretrained|hog|gist|wisurf|briefgist|fs|radon_fourier|radon_poc|thumbnail
                                          measure a descriptor other than the trained network, without training
        task.filter=true                  also follow the robot along its drive with a filter;
                                          task.filter_tune=true tunes it on protocol.validation
        task.refine=interpolate           a pose between the three nearest map frames (task.neighbours=3)
        task.refine=relative              a pose from comparing the query with each of them, for a network with
                                          model.relative=true, such as descriptor=pretrained; with task.filter=true
                                          it is filtered as well
        task.error_model=true             the expected error of each query, learned from protocol.validation, and
                                          whether it is lost: above task.lost_above=1.0, or from another building
        heading=hog|fs|gist|radon_fourier
                                          estimates headings for a network; as the map does if not given
        task=hierarchical build=incremental|spectral|som|sample|rooms
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
        -m descriptor.bins=8,16 distance=euclidean,correlation
                                          a sweep: each result in its own folder, such as
                                          evaluation/hog-euclidean/descriptor.bins-8; `siamloc compare` compares them
        """,
        "siamloc evaluate run=runs/vgg16 protocol.query.sequences=['*cloudy2','*night2','*sunny2']",
        inherits=True,
    ),
    "export": Command(
        "export",
        "write the model file for the robot",
        """
        Writes a bundle with the descriptor (the network as ONNX, or an analytic descriptor), the map and the image
        preprocessing, and compares its output with the original's. If the map holds headings, the robot also gets its
        own. After an evaluation with task.error_model=true it gets its expected error and whether it is lost; after one
        with task.refine its poses are refined in the same way, finer than the map.

        run=FOLDER              the run
        bundle=FOLDER           output folder; inside the run if not given; robot.zip makes one file
        descriptor=hog          another map of the run: of an analytic descriptor, or of the network that ships with
                                siamloc, descriptor=pretrained
        precision=int8          8-bit numbers, for a smaller and faster bundle; float16 for a smaller map only;
                                auto takes the smallest that loses at most 2 % of the error on protocol.validation,
                                and shows what each loses
        build=spectral          the coarse layer that `siamloc map build=spectral` made, for the robot to search first,
                                as set by task=hierarchical task.candidates=1
        thumbnails=true         small images of the map frames, which `siamloc live` shows
        """,
        "siamloc export run=runs/vgg16",
        inherits=True,
    ),
    "localize": Command(
        "localize",
        "locate image files with an exported bundle",
        """
        Needs only numpy, OpenCV and onnxruntime. Prints a line for each image as soon as it is located: position and
        room; heading, expected error and verdict if the bundle supports them; covariance and agreement of refined
        poses; and the error if file names carry poses as COLD's do. Ctrl-C keeps the results so far.

        images=[a.jpeg,folder]   files, folders, videos, or cameras such as camera:0
        run=FOLDER               the run whose bundle is used
        bundle=FOLDER            another bundle, or FILE.zip
        top=3                    number of map frames to list
        track=true               follow the robot from image to image; each folder, video and camera is a drive
        format=table|jsonl|csv   readable lines, or output for other programs
        out=FILE                 write a .csv or .jsonl file, too; locations.csv by default with format=table
        on_error=skip|raise      skip images that cannot be read, or stop at the first one
        threads=2                number of onnxruntime threads
        hierarchical=false       search the whole map even if the bundle has a coarse layer
        """,
        "siamloc localize run=runs/vgg16 images=[photo.jpeg]",
        config=None,
    ),
    "live": Command(
        "live",
        "show on a web page where the robot is while it drives",
        """
        Locates images as localize does, and serves a web page: the floor plan with the pose, its uncertainty and the
        path so far, the camera image next to the map image, the room, expected error and time. The page is read-only,
        and visible only from this machine unless host= says otherwise. Needs the extra `live`: `pip install '.[live]'`.

        images=[drive.mp4]   files, folders, videos, or cameras such as camera:0
        bundle=FOLDER        the bundle, or FILE.zip; export it with thumbnails=true to see the map images
        run=FOLDER           or the run whose bundle is used
        track=true           follow the robot from image to image
        fps=5                images per second at most, 0 for full speed; cameras keep their own rate
        port=8000            0 picks a free port
        host=127.0.0.1       0.0.0.0 lets everybody on the network watch
        """,
        "siamloc live run=runs/vgg16 images=[drive.mp4]",
        config=None,
    ),
    "report": Command(
        "report",
        "write one HTML page with a run's results",
        """
        Writes a page that opens from disk, without a network connection: tables, a floor plan with every error and the
        images behind it, error curves, the worst queries, confusion matrix, training curves, configuration.

        run=FOLDER       the run; the newest one if not given. For the folder of a sweep, its runs side by side
        runs=[a,b,c]     several runs side by side; also sweeps and single evaluations
        out=FILE         output file; report.html in the run's folder if not given
        """,
        "siamloc report runs=[runs/vgg16,runs/hog] out=comparison.html",
        config="report",
    ),
    "compare": Command(
        "compare",
        "tabulate and plot a sweep, best first",
        """
        Prints a row for each run of a sweep: the settings in which the runs differ, the best validation figure and its
        epoch, and the number of finished epochs. For evaluations: the swept settings, the mean error, overall and by
        lighting, the hit rate, recall@1 and the share of rooms found. Names the best one. Writes the table as CSV, and
        a plot of the figure against the first swept numeric setting, with a line for each combination of the others.

        runs=FOLDER      the folder of a sweep, or any folder with runs or evaluations in it
        runs=[a,b,c]     several of them
        by=val/error     the figure to rank trainings by; the one that picks checkpoints if not given
        by=recall@1      or evaluations: error, error.night, hit_rate, room, recall@5_0.5 within 0.5 m, cost.bytes,
                         or any number in results.json by its path, such as absolute.overall.error.median
        out=FILE.csv     output file, with FILE.png; trainings.csv or evaluations.csv in the folder if not given
        """,
        "siamloc compare runs=runs/sweep by=error out=sweep.csv",
        config="compare",
    ),
    "reproduce": Command(
        "reproduce",
        "reproduce a published table or figure",
        """
        Runs the experiments of a published table or figure, writes our numbers next to the published ones (ID.md,
        ID.csv, ID.png), and reports which claims of the text they support. Anything already measured on the same data
        is not measured again.

        ID                     such as table_4_2 or figure_3_11; all for everything, with a report
        --list                 list what can be reproduced, and what each item needs
        data=freiburg_sim      or mini, small and quick; or cold, with root=FOLDER
        scale=short            smoke takes seconds, short minutes; full is the published scale
        out=reproduced         output folder
        page=FOLDER            with ID all: where the report and its plots go, if not to out
        measure=false          only read earlier measurements
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
        Makes `depth` images of every frame (the original, spots of light and darkness, global light, blur and the other
        effects, their combinations, rotations) and writes them in the layout of the data set: COLD's folders and names
        with the turned heading, a manifest, or an image folder. augmentation.csv holds the parameters of every image.
        Images are panoramas of data.image_size, already unwrapped.

        data=manifest|cold|folder   kind of data set, with data.manifest=FILE or data.root=FOLDER
        out=FOLDER                  output folder
        depth=16                    images per frame; 16, 44, 128, 129 and 246 in the thesis
        sequences=[...]             names or patterns of the sequences to expand; all if not given
        resume=true                 continue an interrupted run in its folder; makes only what is missing
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
        Without images or data it shows rooms of the simulated building.

        out=augmentation.png      output file; .jpg and .webp work, too
        images=[a.jpeg,folder]    panoramas to show the effects on
        data=... unwrap=...       or frames spread over a data set
        count=6                   number of panoramas used in turn
        """,
        "siamloc augment preview out=augmentation.png",
        config="preview",
    ),
    "demo": Command(
        "demo",
        "run the whole workflow on a small made-up building",
        """
        Draws a building, trains a small network on it, builds its map, measures localization, exports the model,
        locates an image and writes an HTML report. Everything ends up in one folder.

        run=FOLDER       output folder; runs/demo if not given
        seed=0
        overwrite=true   replace an existing run
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
        "siamloc <command> --help          the keys of a command, with an example\n"
        "siamloc <command> --cfg job       the whole configuration (not for localize and live)\n"
        "siamloc completion bash|zsh|fish  complete commands, groups and keys with the tab key\n"
        "siamloc --version\n\n"
        "--debug shows the traceback of an error."
    )
