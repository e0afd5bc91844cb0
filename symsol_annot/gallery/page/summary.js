// What the images shown have in common: sizes of their sets, mean scores of each run, and each run beside the first.
"use strict";

SYMSOL.summary = (() => {
  const FEW = 6; // sizes, and ranges of sizes, that are listed
  const LEADING = 6; // figures of a track
  const byId = (id) => document.getElementById(id);
  const whole = new Intl.NumberFormat("en");

  function make(name, text, attributes = {}) {
    const made = document.createElement(name);
    if (text !== undefined) made.textContent = text;
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  }

  // Ranges of sizes with how many images have them: each size by itself where there are few, else evenly wide ranges.
  function sizes(values) {
    const counts = new Map();
    for (const value of values) counts.set(value, (counts.get(value) || 0) + 1);
    const found = [...counts.keys()].sort((a, b) => a - b);
    if (found.length <= FEW) return found.map((size) => ({ from: size, to: size, images: counts.get(size) }));
    const least = found.find((size) => size > 1), most = found[found.length - 1];
    const width = Math.ceil((most - least + 1) / (FEW - 1));
    const ranges = new Map();
    for (const size of found) {
      const number = size === 1 ? -1 : Math.floor((size - least) / width);
      const range = ranges.get(number) || { from: size, to: size, images: 0 };
      ranges.set(number, { from: range.from, to: size, images: range.images + counts.get(size) });
    }
    return [...ranges.values()];
  }

  // The mean of a figure over images, where it is defined.
  function mean(values, ids) {
    let sum = 0, count = 0;
    for (const id of ids) if (!Number.isNaN(values[id])) { sum += values[id]; count += 1; }
    return count ? sum / count : NaN;
  }

  // On how many images the second run has a better figure than the first, a worse one, and the same.
  function against(first, second, ids) {
    const sign = first.better === "higher" ? 1 : -1;
    const found = { better: 0, worse: 0, same: 0 };
    for (const id of ids) {
      const a = sign * first.values[id], b = sign * second.values[id];
      if (Number.isNaN(a) || Number.isNaN(b)) continue;
      found[b > a ? "better" : b < a ? "worse" : "same"] += 1;
    }
    return found;
  }

  const ranking = (run) => [...run.metrics.values()].filter((metric) => metric.better).slice(0, LEADING);

  function table(head, rows) {
    const made = make("table"), line = made.createTHead().insertRow(), body = made.createTBody();
    for (const text of head) line.append(make("th", text, { scope: "col" }));
    for (const [name, ...cells] of rows) {
      const row = body.insertRow();
      row.append(make("th", name, { scope: "row" }), ...cells.map((text) => make("td", text)));
    }
    const frame = make("div", undefined, { class: "scroll" });
    frame.append(made);
    return frame;
  }

  const span = ({ from, to }) => (from === to ? whole.format(from) : `${whole.format(from)} to ${whole.format(to)}`);

  // How many images have sets that fill a volume, by its share of all rotations.
  function volumes(model, ids) {
    const found = new Map();
    for (const id of ids) {
      const volume = SYMSOL.selection.volumeOf(model.index, model.table, id);
      const words = volume && SYMSOL.selection.shareInWords(volume);
      if (volume) found.set(words, (found.get(words) || 0) + 1);
    }
    return [...found];
  }

  function sizesTable(ranges, filled) {
    const rows = [...ranges.map((range) => [span(range), range.images]), ...filled];
    return table(["rotations per set", "images"], rows.map(([words, images]) => [words, whole.format(images)]));
  }

  function line(ranges, filled) {
    const images = filled.reduce((sum, [, count]) => sum + count, 0);
    const said = [];
    if (ranges.length) {
      const most = ranges[ranges.length - 1].to;
      said.push(`symmetry sets of ${span({ from: ranges[0].from, to: most })} rotation${most === 1 ? "" : "s"}`);
    }
    if (images) said.push(`${whole.format(images)} ${images === 1 ? "image has a set that fills" : "images have sets that fill"} a volume`);
    return said.length ? `Summary: ${said.join("; ")}` : "Summary";
  }

  function scoresTable(runs, ids) {
    const metrics = new Map(runs.flatMap((run) => ranking(run).map((metric) => [metric.name, metric.title])));
    const cell = (run, name) => {
      const metric = run.metrics.get(name);
      return metric ? SYMSOL.detail.figure(mean(metric.values, ids)) : "–";
    };
    const rows = [...metrics].map(([name, title]) => [title, ...runs.map((run) => cell(run, name))]);
    return table(["mean over these images", ...runs.map((run) => run.label)], rows);
  }

  function comparison(runs, ids) {
    const [first, ...others] = runs;
    const [metric] = ranking(first);
    const rows = others.filter((run) => metric && run.metrics.has(metric.name)).map((run) => {
      const { better, worse, same } = against(metric, run.metrics.get(metric.name), ids);
      return [run.label, whole.format(better), whole.format(worse), whole.format(same)];
    });
    return rows.length ? table([`against ${first.label}, by ${metric.title}`, "better", "worse", "the same"], rows) : null;
  }

  function show(model, ids) {
    const runs = [...model.runs.values()], filled = volumes(model, ids);
    const single = ids.filter((id) => !SYMSOL.selection.volumeOf(model.index, model.table, id));
    const ranges = single.length ? sizes(single.map((id) => model.table.size[id])) : [];
    byId("summary-parts").replaceChildren(
      ...[ids.length && sizesTable(ranges, filled), ids.length && runs.length && scoresTable(runs, ids),
        ids.length && runs.length > 1 && comparison(runs, ids)].filter(Boolean),
    );
    byId("summary-line").textContent = line(ranges, filled);
  }

  return { show, sizes, mean, against };
})();
