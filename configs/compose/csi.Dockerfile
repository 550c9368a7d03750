# A Raspberry Pi's own camera for the service's image: libcamera and picamera2 of Raspberry Pi's archive, for Debian 13's Python,
# which the service starts for the camera alone (docs/installation.md#a-csi-camera-in-a-container). By documents alone.

FROM decklander
USER root
RUN apt-get update \
 && apt-get install --yes --no-install-recommends ca-certificates curl \
 && curl --fail --silent --show-error --output /usr/share/keyrings/raspberrypi.asc https://archive.raspberrypi.com/debian/raspberrypi.gpg.key \
 && echo "deb [signed-by=/usr/share/keyrings/raspberrypi.asc] https://archive.raspberrypi.com/debian trixie main" > /etc/apt/sources.list.d/raspberrypi.list \
 && apt-get update \
 && apt-get install --yes --no-install-recommends python3-picamera2 \
 && rm -rf /var/lib/apt/lists/*
USER decklander
