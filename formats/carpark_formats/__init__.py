"""Files and protocols of other programs for carpark_mj."""

from typing import Any

from carpark_mj.programs import COMMANDS, KEEPING, Command


def _command(home: str, summary: str, settings: str, **more: Any) -> Command:
    settings = f"carpark_formats.settings:{settings}"
    return Command(f"carpark_formats.{home}", summary, settings, KEEPING, **more)


# Here, so that the list of commands needs none of the formats' modules.
COMMANDS.update(
    {
        "layouts import": _command(
            "exchange:import_layout", "make a layout of a map", "ImportConfig"
        ),
        "scenario import": _command(
            "exchange:read",
            "make a scenario of OpenSCENARIO, CommonRoad, ParkBench",
            "ScenarioImportConfig",
        ),
        "scenario export": _command(
            "exchange:write",
            "write OpenSCENARIO, or drives for CommonRoad",
            "ScenarioExportConfig",
        ),
        "serve": _command(
            "json_lines:serve",
            "step a lot from outside, by JSON lines",
            "ServeConfig",
            drives=True,
        ),
        # The core's writes checkpoints alone. Without output fusion, of which XLA 0.10
        # dies here (openxla/xla#47367).
        "export": _command(
            "onnx.export:main",
            "export a policy as an ONNX model, or as a checkpoint",
            "OnnxConfig",
            drives=True,
            extended=True,
        ),
    }
)
