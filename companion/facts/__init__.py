"""What is reported of a flight, each fact in one schema. Recorder, MQTT, page, live data and bags choose rate and framing."""
