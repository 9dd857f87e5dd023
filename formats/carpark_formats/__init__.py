"""Files of other programs for carpark_mj: maps, scenarios, ONNX models."""

from carpark_mj.programs import COMMANDS, KEEPING, Command

# Here, so that the list of commands needs none of the formats' modules.
for _name, (_home, _summary, _settings) in {
    "layouts import": ("import_layout", "make a layout of a map", "ImportConfig"),
    "scenario import": (
        "read",
        "make a scenario of OpenSCENARIO, CommonRoad, ParkBench",
        "ScenarioImportConfig",
    ),
    "scenario export": (
        "write",
        "write OpenSCENARIO, or drives for CommonRoad",
        "ScenarioExportConfig",
    ),
}.items():
    COMMANDS[_name] = Command(
        f"carpark_formats.exchange:{_home}",
        _summary,
        f"carpark_formats.settings:{_settings}",
        KEEPING,
    )

COMMANDS["export"] = Command(  # the core's writes checkpoints alone
    "carpark_formats.onnx.export:main",
    "export a policy as an ONNX model, or as a checkpoint",
    "carpark_formats.settings:OnnxConfig",
    KEEPING,  # without output fusion, of which XLA 0.10 dies here (openxla/xla#47367)
    drives=True,
    extended=True,
)
