"""Parks a car of an exported scene with MuJoCo, NumPy and onnxruntime alone.

carpark_mj export square --from-state --out car.onnx
carpark_mj scene --num-agents 1 --out scene.xml
python examples/deploy/drive.py scene.xml car.onnx
"""

import json
import sys

import mujoco
import numpy as np
import onnxruntime

MAX_SPEED = 3.0  # m/s, forwards; the guide at the top of the scene has it
MOTION = {"pose", "speed", "yaw_rate", "steering"}  # filled in every step
FULL, HOLD = 0.3, 0.2  # brake of a full pedal, and of a car that is to stand


def park(scene_file: str, model_file: str, seconds: float = 60.0) -> dict[str, float]:
    """Drives to the nearest free bay; returns the car's final offset and speed."""
    session = onnxruntime.InferenceSession(model_file)
    about = json.loads(session.get_modelmeta().custom_metadata_map["carpark_mj"])
    inputs = {x["name"]: np.zeros(x["dims"], x["dtype"]) for x in about["inputs"]}
    model = mujoco.MjModel.from_xml_path(scene_file)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geoms = {model.geom(k).name: k for k in range(model.ngeom)}

    def boxes(start, end=""):  # poses (n, 3) and sizes (n, 2)
        of = [k for n, k in geoms.items() if n.startswith(start) and n.endswith(end)]
        yaw = np.arctan2(data.geom_xmat[of, 3], data.geom_xmat[of, 0])
        return np.c_[data.geom_xpos[of, :2], yaw], 2 * model.geom_size[of, :2]

    filled = set()

    def fill(**known):  # other inputs are 0, so that masks leave padding out
        filled.update(known)
        for name in known.keys() & inputs.keys():
            value = np.asarray(known[name])
            inputs[name][tuple(map(slice, value.shape))] = value

    (left, size), (right, _), (end, _) = (
        boxes("bay", f"/{side}") for side in ("left", "right", "end")
    )
    bays, out = (left + right) / 2, (left + right) / 2 - end  # out into the aisle
    bays[:, 2] = np.arctan2(out[:, 1], out[:, 0])
    size[:, 1] = np.linalg.norm((left - right)[:, :2], axis=1)
    parked, _ = boxes("parked", "/hull")
    taken = np.linalg.norm(bays[:, None, :2] - parked[:, :2], axis=2).min(axis=1) < 1
    [own], [own_size] = boxes("agent0/hull")
    way = np.linalg.norm(bays[:, :2] - own[:2], axis=1)
    goal = np.argmin(np.where(taken, np.inf, way))
    max_steering = model.actuator("agent0/steer").ctrlrange[1]
    fill(goal_pose=bays[goal], goal_size=size[goal], size=own_size)
    fill(max_speed=MAX_SPEED, max_steering=max_steering)
    for kind, end in (("parked", "/hull"), ("wall", "")):
        pose, size = boxes(kind, end)
        there = {"pose": pose, "size": size, "mask": np.full(len(pose), True)}
        fill(**{f"{kind}_{name}": value for name, value in there.items()})
    padded = {name.removesuffix("_mask") for name in inputs if name.endswith("_mask")}
    own_inputs = {name for name in inputs if name.split("_")[0] not in padded}
    if unknown := sorted(own_inputs - filled - MOTION):
        sys.exit(
            f"{model_file} also reads {', '.join(unknown)}, which are unknown here"
        )
    steer, drive, brake = (
        data.actuator(f"agent0/{name}") for name in ("steer", "drive", "brake")
    )
    root, column = data.joint("agent0/root"), data.joint("agent0/steer")
    gap = speed = np.inf
    while data.time < seconds and (gap > 0.2 or abs(speed) > 0.05):
        [own], _ = boxes("agent0/hull")
        gap = np.linalg.norm(own[:2] - bays[goal, :2])
        speed = root.qvel[:2] @ [np.cos(own[2]), np.sin(own[2])]
        fill(pose=own, speed=speed, yaw_rate=root.qvel[5], steering=column.qpos[0])
        turn, pedal = session.run(None, inputs)[0]
        opposed = pedal * speed < 0 and abs(speed) > 0.1
        stands = abs(pedal) < 0.05 and abs(speed) < 0.3
        steer.ctrl = turn * max_steering
        drive.ctrl = speed / MAX_SPEED + (0.0 if opposed or stands else pedal)
        brake.ctrl = FULL * abs(pedal) if opposed else HOLD * stands
        mujoco.mj_step(model, data, round(about["decision_time"] / model.opt.timestep))
    turned = abs(np.sin(own[2] - bays[goal, 2]))
    return {"seconds": data.time, "metres": gap, "sine": turned, "speed": abs(speed)}


if __name__ == "__main__":
    print(json.dumps(park(*sys.argv[1:]), indent=2))
