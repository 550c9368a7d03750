"""The facts that are reported of a flight, each in one schema. Recorder, MQTT, page and live data choose rate and framing."""
