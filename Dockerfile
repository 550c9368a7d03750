# The service and the simulator in one image. Debian's own Python: `make test-image` runs these very steps without an engine.

FROM debian:trixie-slim AS build
RUN apt-get update \
 && apt-get install --yes --no-install-recommends python3 python3-venv binutils gcc libc6-dev
WORKDIR /src
COPY requirements requirements
RUN python3 -m venv /opt/build \
 && /opt/build/bin/pip install --no-cache-dir --require-hashes -r requirements/build.txt \
 && python3 -m venv /opt/decklander \
 && /opt/decklander/bin/pip install --no-cache-dir --require-hashes -r requirements/video.txt -r requirements/ship.txt
# Git's version is not in here: docker build --build-arg VERSION=$(make -s version).
ARG VERSION
COPY pyproject.toml README.md LICENSE PKG-INFO* ./
COPY companion companion
COPY drivers drivers
COPY estimator estimator
COPY sitl sitl
COPY decklander decklander
COPY configs configs
COPY supply supply
RUN SETUPTOOLS_SCM_PRETEND_VERSION=$VERSION /opt/build/bin/pip wheel --no-cache-dir --no-deps --no-build-isolation --wheel-dir /wheels . \
 && /opt/decklander/bin/pip install --no-cache-dir --no-deps /wheels/decklander-*.whl
# What nobody here uses goes, and the installer itself.
RUN sh requirements/slim.sh /opt/decklander \
 && for command in demo run record replay doctor campaign detect start fly; do /opt/decklander/bin/decklander $command --help > /dev/null || exit 1; done
# The bill of materials travels with what it describes. Its maker stays in this stage.
RUN /opt/build/bin/pip install --no-cache-dir --require-hashes -r requirements/supply.txt \
 && mkdir -p /opt/decklander/share/decklander \
 && /opt/build/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
    -o /opt/decklander/share/decklander/sbom.cdx.json /opt/decklander

FROM debian:trixie-slim
RUN apt-get update \
 && apt-get install --yes --no-install-recommends python3 \
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/*.bin /usr/share/doc/* /usr/share/man/*
RUN useradd --uid 10001 --no-create-home --home-dir /var/lib/decklander --shell /usr/sbin/nologin decklander \
 && install --directory --owner decklander --group decklander --mode 0700 /var/lib/decklander
COPY --from=build /opt/decklander /opt/decklander
ENV PATH=/opt/decklander/bin:/usr/bin:/bin
ENV PYTHONDONTWRITEBYTECODE=1
ENV PYTHONUNBUFFERED=1
ENV MPLCONFIGDIR=/tmp
ENV STATE_DIRECTORY=/var/lib/decklander
WORKDIR /var/lib/decklander
USER decklander
# What BlueOS reads of an extension. It starts the container by the permissions, which are the engine's own interface for that: as
# root without capabilities, since it makes the folder of the settings as root. The page is https, with a token.
ARG VERSION
LABEL version="$VERSION"
LABEL type="device-integration"
LABEL requirements="core >= 1.1"
LABEL tags='["navigation", "camera", "landing"]'
LABEL authors='[{"name": "The authors of Decklander", "email": ""}]'
LABEL company='{"name": "Decklander", "about": "Lands a copter on a moving ship with one camera", "email": ""}'
LABEL permissions='{ \
  "Cmd": ["run", "--config", "/var/lib/decklander/rig.toml"], \
  "User": "0:0", \
  "Healthcheck": {"Test": ["NONE"]}, \
  "HostConfig": { \
    "NetworkMode": "host", \
    "CapDrop": ["ALL"], \
    "SecurityOpt": ["no-new-privileges:true"], \
    "ReadonlyRootfs": true, \
    "Tmpfs": {"/tmp": ""}, \
    "Init": true, \
    "DeviceCgroupRules": ["c 81:* rw"], \
    "Binds": ["/usr/blueos/extensions/decklander:/var/lib/decklander", "/dev:/dev"] \
  } \
}'
# Asks the metrics endpoint of the settings, which must be on, at its usual port.
HEALTHCHECK --interval=10s --timeout=3s --start-period=20s --retries=3 \
  CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8480/health', timeout=2)"]
ENTRYPOINT ["decklander"]
CMD ["--help"]
