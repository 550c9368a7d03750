"""The facts that are reported of a flight, each in one schema. Recorder, MQTT, page, live data and bags choose rate and framing."""
