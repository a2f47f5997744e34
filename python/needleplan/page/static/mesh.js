// Triangles for the 3D view: tubes along paths, normals of surfaces, and the matrix of the view.

// Sides of a tube: six look round at the width of a needle.
const SIDES = 6;

// Returns a tube of a radius around points (a Float32Array x, y, z, ...): positions, normals and triangles.
export function tube(points, radius) {
  const count = points.length / 3;
  const positions = new Float32Array(count * SIDES * 3);
  const normals = new Float32Array(count * SIDES * 3);
  const triangles = new Uint32Array(Math.max(count - 1, 0) * SIDES * 6);
  let across = null;
  for (let place = 0; place < count; place++) {
    const tangent = unit(minus(at(points, Math.min(place + 1, count - 1)), at(points, Math.max(place - 1, 0))));
    // The normal before, made orthogonal to the tangent, so that the tube is not wound up.
    across = unit(reject(across ?? other(tangent), tangent));
    const up = cross(tangent, across);
    for (let side = 0; side < SIDES; side++) {
      const angle = (2 * Math.PI * side) / SIDES;
      for (let part = 0; part < 3; part++) {
        const normal = Math.cos(angle) * across[part] + Math.sin(angle) * up[part];
        const index = 3 * (place * SIDES + side) + part;
        normals[index] = normal;
        positions[index] = points[3 * place + part] + radius * normal;
      }
    }
  }
  let next = 0;
  for (let place = 0; place + 1 < count; place++) {
    for (let side = 0; side < SIDES; side++) {
      const [a, b] = [place * SIDES + side, place * SIDES + ((side + 1) % SIDES)];
      triangles.set([a, b, b + SIDES, a, b + SIDES, a + SIDES], next);
      next += 6;
    }
  }
  return { positions, normals, triangles };
}

// Returns a ball of a radius (mm) around a point: positions, normals and triangles.
export function ball(center, radius) {
  const [rings, count] = [8, 12];
  const positions = new Float32Array((rings + 1) * count * 3);
  const normals = new Float32Array(positions.length);
  const triangles = new Uint32Array(rings * count * 6);
  let next = 0;
  for (let ring = 0; ring <= rings; ring++) {
    const over = (Math.PI * ring) / rings;
    for (let side = 0; side < count; side++) {
      const round = (2 * Math.PI * side) / count;
      const normal = [Math.sin(over) * Math.cos(round), Math.sin(over) * Math.sin(round), Math.cos(over)];
      const index = ring * count + side;
      normals.set(normal, 3 * index);
      positions.set(normal.map((part, axis) => center[axis] + radius * part), 3 * index);
      if (ring === rings) continue;
      const beside = ring * count + ((side + 1) % count);
      triangles.set([index, beside, beside + count, index, beside + count, index + count], next);
      next += 6;
    }
  }
  return { positions, normals, triangles };
}

// Returns several meshes as one.
export function joined(meshes) {
  const sum = (name) => meshes.reduce((total, mesh) => total + mesh[name].length, 0);
  const positions = new Float32Array(sum("positions"));
  const normals = new Float32Array(sum("positions"));
  const triangles = new Uint32Array(sum("triangles"));
  let [first, next] = [0, 0];
  for (const mesh of meshes) {
    positions.set(mesh.positions, first);
    normals.set(mesh.normals, first);
    for (let place = 0; place < mesh.triangles.length; place++) triangles[next + place] = mesh.triangles[place] + first / 3;
    first += mesh.positions.length;
    next += mesh.triangles.length;
  }
  return { positions, normals, triangles };
}

// Returns the normals of the vertices of a surface: sums of those of their triangles, each as long as its area.
export function normalsOf(positions, triangles) {
  const normals = new Float32Array(positions.length);
  for (let place = 0; place < triangles.length; place += 3) {
    const corners = [triangles[place], triangles[place + 1], triangles[place + 2]];
    const [a, b, c] = corners.map((corner) => at(positions, corner));
    const normal = cross(minus(b, a), minus(c, a));
    for (const corner of corners) for (let part = 0; part < 3; part++) normals[3 * corner + part] += normal[part];
  }
  return normals;
}

// Returns the matrix (by columns) from mm to the canvas: turned about `center`, in perspective. `size` mm fill the canvas.
export function viewMatrix({ turn, tilt, zoom }, center, size, ratio) {
  const [st, ct, si, ci] = [Math.sin(turn), Math.cos(turn), Math.sin(tilt), Math.cos(tilt)];
  // Right, up and towards the eye; z of the frame is up.
  const right = [ct, st, 0];
  const up = [st * si, -ct * si, ci];
  const near = [st * ci, -ct * ci, -si].map((part) => -part);
  const [width, distance] = [size / zoom, 3];
  const scale = 2 / width;
  const rows = [
    right.map((part) => (part * scale) / Math.max(ratio, 1)),
    up.map((part) => part * scale * Math.min(ratio, 1)),
    near.map((part) => (-part * scale) / 40),
    near.map((part) => (-part * scale) / (2 * distance)),
  ];
  const shifts = rows.map((row) => -(row[0] * center[0] + row[1] * center[1] + row[2] * center[2]));
  shifts[3] += 1;
  const matrix = new Float32Array(16);
  rows.forEach((row, index) => {
    for (let part = 0; part < 3; part++) matrix[4 * part + index] = row[part];
    matrix[12 + index] = shifts[index];
  });
  return { matrix, eye: near };
}

export function projected(matrix, [x, y, z]) {
  const row = (index) => matrix[index] * x + matrix[4 + index] * y + matrix[8 + index] * z + matrix[12 + index];
  const w = row(3);
  return [row(0) / w, row(1) / w, row(2) / w];
}

const at = (points, place) => [points[3 * place], points[3 * place + 1], points[3 * place + 2]];
const minus = (a, b) => a.map((part, index) => part - b[index]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const other = (a) => (Math.abs(a[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);

function reject(a, axis) {
  const along = dot(a, axis);
  return a.map((part, index) => part - along * axis[index]);
}

function unit(a) {
  const length = Math.hypot(...a) || 1;
  return a.map((part) => part / length);
}
