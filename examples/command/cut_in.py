"""A car cuts in ahead of the ego and brakes; the ego brakes after a delay. Reads settings.json, writes log.csv."""

import csv
import json
import sys

STEP_S = 0.02
with open("settings.json") as file:
    settings = json.load(file)
friction = {"dry": 8.0, "wet": 4.5}[settings["road"]]
delay_s = float(sys.argv[1])
ego_mps, gap_m = settings["ego_mps"], settings["gap_m"]
other_mps = ego_mps - settings["slower_mps"]

with open("log.csv", "w", newline="") as file:
    log = csv.writer(file)
    log.writerow(["time", "ego_speed", "bumper_gap"])
    for step in range(1000):
        now_s = step * STEP_S
        log.writerow([round(now_s, 2), ego_mps, gap_m])
        if ego_mps == 0.0 or gap_m <= 0.0:
            break
        other_mps = max(0.0, other_mps - 3.0 * STEP_S)
        closing_mps = ego_mps - other_mps
        wanted_m = 2.0 + ego_mps * 1.0 + ego_mps * closing_mps / (2 * (1.5 * 3.0) ** 0.5)
        wish_mps2 = 1.5 * (1 - (ego_mps / 40.0) ** 4 - (max(wanted_m, 2.0) / gap_m) ** 2)
        accel_mps2 = max(-friction, wish_mps2) if now_s >= delay_s else 0.0
        ego_mps = max(0.0, ego_mps + accel_mps2 * STEP_S)
        gap_m -= (ego_mps - other_mps) * STEP_S
