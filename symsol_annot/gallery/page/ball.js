// Rotations as rotation vectors in the ball of radius pi, drawn by plotly, turning slowly until somebody takes hold.
"use strict";

SYMSOL.ball = (() => {
  const FRAME_MS = 50, TURN_RAD = 0.012, HEIGHT = 0.42, DISTANCE = 1.5;
  let place = null, button = null, loading = null;
  let isTurning = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  let angle = -0.9, drawn = false, isHeld = false, busyUntil = 0;

  function eye() {
    return { x: DISTANCE * Math.cos(angle), y: DISTANCE * Math.sin(angle), z: HEIGHT };
  }

  function connect(element, turnButton) {
    place = element;
    button = turnButton;
    button.addEventListener("click", toggle);
    place.addEventListener("pointerdown", () => { if (isTurning) toggle(); }, { passive: true });
    label();
    new ResizeObserver(() => { if (drawn && place.offsetParent) window.Plotly.Plots.resize(place); }).observe(place);
    requestAnimationFrame(turn);
  }

  function label() {
    button.textContent = isTurning ? "Stop turning" : "Turn";
  }

  function toggle() {
    isTurning = !isTurning;
    label();
  }

  function turn(now) {
    requestAnimationFrame(turn);
    if (!isTurning || !drawn || isHeld || document.hidden || now < busyUntil || place.offsetParent === null) return;
    angle += TURN_RAD;
    isHeld = true;
    const started = performance.now();
    window.Plotly.relayout(place, { "scene.camera.eye": eye() }).catch(() => {}).finally(() => {
      isHeld = false;
      const cost = performance.now() - started; // on a machine without a GPU: turn seldom rather than block the page
      busyUntil = now + Math.max(FRAME_MS, 4 * cost);
    });
  }

  function circle(axis) {
    const path = [[], [], []];
    for (let i = 0; i <= 72; i++) {
      const t = (2 * Math.PI * i) / 72;
      const point = [Math.PI * Math.cos(t), Math.PI * Math.sin(t), 0];
      for (let c = 0; c < 3; c++) path[c].push(point[(c + axis) % 3]);
    }
    return path;
  }

  function outline(colour) {
    const line = (x, y, z, width) => ({
      type: "scatter3d", mode: "lines", x, y, z, line: { color: colour, width }, hoverinfo: "skip",
    });
    const traces = [0, 1, 2].map((axis) => line(...circle(axis), 2));
    for (let axis = 0; axis < 3; axis++) {
      const ends = [[0, 0], [0, 0], [0, 0]];
      ends[axis] = [-Math.PI, Math.PI];
      traces.push(line(...ends, 1));
    }
    return traces;
  }

  function points(quaternions, marker, hover) {
    const vectors = quaternions.map(SYMSOL.rotations.rotationVector);
    return {
      type: "scatter3d",
      mode: "markers",
      x: vectors.map((v) => v[0]),
      y: vectors.map((v) => v[1]),
      z: vectors.map((v) => v[2]),
      marker,
      text: hover,
      hovertemplate: "%{text}<br>(%{x:.2f}, %{y:.2f}, %{z:.2f}) rad<extra></extra>",
    };
  }

  function traces(scene) {
    const { colour } = SYMSOL.theme;
    const { direction, tiltColour } = SYMSOL.rotations;
    const axes = { type: "scatter3d", mode: "text", hoverinfo: "skip", text: ["x", "y", "z"],
      x: [3.5, 0, 0], y: [0, 3.5, 0], z: [0, 0, 3.5], textfont: { color: colour("quiet"), size: 12 } };
    const found = [...outline(colour("rule")), axes];
    if (scene.volume) {
      found.push(points(scene.volume.dots, {
        size: 2.5, opacity: 0.85, color: scene.volume.dots.map((q) => tiltColour(direction(q).tilt)), line: { width: 0 },
      }, scene.volume.dots.map(() => "in the volume")));
    }
    found.push(points(scene.members, {
      size: scene.members.length > 60 ? 3 : 6,
      color: scene.members.map((q) => tiltColour(direction(q).tilt)),
      line: { width: 0 },
    }, scene.elements.map((element) => `member ${element}`)));
    found.push(points([scene.own], {
      size: 11, symbol: "circle-open", color: colour("ink"), line: { width: 2, color: colour("ink") },
    }, ["this image"]));
    if (scene.predicted.length) {
      const least = scene.predicted.length > 60 ? 1 : scene.members.length > 60 ? 4 : 11; // around the discs
      found.push(points(scene.predicted, {
        size: scene.weights.map((w) => least + 7 * Math.sqrt(w)), symbol: "diamond-open", color: colour("ink"),
      }, scene.weights.map((w) => `predicted, weight ${w.toFixed(2)}`)));
    }
    if (scene.marked) {
      found.push(points([scene.marked], { size: 10, symbol: "cross", color: colour("marked") }, ["drawn again"]));
    }
    return found;
  }

  function layout() {
    const hidden = { visible: false, range: [-3.6, 3.6] };
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 },
      paper_bgcolor: "rgba(0,0,0,0)",
      showlegend: false,
      uirevision: "kept",
      hoverlabel: { font: { size: 11 } },
      scene: { xaxis: hidden, yaxis: hidden, zaxis: hidden, aspectmode: "cube", dragmode: "orbit",
        camera: { eye: eye(), center: { x: 0, y: 0, z: 0 } }, bgcolor: "rgba(0,0,0,0)" },
    };
  }

  async function draw(scene) {
    loading = loading || SYMSOL.store.load("assets/plotly.min.js");
    await loading;
    if (!hasWebGL()) {
      place.textContent = "This browser draws no three-dimensional plots (WebGL is off).";
      return;
    }
    const wanted = layout();
    if (drawn && !isTurning) wanted.scene.camera = place.layout.scene.camera; // somebody holds it: keep their view
    await window.Plotly.react(place, traces(scene), wanted, { displayModeBar: false, scrollZoom: false });
    document.getElementById("js-plotly-tester")?.setAttribute("aria-hidden", "true"); // its ruler for text
    drawn = true;
  }

  let webGL;
  function hasWebGL() {
    if (webGL === undefined) {
      const context = document.createElement("canvas").getContext("webgl");
      webGL = Boolean(context);
      if (context) context.getExtension("WEBGL_lose_context")?.loseContext();
    }
    return webGL;
  }

  return { connect, draw, toggle };
})();
