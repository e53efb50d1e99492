"""The emergency brake of aeb.py as a process of its own: the protocol brink-driving/1 without any library.

brink driving check aeb_process.yaml
"""

import json
import os
import socket

channel = socket.socket(fileno=int(os.environ["BRINK_DRIVING_FD"])).makefile("rwb", buffering=1 << 16)


def say(name: str, content: object) -> None:
    """Send one message: a line of JSON."""
    channel.write(json.dumps({name: content}).encode() + b"\n")
    channel.flush()


hello = {"protocol": "brink-driving/1", "name": "emergency brake", "version": "1", "needs": "objects"}
say("hello", hello)
for line in channel:
    message = json.loads(line)
    if "start" in message:
        start = message["start"]
        bumper_m, reach_m = start["car"]["length_m"] / 2, start["car"]["width_m"] / 2 + 0.2
        within_s, until_s = start["settings"].get("within_s", 1.5), 0.0
        say("ready", {})
    elif "step" in message:
        step = message["step"]
        for one in step["objects"] or ():
            gap_m = one["x_m"] - one["length_m"] / 2 - bumper_m
            closing_mps = step["ego"]["speed_mps"] - one["vx_mps"]
            is_ahead = gap_m > 0 and abs(one["y_m"]) < reach_m + one["width_m"] / 2
            if is_ahead and gap_m < within_s * closing_mps:
                until_s = step["time_s"] + 0.5
        brakes = {"accel_mps2": -8.0, "emergency": True, "mode": "emergency brake"}
        say("decision", brakes if step["time_s"] < until_s else {})
