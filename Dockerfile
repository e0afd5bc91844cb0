# symsol-annot with Blender and plots, as the README installs it. From a clone:
#
#   docker build --tag symsol-annot .
#   docker run --rm --user "$(id -u)" --volume "$PWD:/home/user" symsol-annot render --object cylO --train 0 --test 64
FROM python:3.11-slim-bookworm

# The libraries that Blender loads, as `symsol-annot doctor` names them.
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libegl-mesa0 \
        libegl1 \
        libgl1 \
        libgl1-mesa-dri \
        libice6 \
        libsm6 \
        libx11-6 \
        libxfixes3 \
        libxi6 \
        libxkbcommon0 \
        libxrender1 \
        libxxf86vm1 \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/symsol-annot
COPY constraints-render.txt ./
RUN pip install --no-cache-dir --require-hashes --requirement constraints-render.txt

COPY pyproject.toml README.md LICENSE MANIFEST.in CHANGELOG.md CITATION.cff ./
COPY symsol_annot symsol_annot
COPY cli cli
COPY blender_assets blender_assets
RUN pip install --no-cache-dir --no-index --no-build-isolation '.[render,plot]'

RUN useradd --create-home user
USER user
ENV HOME=/home/user
WORKDIR /home/user
ENTRYPOINT ["symsol-annot"]
CMD ["--help"]
