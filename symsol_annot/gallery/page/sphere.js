// The set on the sphere of viewing directions, in Mollweide's map, with the tilt as colour (as in Implicit-PDF).
"use strict";

SYMSOL.sphere = (() => {
  const NAMESPACE = "http://www.w3.org/2000/svg", SCALE = 100;
  const { direction, mollweide, tiltColour } = SYMSOL.rotations;

  function node(name, attributes, text) {
    const made = document.createElementNS(NAMESPACE, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text) made.textContent = text;
    return made;
  }

  const at = (longitude, latitude) => mollweide(longitude, latitude).map((v, i) => (i ? -SCALE : SCALE) * v);
  const path = (points) => points.map((p, i) => `${i ? "L" : "M"}${p[0].toFixed(2)},${p[1].toFixed(2)}`).join("");
  const range = (from, to, step) => Array.from({ length: Math.round((to - from) / step) + 1 }, (_, i) => from + i * step);
  const rad = (degrees) => (degrees * Math.PI) / 180;

  function graticule() {
    const lines = [];
    for (const longitude of range(-180, 180, 45)) lines.push(range(-90, 90, 3).map((b) => at(rad(longitude), rad(b))));
    for (const latitude of range(-60, 60, 30)) lines.push(range(-180, 180, 5).map((l) => at(rad(l), rad(latitude))));
    return node("path", { d: lines.map(path).join(""), class: "graticule" });
  }

  const LABELS = [[0, 0, "to the camera"], [90, 0, "right"], [-90, 0, "left"], [0, 78, "up"], [0, -78, "down"]];

  function diamond(x, y, size) {
    return `M${x - size},${y}L${x},${y - size}L${x + size},${y}L${x},${y + size}Z`;
  }

  function draw(place, scene) {
    const svg = node("svg", { viewBox: "-290 -148 580 296", "aria-hidden": "true" });
    svg.append(graticule());
    const radius = scene.members.length > 60 ? 3 : 5.5;
    const dot = (quaternion, attributes) => {
      const { longitude, latitude, tilt } = direction(quaternion);
      const [x, y] = at(longitude, latitude);
      svg.append(node("circle", { cx: x.toFixed(2), cy: y.toFixed(2), fill: tiltColour(tilt), ...attributes }));
    };
    if (scene.volume) for (const quaternion of scene.volume.dots) dot(quaternion, { r: 2, class: "volume" });
    for (const quaternion of scene.members) dot(quaternion, { r: radius });
    scene.predicted.forEach((quaternion, i) => {
      const { longitude, latitude, tilt } = direction(quaternion);
      const d = diamond(...at(longitude, latitude), 3 + 4 * Math.sqrt(scene.weights[i]));
      svg.append(node("path", { d, class: "predicted", fill: tiltColour(tilt) }));
    });
    for (const [longitude, latitude, text] of LABELS) {
      const [x, y] = at(rad(longitude), rad(latitude));
      svg.append(node("text", { x, y: y + 12, class: "map-label" }, text));
    }
    ring(svg, scene.own, "own");
    if (scene.marked) ring(svg, scene.marked, "marked");
    place.replaceChildren(svg);
  }

  function ring(svg, quaternion, kind) {
    const { longitude, latitude } = direction(quaternion);
    const [cx, cy] = at(longitude, latitude);
    svg.append(node("circle", { cx, cy, r: 10, class: kind }));
  }

  function wheel(place) {
    const svg = node("svg", { viewBox: "-62 -52 124 104" });
    for (let degrees = 0; degrees < 360; degrees += 5) {
      const ends = [degrees - 0.5, degrees + 5.5].map(rad);
      const arc = [[24, ends[0]], [34, ends[0]], [34, ends[1]], [24, ends[1]]];
      const d = `${path(arc.map(([r, t]) => [r * Math.cos(t), -r * Math.sin(t)]))}Z`;
      svg.append(node("path", { d, fill: tiltColour(rad(degrees + 2.5)) }));
    }
    svg.append(node("text", { x: 0, y: 3, class: "map-label" }, "tilt"));
    const marks = [[0, "0°"], [90, "90°"], [180, "180°"], [270, "−90°"]];
    for (const [degrees, text] of marks) {
      const [x, y] = [47 * Math.cos(rad(degrees)), -43 * Math.sin(rad(degrees))];
      svg.append(node("text", { x, y: y + 3, class: "wheel-label" }, text));
    }
    place.replaceChildren(svg);
  }

  return { draw, wheel };
})();
