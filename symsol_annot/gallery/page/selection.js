// Which images are shown, and in which order: columns over all images of all sets, and queries over them.
"use strict";

SYMSOL.selection = (() => {
  const NO_MARKING = 0, HIDDEN = 1, SHOWN = 2, BARELY = 3;
  const MARKINGS = {
    "": () => true,
    shown: (stratum) => stratum === SHOWN || stratum === BARELY,
    barely: (stratum) => stratum === BARELY,
    hidden: (stratum) => stratum === HIDDEN,
    none: (stratum) => stratum === NO_MARKING,
  };
  const WORDS = ["no marking", "hidden", "shown", "barely shown"];

  // The names of the parts that one image of a set shows.
  function partsInView(set, row) {
    set.views = set.views || SYMSOL.store.unpacked(set.in_view);
    return set.parts.filter((name, part) => set.views[row * set.parts.length + part]);
  }

  // The volume that an image's set fills; undefined for a set of single rotations.
  const volumeOf = (index, table, id) => index.sets[table.set[id]].volumes[table.volume[id]];

  const percent = ({ share }) => `${share < 5e-4 ? "under 0.1" : (100 * share).toFixed(1)}%`;
  const shareInWords = (volume) => `${percent(volume)} of all rotations`;

  // How large an image's set is, in short: how many rotations it has, or which share of all.
  function sizeInShort(index, table, id) {
    const volume = volumeOf(index, table, id);
    return volume ? percent(volume) : `${table.size[id]}`;
  }

  // The columns: for each image its set, its row there, and what it is filtered and sorted by.
  function columns(index) {
    const { unpacked } = SYMSOL.store;
    const total = index.sets.reduce((sum, set) => sum + set.images, 0);
    const table = {
      total,
      set: new Uint16Array(total),
      row: new Uint32Array(total),
      stratum: new Uint8Array(total),
      size: new Uint32Array(total),
      volume: new Int16Array(total).fill(-1), // its number in the set's list, -1 for none
      pixels: new Float32Array(total),
      isRedrawn: new Uint8Array(total),
      starts: [],
    };
    let start = 0;
    index.sets.forEach((set, number) => {
      table.starts.push(start);
      table.set.fill(number, start, start + set.images);
      for (let row = 0; row < set.images; row++) table.row[start + row] = row;
      table.stratum.set(unpacked(set.stratum), start);
      table.size.set(unpacked(set.set_size), start);
      if (set.volume) table.volume.set(unpacked(set.volume), start);
      table.pixels.set(unpacked(set.marking_px), start);
      for (const row of set.redrawn.images) table.isRedrawn[start + row] = 1;
      start += set.images;
    });
    return table;
  }

  // Runs of one method and track, over all sets: a column a metric, NaN where an image has no figure.
  function runs(index, table) {
    const found = new Map();
    index.runs.forEach((run, number) => {
      const key = JSON.stringify([run.method, run.track]);
      if (!found.has(key)) found.set(key, { key, label: `${run.method} · ${run.track}`, of: new Map(), metrics: new Map() });
      const one = found.get(key);
      one.of.set(run.set, { ...run, number });
      for (const metric of run.metrics) {
        if (!one.metrics.has(metric.name)) {
          one.metrics.set(metric.name, { ...metric, values: new Float32Array(table.total).fill(NaN) });
        }
        one.metrics.get(metric.name).values.set(SYMSOL.store.unpacked(metric.values), table.starts[run.set]);
      }
    });
    return found;
  }

  function matches(word, index, table, id) {
    if (/^\d+$/.test(word)) return table.row[id] === Number(word);
    const set = index.sets[table.set[id]];
    const parts = set.in_view ? partsInView(set, table.row[id]).join(" ") : "";
    return `${set.object} ${set.split} ${WORDS[table.stratum[id]]} ${parts}`.toLowerCase().includes(word);
  }

  // Whether an image is of those that show, hide or have something: a word of MARKINGS, or "seen:part" and "unseen:part".
  function shows(index, table, id, wanted) {
    const [how, part] = wanted.split(":");
    if (part === undefined) return MARKINGS[wanted](table.stratum[id]);
    const set = index.sets[table.set[id]];
    return set.parts.includes(part) && partsInView(set, table.row[id]).includes(part) === (how === "seen");
  }

  // The images of a query, in its order: an array of their numbers.
  function select(index, table, query, run) {
    const words = query.find.toLowerCase().split(/\s+/).filter(Boolean);
    const least = query.least === "" ? 0 : Number(query.least);
    const most = query.most === "" ? Infinity : Number(query.most);
    const found = [];
    for (let id = 0; id < table.total; id++) {
      const set = index.sets[table.set[id]];
      if (query.object && set.object !== query.object) continue;
      if (query.split && set.split !== query.split) continue;
      if (!shows(index, table, id, query.marking)) continue;
      if (table.size[id] < least || table.size[id] > most) continue;
      if (query.redrawn && !table.isRedrawn[id]) continue;
      if (!words.every((word) => matches(word, index, table, id))) continue;
      found.push(id);
    }
    const key = sortKey(query.order, table, run);
    if (!key) return found;
    const rank = (id) => (Number.isNaN(key(id)) ? Infinity : key(id));
    return found.sort((a, b) => {
      const x = rank(a), y = rank(b);
      return x === y ? a - b : x - y;
    });
  }

  // What goes up along an order; null for the order of the files.
  function sortKey(order, table, run) {
    if (order === "largest") return (id) => -table.size[id];
    if (order === "smallest") return (id) => table.size[id];
    if (order === "least-marking") return (id) => (table.stratum[id] >= SHOWN ? table.pixels[id] : NaN);
    const [end, name] = order.split(":");
    const metric = run && run.metrics.get(name);
    if (!metric) return null;
    const sign = (metric.better === "higher") === (end === "worst") ? 1 : -1;
    return (id) => sign * metric.values[id];
  }

  return { volumeOf, shareInWords, sizeInShort, columns, runs, select, partsInView, WORDS, NO_MARKING, SHOWN, BARELY };
})();
