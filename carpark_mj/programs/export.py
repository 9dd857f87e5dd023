"""Exports a policy as an ONNX model, or as a checkpoint without training state.

carpark_mj export runs/cpu-0                      # runs/cpu-0/policy.onnx
carpark_mj export runs/cpu-0 --from-state         # runs/cpu-0/car.onnx, for a car
carpark_mj export runs/cpu-0 --out policy.npz     # as the pretrained policies are

An ONNX model has an input for every observation field, with the normalisation inside.
With --from-state the observation is inside too; inputs are poses of the car, the others
and the walls. A model is written only if onnxruntime computes the policy's actions with
it.
"""

from collections.abc import Sequence

from carpark_mj.cli.common import keep_compiled_programs


def run(arguments: Sequence[str] | None = None) -> None:
    """Exports."""
    # Without output fusion: XLA 0.10 dies of it here (openxla/xla#47367).
    keep_compiled_programs()
    from carpark_mj.cli.driver import command_help
    from carpark_mj.cli.export import ExportConfig, main
    from carpark_mj.cli.flags import read_flags

    main(read_flags(ExportConfig, arguments, description=command_help(__doc__)))
