"""ONNX models: of policies with or without their observation, and as policies."""

from typing import Any

from carpark_mj.extensions import Entry
from carpark_mj.policy.named import READERS

_reader: Any = Entry("carpark_formats.onnx.models:from_onnx")
READERS.register("onnx", _reader)
