// Rotations as unit quaternions, scalar first, of R_m2c: camera axes x right, y down, z forward.
"use strict";

SYMSOL.rotations = (() => {
  // The product, as of matrices: first b, then a.
  function multiply([aw, ax, ay, az], [bw, bx, by, bz]) {
    return [
      aw * bw - ax * bx - ay * by - az * bz,
      aw * bx + ax * bw + ay * bz - az * by,
      aw * by - ax * bz + ay * bw + az * bx,
      aw * bz + ax * by - ay * bx + az * bw,
    ];
  }

  // The rotation vector: axis times angle in rad, of length at most pi.
  function rotationVector([w, x, y, z]) {
    const length = Math.hypot(x, y, z);
    if (length === 0) return [0, 0, 0];
    const scale = (w < 0 ? -1 : 1) * 2 * Math.atan2(length, Math.abs(w)) / length;
    return [scale * x, scale * y, scale * z];
  }

  function matrix([w, x, y, z]) {
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ];
  }

  // Q = Rz(0.2) Ry(0.2) Rx(0.2): its x axis lies on no axis of symmetry, so that rotations of a set get points of their own.
  const half = 0.1, about = (axis) => [0, 1, 2, 3].map((i) => (i === 0 ? Math.cos(half) : i === axis ? Math.sin(half) : 0));
  const SHOWN_AXES = multiply(multiply(about(3), about(2)), about(1));

  // Where the first column of R Q points, and the tilt about it, in the map's axes: towards the camera (-z), right (x),
  // up (-y). There R Q = Rz(longitude) Ry(-latitude) Rx(tilt), as in Implicit-PDF's plots.
  function direction(quaternion) {
    const R = matrix(multiply(quaternion, SHOWN_AXES));
    const forward = R[2].map((v) => -v), right = R[0], up = R[1].map((v) => -v);
    return {
      longitude: Math.atan2(right[0], forward[0]),
      latitude: Math.asin(Math.max(-1, Math.min(1, up[0]))),
      tilt: Math.atan2(up[1], up[2]),
    };
  }

  // Mollweide's equal-area map: x in [-2 sqrt 2, 2 sqrt 2], y in [-sqrt 2, sqrt 2].
  function mollweide(longitude, latitude) {
    let theta = latitude;
    if (Math.abs(latitude) < Math.PI / 2 - 1e-9) {
      for (let step = 0; step < 30; step++) {
        const change = (2 * theta + Math.sin(2 * theta) - Math.PI * Math.sin(latitude)) / (2 + 2 * Math.cos(2 * theta));
        theta -= change;
        if (Math.abs(change) < 1e-9) break;
      }
    }
    return [2 * Math.SQRT2 / Math.PI * longitude * Math.cos(theta), Math.SQRT2 * Math.sin(theta)];
  }

  // A circle in OKLab on which lightness and yellow-blue alone tell all tilts apart, so that a colour-blind eye can.
  function tiltColour(tilt) {
    const L = 0.65 + 0.14 * Math.cos(tilt), a = -0.09 * Math.cos(tilt), b = 0.13 * Math.sin(tilt);
    const l = (L + 0.3963377774 * a + 0.2158037573 * b) ** 3;
    const m = (L - 0.1055613458 * a - 0.0638541728 * b) ** 3;
    const s = (L - 0.0894841775 * a - 1.2914855480 * b) ** 3;
    const linear = [
      4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
      -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
      -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s,
    ];
    const bytes = linear.map((c) => {
      const clipped = Math.max(0, Math.min(1, c));
      return Math.round(255 * (clipped <= 0.0031308 ? 12.92 * clipped : 1.055 * clipped ** (1 / 2.4) - 0.055));
    });
    return `rgb(${bytes.join(",")})`;
  }

  return { multiply, rotationVector, matrix, direction, mollweide, tiltColour };
})();
