# syntax=docker/dockerfile:1
# Every command, as an ordinary user; torch brings the libraries of CUDA, so that `--gpus all` is enough on a machine
# with NVIDIA's container toolkit. amd64 and arm64.
#   docker build --file containers/train.Dockerfile --tag siamloc .
#   docker run --rm --gpus all --shm-size 8g --volume "$PWD:/work" --user "$(id -u):$(id -g)" siamloc \
#     train data=manifest data.manifest=robot.csv run=runs/robot
# The commands were run one by one in a root of Debian 12 made by debootstrap (amd64, with torch's build for processors), then
# a simulated drive, a training and a map as the user; not yet by docker itself.
FROM debian:bookworm-slim AS build
RUN apt-get update && apt-get install --yes --no-install-recommends python3 python3-venv
COPY . /source
RUN python3 -m venv /opt/siamloc
RUN /opt/siamloc/bin/pip install --no-cache-dir --constraint /source/constraints.txt '/source[all]'

FROM debian:bookworm-slim
RUN apt-get update && apt-get install --yes --no-install-recommends python3 && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home siamloc
COPY --from=build /opt/siamloc /opt/siamloc
ENV PATH=/opt/siamloc/bin:$PATH
# Where another user than the one of the image has no home.
ENV XDG_CACHE_HOME=/tmp MPLCONFIGDIR=/tmp
USER siamloc
WORKDIR /work
RUN siamloc doctor
ENTRYPOINT ["siamloc"]
