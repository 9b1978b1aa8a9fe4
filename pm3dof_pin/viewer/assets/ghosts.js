// Ghosts: translucent copies of drawn bodies, at other places than the bodies themselves.
"use strict";

hasWebGL && (() => {
  const { node } = pm3dof;
  const { THREE } = MeshCat;
  const materials = new Map(); // by path
  const STILL = new THREE.Matrix4();

  class Ghost {
    // Copies of bodies of the page's data, at a path in the scene.
    constructor(path, bodies, colour, opacity) {
      this.container = node(path).object;
      this.container.clear();
      if (!materials.has(path)) {
        materials.set(path, new THREE.MeshLambertMaterial({ color: colour, transparent: true, opacity, depthWrite: false, side: THREE.DoubleSide }));
      }
      const material = materials.get(path);
      this.copies = bodies.map((body) => {
        const copy = node(`${body.path}/visual`).object.clone(true);
        copy.traverse((part) => {
          if (part.material) part.material = material;
          part.castShadow = part.receiveShadow = false;
          part.visible = true;
        });
        const holder = new THREE.Group();
        holder.matrixAutoUpdate = false;
        holder.add(copy);
        this.container.add(holder);
        return { body, holder };
      });
    }

    get isEmpty() {
      return this.copies.length === 0;
    }

    set visible(value) {
      this.container.visible = value;
    }

    // Place the copies for a pose, moved by a further transform of the world.
    place(pose, moved = STILL) {
      this.copies.forEach(({ body, holder }) => {
        holder.matrix.fromArray(Robot.product(pose.placement(body.joint), body.placement)).premultiply(moved);
        holder.matrixWorldNeedsUpdate = true;
      });
    }
  }

  Object.assign(pm3dof, { Ghost });
})();
