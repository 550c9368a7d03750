"""Give a drone one signed command over MQTT; exit code 0 when it has carried it out. Needs paho-mqtt alone.

python mqtt_command.py HOST PORT CA_FILE USER PASSWORD_FILE DRONE KEY_FILE '{"command": "hold"}'
"""

import hashlib
import hmac
import json
import sys
import threading
import uuid
from pathlib import Path

import paho.mqtt.client as mqtt

host, port, ca, user, password, drone, key, command = sys.argv[1:]
tree = f"decklander/v2/{drone}"
reply = f"{tree}/reply/{uuid.uuid4().hex[:8]}"
received, answered = {}, threading.Event()


def on_connect(client, *_):
    client.subscribe([(f"{tree}/operator", 1), (f"{tree}/health", 1), (reply, 1)])


def on_message(client, _, message):
    received[message.topic] = content = json.loads(message.payload)
    operator, health = received.get(f"{tree}/operator"), received.get(f"{tree}/health")
    if message.topic == reply:
        print("accepted" if content["accepted"] else f"refused: {content['text']}")
        answered.set()
    elif operator and health and operator["session"] == health["session"] and "sent" not in received:
        received["sent"] = True
        fields = {
            "id": uuid.uuid4().hex,
            "run": operator["run"],
            "given_ns": health["at_ns"],
            "expires_ns": health["at_ns"] + 5_000_000_000,
            "reply_to": reply,
        }
        body = json.dumps({**json.loads(command), **fields}).encode()
        signature = hmac.new(Path(key).read_bytes(), f"{tree}/command\n".encode() + body, hashlib.sha256).hexdigest()
        client.publish(f"{tree}/command", signature.encode() + b" " + body, qos=1)


client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
client.username_pw_set(user, Path(password).read_text().strip())
client.tls_set(ca)
client.on_connect, client.on_message = on_connect, on_message
client.connect(host, int(port))
client.loop_start()
answered.wait(10) or print("no answer within 10 s")
sys.exit(0 if received.get(reply, {}).get("accepted") else 1)
