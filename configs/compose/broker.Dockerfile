# mosquitto with the configuration of configs/broker; certificates and passwords are made at its first start.

FROM debian:trixie-slim
RUN apt-get update \
 && apt-get install --yes --no-install-recommends mosquitto mosquitto-clients openssl \
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/*.bin /usr/share/doc/* /usr/share/man/*
RUN useradd --uid 10001 --no-create-home --home-dir /var/lib/mosquitto --shell /usr/sbin/nologin decklander \
 && install --directory --owner decklander --group decklander --mode 0700 /keys \
 && install --directory --owner decklander --group nogroup --mode 2750 /scrape \
 && chown --recursive decklander:decklander /var/lib/mosquitto \
 && rm -rf /etc/mosquitto/certs \
 && ln -s /var/lib/mosquitto/certs /etc/mosquitto/certs \
 && ln -s /var/lib/mosquitto/decklander.passwords /etc/mosquitto/decklander.passwords
COPY configs/broker/mosquitto.conf /etc/mosquitto/conf.d/decklander.conf
COPY configs/broker/decklander.acl /etc/mosquitto/decklander.acl
COPY configs/compose/broker.sh /usr/local/bin/broker.sh
USER decklander
ENTRYPOINT ["sh", "/usr/local/bin/broker.sh"]
