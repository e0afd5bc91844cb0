// One image, large: picture, segmentation, its set in two plots, scores, and what was drawn again.
"use strict";

SYMSOL.detail = (() => {
  const { multiply, matrix } = SYMSOL.rotations;
  const { WORDS, NO_MARKING, volumeOf, shareInWords } = SYMSOL.selection;
  const byId = (id) => document.getElementById(id);
  let model = null, shown = -1, scene = null;

  function make(name, text, attributes = {}) {
    const made = document.createElement(name);
    if (text !== undefined) made.textContent = text;
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  }

  const padded = (row) => String(row).padStart(6, "0");
  const figure = (value) => {
    if (value === null || value === undefined || Number.isNaN(value)) return "–";
    if (value === 0) return "0";
    return Math.abs(value) >= 1e-3 ? Number(value).toFixed(4) : Number(value).toExponential(1);
  };
  const pixels = (value) => `${Number(value.toFixed(2))} px`;
  const quaternionAt = (array, i) => Array.from(array.subarray(4 * i, 4 * i + 4));

  function chunkOf(row) {
    return String(Math.floor(row / model.index.chunk_images)).padStart(5, "0");
  }

  function files(id) {
    const set = model.index.sets[model.table.set[id]], row = model.table.row[id];
    const folder = `${set.folder}/${chunkOf(row)}`;
    return { folder, image: `${folder}/image-${padded(row)}.png`, segmentation: `${folder}/segmentation-${padded(row)}.png` };
  }

  function markingOf(id) {
    const stratum = model.table.stratum[id];
    const set = model.index.sets[model.table.set[id]];
    if (stratum === NO_MARKING) return set.breaking.length || !set.in_view ? WORDS[stratum] : "no part breaks the symmetry";
    if (set.breaking.length > 1) return `in view: ${SYMSOL.selection.partsInView(set, model.table.row[id]).join(", ")}`;
    return `${breakingName(set)} ${WORDS[stratum]}, ${pixels(model.table.pixels[id])}`;
  }

  // What breaks the symmetry, in a word: the part's name where it has one.
  function breakingName(set) {
    return set.breaking.length === 1 ? set.parts[set.breaking[0]] : "marking";
  }

  function plainMarkingOf(id) {
    return model.table.stratum[id] === NO_MARKING ? "none" : markingOf(id).replace("marking ", "");
  }

  // What a chunk of labels says of one image: its own quaternion, its members, and their numbers in the group.
  function membersOf(labels, id) {
    const set = model.index.sets[model.table.set[id]];
    const r = model.table.row[id] % model.index.chunk_images;
    labels.rotation = labels.rotation || SYMSOL.store.unpacked(labels.quat_wxyz);
    labels.bits = labels.bits || SYMSOL.store.unpacked(labels.mask);
    set.elements = set.elements || SYMSOL.store.unpacked(set.group);
    const own = quaternionAt(labels.rotation, r), stride = Math.ceil(set.group_order / 8);
    const elements = [];
    for (let g = 0; g < set.group_order; g++) {
      if ((labels.bits[r * stride + (g >> 3)] >> (g & 7)) & 1) elements.push(g);
    }
    return { own, elements, members: elements.map((g) => multiply(own, quaternionAt(set.elements, g))) };
  }

  // The volume that its set fills: its share, and rotations in it.
  function filledBy(id) {
    const volume = volumeOf(model.index, model.table, id);
    if (!volume) return null;
    if (!volume.dots) {
      const quaternions = SYMSOL.store.unpacked(volume.quat_wxyz);
      volume.dots = Array.from({ length: quaternions.length / 4 }, (_, i) => quaternionAt(quaternions, i));
    }
    return volume;
  }

  function pointsOf(points, id) {
    if (!points) return { predicted: [], weights: [], leftOut: 0 };
    const r = model.table.row[id] % model.index.chunk_images;
    points.bounds = points.bounds || SYMSOL.store.unpacked(points.offsets);
    points.rotation = points.rotation || SYMSOL.store.unpacked(points.quat_wxyz);
    points.weight = points.weight || SYMSOL.store.unpacked(points.weights);
    const predicted = [], weights = [];
    for (let i = points.bounds[r]; i < points.bounds[r + 1]; i++) {
      const quaternion = quaternionAt(points.rotation, i), length = Math.hypot(...quaternion);
      predicted.push(quaternion.map((v) => v / length));
      weights.push(points.weight[i] / 255);
    }
    return { predicted, weights, leftOut: points.left_out[r] };
  }

  async function show(id, run, place) {
    shown = id;
    const set = model.index.sets[model.table.set[id]], row = model.table.row[id];
    const { folder, image, segmentation } = files(id);
    const about = run && run.of.get(model.table.set[id]);
    byId("detail").hidden = false;
    delete byId("detail").dataset.shown;
    byId("detail-title").textContent = `${set.object} · ${set.split} ${row}`;
    byId("place").textContent = place;
    showPictures(set, row, id, image, segmentation);
    const [labels, points, redrawn] = await Promise.all([
      SYMSOL.store.request(`${folder}/labels`),
      about ? SYMSOL.store.request(`${folder}/run-${about.number}`) : null,
      model.table.isRedrawn[id] ? SYMSOL.store.request(`${set.folder}/redrawn`) : null,
    ]);
    if (shown !== id) return; // another one was asked for meanwhile
    scene = { ...membersOf(labels, id), ...pointsOf(points, id), volume: filledBy(id), about, marked: null };
    showFacts(set, row, id);
    showLegend();
    showScores(id, run, about);
    showDrawings(set, row, redrawn);
    describePlots();
    await drawPlots();
    byId("detail").dataset.shown = id; // all of it is there
  }

  function showPictures(set, row, id, image, segmentation) {
    byId("image").src = image;
    byId("image").alt = `${set.object}, ${set.split} image ${row}, as rendered; ${markingOf(id)}`;
    byId("segmentation").closest("figure").hidden = !set.has_segmentation;
    if (!set.has_segmentation) return;
    byId("segmentation").src = segmentation;
    const isPlain = set.parts.every((name) => name === "body" || name === "marking");
    const named = set.parts.map((name, number) => `${name} ${set.part_colours[number]}`).join(", ");
    const plain = model.table.stratum[id] === NO_MARKING ? "body dark red" : "body dark red, marking pale red";
    const colours = isPlain ? plain : named;
    byId("segmentation").alt = `Segmentation of the same image: ${colours}; ${markingOf(id)}`;
    byId("segmentation-caption").textContent = `Segmentation, ${markingOf(id)}`;
    if (isPlain) return;
    set.parts.forEach((name, number) => {
      const legend = make("span", ""), square = make("span", "\u25a0");
      square.style.color = set.part_colours[number];
      legend.className = "part";
      legend.append(square, ` ${name}`);
      byId("segmentation-caption").append(" ", legend);
    });
  }

  function showFacts(set, row, id) {
    const R = matrix(scene.own).map((line) => line.map((v) => v.toFixed(4).padStart(7)).join(" ")).join("\n");
    const facts = [
      ["Symmetry set", make("span", sizeOf(set))],
      [set.in_view ? "Parts" : "Marking", make("span", set.in_view ? markingOf(id) : plainMarkingOf(id))],
      ["In Python", make("code", `symsol_annot.load(${JSON.stringify(set.place)}, "${set.split}")[${row}]`)],
      ["R_m2c", make("pre", R)],
    ];
    byId("facts").replaceChildren(...facts.map(([term, value]) => {
      const pair = make("div"), description = make("dd");
      description.append(value);
      pair.append(make("dt", term), description);
      return pair;
    }));
  }

  // Turns of an object whose sets can fill a volume are a list of candidates, of which a share says nothing.
  function sizeOf(set) {
    const count = scene.members.length;
    if (scene.volume) return `a volume, ${shareInWords(scene.volume)}`;
    if (set.volume) return `${count} of ${set.group_order} candidates`;
    return `${count} of ${set.group_order} rotations (${((100 * count) / set.group_order).toFixed(1)}%)`;
  }

  function showLegend() {
    const entries = [["truth", "a rotation of the set"], ["own", "the one it was drawn at"]];
    if (scene.volume) entries.splice(0, 1, ["volume", `${scene.volume.dots.length} rotations drawn uniformly from the volume; colour is the tilt`]);
    if (scene.about) entries.push(["predicted", `predicted: ${scene.about.drawn}`]);
    if (scene.marked) entries.push(["marked", "drawn again, chosen below"]);
    byId("legend").replaceChildren(...entries.map(([kind, text]) => {
      const entry = make("li", text);
      entry.prepend(make("span", undefined, { class: `key ${kind}`, "aria-hidden": "true" }));
      return entry;
    }));
  }

  function describePlots() {
    const predicted = scene.predicted.length ? `, and ${scene.predicted.length} predicted ones over them` : "";
    const set = scene.volume
      ? `${scene.volume.dots.length} rotations drawn from the volume that the symmetry set fills, ${shareInWords(scene.volume)}`
      : `${scene.members.length} rotations of the symmetry set`;
    const what = `${set}${predicted}`;
    byId("ball-volume").textContent = scene.volume ? `; the set fills a volume, ${shareInWords(scene.volume)}` : "";
    byId("ball-frame").setAttribute("aria-label", `Ball of rotation vectors: ${what}`);
    byId("sphere").setAttribute("aria-label", `Map of the directions of an axis of the model: ${what}`);
  }

  function showScores(id, run, about) {
    byId("scores").hidden = !run;
    if (!run) return;
    byId("scores-title").textContent = `Scores of ${run.label}`;
    if (!about) {
      byId("scores-head").replaceChildren();
      byId("scores-body").replaceChildren();
      byId("scores-note").textContent = "It has no predictions for this set.";
      return;
    }
    const stratum = model.index.strata[model.table.stratum[id]];
    const strata = stratum === "all" ? ["all"] : ["all", stratum];
    const heads = ["", "this image", ...strata.map((name) => `${name} images`)];
    byId("scores-head").replaceChildren(...heads.map((text) => make("th", text, { scope: "col" })));
    byId("scores-body").replaceChildren(...about.metrics.map((metric) => {
      const line = make("tr"), head = make("th", metric.title, { scope: "row" });
      const arrow = { higher: " ↑", lower: " ↓" }[metric.better];
      if (arrow) {
        head.append(make("span", arrow, { "aria-hidden": "true" }), make("span", `, ${metric.better} is better`, { class: "for-readers" }));
      }
      const values = [run.metrics.get(metric.name).values[id], ...strata.map((name) => metric.means[name])];
      line.append(head, ...values.map((value) => make("td", figure(value))));
      return line;
    }));
    const notes = about.warnings.map((text) => `Warning: ${text}.`);
    if (scene.leftOut) notes.unshift(`${scene.leftOut} more predicted rotations are not drawn.`);
    if (!scene.predicted.length) notes.unshift("It predicts no rotation for this image.");
    byId("scores-note").textContent = notes.join(" ");
  }

  function showDrawings(set, row, redrawn) {
    const place = byId("drawings"), drawings = redrawn && redrawn[row];
    if (!drawings) {
      const count = set.redrawn.images.length;
      const why = set.redrawn.missing
        ? `No candidate was drawn again: ${set.redrawn.missing}`
        : `This is not among the ${count} images of ${set.object} ${set.split} whose candidates were drawn again.`;
      place.replaceChildren(make("p", why, { class: "quiet" }));
      return;
    }
    const sides = [
      ["Of the set: these look the same", drawings.filter((d) => d.is_member), scene.volume ? "No other candidate is in its volume." : "It is alone in its set."],
      ["Rejected: these do not", drawings.filter((d) => !d.is_member), "No candidate was rejected."],
    ];
    place.replaceChildren(...sides.map(([title, side, otherwise]) => {
      const group = make("div", undefined, { class: "side" });
      const list = make("ul");
      list.append(...side.map((drawing) => drawingOf(set, drawing)));
      group.append(make("h4", title), side.length ? list : make("p", otherwise, { class: "quiet" }));
      return group;
    }));
  }

  function drawingOf(set, drawing) {
    const from = drawing.is_member ? "from this image" : "from the set";
    const differ = drawing.differing_px === 1 ? "1 px differs" : `${drawing.differing_px} px differ`;
    const words = `${drawing.angle_deg}° ${from}`;
    const item = make("li"), button = make("button", undefined, { type: "button", "aria-pressed": "false" });
    const picture = make("img", undefined, { src: `${set.folder}/${drawing.file}`, alt: `Candidate ${drawing.element}: ${words}, ${differ}; show it in the plots` });
    button.append(picture, make("span", words), make("span", differ));
    button.addEventListener("click", () => {
      const isOn = button.getAttribute("aria-pressed") === "true";
      byId("drawings").querySelectorAll("button").forEach((other) => other.setAttribute("aria-pressed", "false"));
      button.setAttribute("aria-pressed", String(!isOn));
      scene.marked = isOn ? null : multiply(scene.own, quaternionAt(set.elements, drawing.element));
      showLegend();
      drawPlots();
    });
    item.append(button);
    return item;
  }

  function drawPlots() {
    if (!scene) return Promise.resolve();
    SYMSOL.sphere.draw(byId("sphere"), scene);
    return SYMSOL.ball.draw(scene);
  }

  function connect(theModel) {
    model = theModel;
    SYMSOL.ball.connect(byId("ball"), byId("turn"));
    SYMSOL.sphere.wheel(byId("wheel"));
    SYMSOL.theme.onChange(drawPlots);
  }

  return { connect, show, files, markingOf, figure, hide: () => { shown = -1; byId("detail").hidden = true; } };
})();
