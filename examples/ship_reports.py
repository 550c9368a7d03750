"""Report the ship's place to a drone over MQTT. Needs paho-mqtt alone.

python ship_reports.py HOST PORT CA_FILE USER PASSWORD_FILE DRONE [KEY_FILE]

Each line of the input is latitude, longitude (degrees) and, if known, speed (m/s), course and heading (degrees).
"""

import hashlib
import hmac
import json
import sys
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt

host, port, ca, user, password, drone, *key = sys.argv[1:]
tree = f"decklander/v2/{drone}"
known, ready = {}, threading.Event()


def on_connect(client, *_):
    client.subscribe([(f"{tree}/operator", 1), (f"{tree}/health", 0)])


def on_message(client, _, message):
    content = json.loads(message.payload)
    if message.topic == f"{tree}/operator":
        known.clear()
        known["run"], known["session"] = content["run"], content["session"]
    elif content["session"] == known.get("session"):
        # The drone's clock is ahead of ours by this; the message that came fastest knows it best.
        offset = content["at_ns"] - time.monotonic_ns()
        known["offset"] = max(offset, known.get("offset", offset))
        ready.set()


client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
client.username_pw_set(user, Path(password).read_text().strip())
client.tls_set(ca)
client.on_connect, client.on_message = on_connect, on_message
client.connect(host, int(port))
client.loop_start()
for line in sys.stdin:
    names = ("latitude_deg", "longitude_deg", "speed_m_s", "course_deg", "heading_deg")
    place = dict(zip(names, map(float, line.split()), strict=False))
    at_ns = time.monotonic_ns()
    ready.wait(30)
    body = json.dumps({"run": known["run"], "at_ns": at_ns + known["offset"], **place}).encode()
    if key:
        sign = hmac.new(Path(key[0]).read_bytes(), f"{tree}/vessel\n".encode() + body, hashlib.sha256)
        body = sign.hexdigest().encode() + b" " + body
    client.publish(f"{tree}/vessel", body, qos=1).wait_for_publish(5)
