# The simulator with the extra `lab`, for scheduler and workers of campaigns (docs/campaigns.md). All of a cluster run this one
# image: a worker with other code is refused.

FROM debian:trixie-slim
RUN apt-get update \
 && apt-get install --yes --no-install-recommends python3 python3-venv gcc libc6-dev \
 && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY requirements requirements
RUN python3 -m venv /opt/decklander \
 && /opt/decklander/bin/pip install --no-cache-dir --require-hashes -r requirements/build.txt -r requirements/lab.txt -r requirements/video.txt
COPY pyproject.toml README.md LICENSE ./
COPY companion companion
COPY drivers drivers
COPY estimator estimator
COPY sitl sitl
COPY decklander decklander
COPY configs configs
COPY supply supply
RUN /opt/decklander/bin/pip install --no-cache-dir --no-deps --no-build-isolation .
RUN useradd --uid 10001 --create-home --shell /usr/sbin/nologin decklander \
 && install --directory --owner decklander --group decklander /campaigns
ENV PATH=/opt/decklander/bin:/usr/bin:/bin
ENV PYTHONDONTWRITEBYTECODE=1
ENV OPENBLAS_NUM_THREADS=1
WORKDIR /tmp
USER decklander
ENTRYPOINT ["decklander"]
CMD ["--help"]
