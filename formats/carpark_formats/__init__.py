"""Files of other programs: maps of car parks and scenarios, for carpark_mj."""

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
