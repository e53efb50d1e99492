"""Evaluation of a detector: average precision, calibration, tables by distance and size, and plots."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from brink.sim.perception.boxes import (
    Curve,
    Detections,
    LabelledFrame,
    calibration,
    curves,
    mean_average_precision,
)
from brink.sim.perception.detector import LABELS, Detector

DEPTHS_M: Final = ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, 40.0), (40.0, 80.0))
THRESHOLD: Final = 0.5
SIDES_PX: Final = (6, 8, 12, 16)
"""Side lengths in images of 640 x 360; the network receives half of that."""
_COLOURS: Final = ("#0072b2", "#d55e00")


def evaluate(detector: Detector, frames: Sequence[LabelledFrame]) -> tuple[dict[str, Any], list[Curve]]:
    """Return a detector's metrics as plain JSON values, and its precision-recall curve for each class."""
    truths = [frame.truth for frame in frames]
    detections = [detector.detect(frame.picture) for frame in frames]
    by_class = curves(truths, detections)
    figures: dict[str, Any] = {
        "pictures": len(frames),
        "map": float(np.mean([curve.average_precision for curve in by_class])),
        "classes": {LABELS[curve.label]: _class_figures(curve) for curve in by_class},
    }
    figures["by_shorter_side"] = [
        {"from_px": side, "map": _from_side(side, frames, detections)} for side in SIDES_PX
    ]
    for name, figure in figures["classes"].items():
        figure["by_depth"] = _by_depth(LABELS.index(name), frames, detections)
    return figures, by_class


def _class_figures(curve: Curve) -> dict[str, Any]:
    precision, recall = curve.at_score(THRESHOLD)
    return {
        "average_precision": curve.average_precision,
        "positives": curve.positives,
        "threshold": THRESHOLD,
        "precision": precision,
        "recall": recall,
        "calibration": [
            {"score": score, "right": right, "detections": count}
            for score, right, count in calibration(curve)
        ],
    }


def _from_side(side_px: float, frames: Sequence[LabelledFrame], detections: Sequence[Detections]) -> float:
    """Return the mAP when true boxes with a side shorter than `side_px` are ignored."""
    truths = []
    for frame in frames:
        sides = (frame.truth.boxes[:, 2:] - frame.truth.boxes[:, :2]).min(axis=1)
        truths.append(replace(frame.truth, ignored=frame.truth.ignored | (sides < side_px)))
    return mean_average_precision(truths, detections)


def _by_depth(
    label: int, frames: Sequence[LabelledFrame], detections: Sequence[Detections]
) -> list[dict[str, Any]]:
    """Return average precision and recall for each range of distances; bodies outside it are ignored."""
    rows = []
    for low_m, high_m in DEPTHS_M:
        truths = []
        for frame in frames:
            outside = (frame.depths_m < low_m) | (frame.depths_m >= high_m)
            truths.append(replace(frame.truth, ignored=frame.truth.ignored | outside))
        rows += [
            {
                "from_m": low_m, "to_m": high_m, "positives": curve.positives,
                "average_precision": curve.average_precision, "recall": curve.at_score(THRESHOLD)[1],
            }
            for curve in curves(truths, detections) if curve.label == label
        ]  # fmt: skip
    return rows


def plot(figures: dict[str, Any], by_class: Sequence[Curve]) -> Figure:
    """Plot precision against recall, share of correct detections against score, and recall against distance."""
    figure = Figure(figsize=(12, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    for curve, colour in zip(by_class, _COLOURS, strict=False):
        name = LABELS[curve.label]
        left.plot(
            curve.recall, curve.precision, color=colour, label=f"{name}, AP {curve.average_precision:.2f}"
        )
        bins = figures["classes"][name]["calibration"]
        middle.plot([b["score"] for b in bins], [b["right"] for b in bins], "o-", color=colour, label=name)
        rows = figures["classes"][name]["by_depth"]
        depth_m = [0.5 * (row["from_m"] + row["to_m"]) for row in rows]
        right.plot(depth_m, [row["average_precision"] for row in rows], "o-", color=colour, label=name)
    middle.plot([0, 1], [0, 1], color="#999999", linewidth=1, linestyle=(0, (3, 3)))
    left.set(xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))
    middle.set(xlabel="score", ylabel="share of correct detections", xlim=(0, 1), ylim=(0, 1.02))
    right.set(xlabel="distance (m)", ylabel="average precision", ylim=(0, 1.02))
    for axes in (left, middle, right):
        axes.legend(frameon=False, fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def write_report(detector_id: str, detector: Detector, frames: Sequence[LabelledFrame], out: Path) -> None:
    """Evaluate a detector, write `evaluation.json` and `evaluation.png`, and print the tables.

    Args:
        detector_id: Id of the detector, for the report.
        detector: The detector.
        frames: Test images.
        out: Output folder.
    """
    figures, by_class = evaluate(detector, frames)
    figures = {"detector": detector_id, **figures}
    (out / "evaluation.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    plot(figures, by_class).savefig(out / "evaluation.png", dpi=110, metadata={"Software": None})
    print(f"{detector_id}: mAP@0.5 {figures['map']:.3f} on {len(frames)} test images")  # noqa: T201
    sides = ", ".join(f"from {row['from_px']} px {row['map']:.3f}" for row in figures["by_shorter_side"])
    print(f"  by shorter side of the boxes: {sides}")  # noqa: T201
    for name, figure in figures["classes"].items():
        print(  # noqa: T201
            f"  {name}: AP {figure['average_precision']:.3f} of {figure['positives']}, at {THRESHOLD} "
            f"precision {figure['precision']:.2f} recall {figure['recall']:.2f}"
        )
        for row in figure["by_depth"]:
            print(  # noqa: T201
                f"    {row['from_m']:g} to {row['to_m']:g} m: AP {row['average_precision']:.2f}, "
                f"recall {row['recall']:.2f} of {row['positives']}"
            )
