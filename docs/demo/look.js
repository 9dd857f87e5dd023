// The drawable parts of a scene: its geoms and meshes, from MuJoCo's model.

const GROUP = 3; // geoms of this group and above only collide

const isShown = ({ model }, geom) => model.geom_group[geom] < GROUP;

// Numbers of the geoms to draw that move.
export const moving = (physics) =>
  [...physics.owner.keys()].filter((geom) => physics.owner[geom] >= 0 && isShown(physics, geom));

// All geoms to draw, where they are, which of them move, and their meshes by number.
export function look(physics) {
  const { model, owner } = physics;
  const shown = [...owner.keys()].filter((geom) => isShown(physics, geom));
  const meshes = {};
  const geoms = shown.map((g) => {
    const [mesh, material] = [model.geom_dataid[g], model.geom_matid[g]];
    if (mesh >= 0) meshes[mesh] ??= readMesh(model, mesh);
    return {
      type: model.geom_type[g],
      size: [...model.geom_size.subarray(3 * g, 3 * g + 3)],
      rgba: [...model.geom_rgba.subarray(4 * g, 4 * g + 4)],
      material: material < 0 ? "" : model.mat(material).name,
      mesh,
      car: owner[g],
    };
  });
  const places = physics.places(shown);
  return { geoms, meshes, places, moving: moving(physics).map((geom) => shown.indexOf(geom)) };
}

function readMesh(model, number) {
  const slice = (array, start, count) => array.slice(3 * start[number], 3 * (start[number] + count[number]));
  return {
    vertices: Float32Array.from(slice(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum)),
    faces: Uint32Array.from(slice(model.mesh_face, model.mesh_faceadr, model.mesh_facenum)),
  };
}
