# syntax=docker/dockerfile:1
# The robot: `siamloc localize` and `live`, without torch, without a compiler, as an ordinary user; amd64 and arm64.
#   docker build --file containers/robot.Dockerfile --tag siamloc-robot .
#   docker run --rm --volume "$PWD/bundle:/bundle:ro" --volume "$PWD/photos:/photos:ro" siamloc-robot \
#     localize bundle=/bundle 'images=[/photos]' format=jsonl
# With a page: --publish 127.0.0.1:8000:8000 siamloc-robot live bundle=/bundle 'images=[/photos]' host=0.0.0.0
# The commands were run one by one in a root of Debian 12 made by debootstrap (amd64), not yet by docker itself; for arm64
# it was only checked that all packages have wheels.
FROM debian:bookworm-slim AS build
RUN apt-get update && apt-get install --yes --no-install-recommends python3 python3-venv
COPY . /source
RUN python3 -m venv /opt/siamloc
RUN /opt/siamloc/bin/pip install --no-cache-dir --constraint /source/constraints.txt '/source[robot,live]'

FROM debian:bookworm-slim
RUN apt-get update && apt-get install --yes --no-install-recommends python3 && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home siamloc
COPY --from=build /opt/siamloc /opt/siamloc
ENV PATH=/opt/siamloc/bin:$PATH
USER siamloc
WORKDIR /home/siamloc
RUN siamloc doctor
ENTRYPOINT ["siamloc"]
