"""A driving system as a process that leaves everything to Brink's own, and does one thing wrong if told to.

Run as ``driving_child.py FAULT ARGUMENT``.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time

FAULT, ARGUMENT = sys.argv[1], sys.argv[2]
FAULTY_STEP = 5
HELLO = {"protocol": "brink-driving/1", "name": "child", "version": "2.1", "needs": "boxes"}
ANSWERS = {
    "nan": '{"decision":{"accel_mps2":NaN}}',
    "wrong type": '{"decision":{"accel_mps2":"fast"}}',
    "unknown field": '{"decision":{"acceleration":1}}',
    "no object": '{"decision":[1,2]}',
    "no json": "accelerate!",
    "other message": '{"hello":{}}',
    "reports": '{"error":"lost the map"}',
    "wrong point": '{"decision":{"trajectory":[{"time_s":0}]}}',
    "wrong object": '{"decision":{"objects":[{"label":"cow"}]}}',
    "twice": '{"decision":{}}\n{"decision":{"accel_mps2":1}}',
    "endless": "x" * 5_000_000,
}
connection = socket.socket(fileno=int(os.environ["BRINK_DRIVING_FD"]))
channel = connection.makefile("rwb")


def say(text: str) -> None:
    channel.write(text.encode() + b"\n")
    channel.flush()


if FAULT == "forks":
    subprocess.Popen(["setsid", "sleep", ARGUMENT], env={}, start_new_session=True)
if FAULT == "silent":
    time.sleep(100)
if FAULT == "hello":
    HELLO |= json.loads(ARGUMENT)
say(json.dumps({"hello": HELLO}) if FAULT != "chatty" else "Hello, Brink!")
steps = 0
for line in channel:
    message = json.loads(line)
    if "start" in message:
        steps = 0
        if FAULT == "start":
            with open(f"{ARGUMENT}.json", "wb") as started:
                started.write(line)
        say('{"ready":{}}')
        continue
    faulty = steps == FAULTY_STEP
    steps += 1
    if FAULT == "prints":
        print("step", steps, "and more" * 2000)
    if faulty and FAULT in ("dies", "forks"):
        print("out of ideas", flush=True)
        sys.exit(3)
    if faulty and FAULT == "crashes":
        os.kill(os.getpid(), signal.SIGSEGV)
    if faulty and FAULT == "hangs":
        time.sleep(100)
    if faulty and FAULT == "hangs once" and not os.path.exists(f"{ARGUMENT}.pid"):
        with open(f"{ARGUMENT}.new", "w") as file:
            file.write(str(os.getpid()))
        os.rename(f"{ARGUMENT}.new", f"{ARGUMENT}.pid")
        time.sleep(100)
    if faulty and FAULT == "late":
        time.sleep(float(ARGUMENT))
    if faulty and FAULT == "closes":
        channel.close()
        connection.close()
        time.sleep(100)
    say(ANSWERS[FAULT] if faulty and FAULT in ANSWERS else '{"decision":{}}')
