"""Quantisation of a trained network to 8-bit integers.

Sums of 8-bit products are exact. Weights use only seven bits, so that these sums do not saturate on any processor.
Scales come from the range of each layer's output on a few training images. The first layer, the brightness that it
sees, and the last layers, whose outputs are logits and pixels, remain in floating point.
"""

import tempfile
from pathlib import Path
from typing import Any, Final

import onnx
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from brink.sim.perception.detector import NetworkDetector, Picture, to_planes

_QUANTISED: Final = ("Conv", "Relu", "Add", "Concat", "Resize")
_LAYERS_IN_FLOAT: Final = ("/stem/", "/box/box.1/", "/heat/heat.1/")


def quantise(weights: Path, canvases: Picture, out: Path) -> None:
    """Write a network of `brink-det` with 8-bit weights and activations.

    Args:
        weights: ONNX file of the network in floating point.
        canvases: Training images in the network's input format, shape ``(n, h, w, 3)``, uint8.
        out: ONNX file to write.
    """
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared.onnx"
        quant_pre_process(str(weights), str(prepared))
        quantize_static(
            str(prepared),
            str(out),
            _Calibration(NetworkDetector.from_file(weights).input_name, canvases),
            quant_format=QuantFormat.QDQ,
            op_types_to_quantize=list(_QUANTISED),
            per_channel=True,
            reduce_range=True,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            nodes_to_exclude=_nodes_in_float(prepared),
        )


class _Calibration(CalibrationDataReader):  # type: ignore[misc] # untyped
    """Feeds images to the calibration, one by one."""

    def __init__(self, name: str, canvases: Picture) -> None:
        self._inputs = iter({name: to_planes(canvas)} for canvas in canvases)

    def get_next(self) -> dict[str, Any] | None:
        return next(self._inputs, None)


def _nodes_in_float(file: Path) -> list[str]:
    """Return the nodes before the first layer, which compute the brightness, and those of `_LAYERS_IN_FLOAT`."""
    nodes = onnx.load(str(file)).graph.node
    first = next(place for place, node in enumerate(nodes) if node.name.startswith("/stem/"))
    brightness = {node.name for node in nodes[:first]}
    return [node.name for node in nodes if node.name in brightness or node.name.startswith(_LAYERS_IN_FLOAT)]
