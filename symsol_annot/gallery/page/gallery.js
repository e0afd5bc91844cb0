// The page: controls, keys, the address, and what they show.
"use strict";

(async () => {
  const byId = (id) => document.getElementById(id);
  const FIELDS = ["find", "object", "split", "marking", "least", "most", "run", "order"];
  const { select, columns, runs: gatherRuns, WORDS, volumeOf, shareInWords, sizeInShort } = SYMSOL.selection;
  const whole = new Intl.NumberFormat("en");

  SYMSOL.theme.connect(byId("theme"));
  let index;
  try {
    index = await SYMSOL.store.request("index", "data/index.js");
  } catch (error) {
    byId("count").textContent = `The gallery cannot be shown: ${error.message}.`;
    return;
  }
  const table = columns(index), runs = gatherRuns(index, table);
  const model = { index, table, runs };
  let current = -1, pending = 0;

  const run = () => runs.get(byId("run").value);

  // Controls

  function options(id, pairs) {
    byId(id).replaceChildren(...pairs.map(([value, text]) => new Option(text, value)));
  }

  function distinct(values) {
    return [...new Set(values)];
  }

  function fillControls() {
    const objects = distinct(index.sets.map((set) => set.object)), splits = distinct(index.sets.map((set) => set.split));
    byId("title").textContent = `${objects.join(", ")}`;
    document.title = `${objects.join(", ")} · symsol-annot gallery`;
    options("object", [["", "all"], ...objects.map((name) => [name, name])]);
    options("split", [["", "all"], ...splits.map((name) => [name, name])]);
    const parts = distinct(index.sets.flatMap((set) => set.breaking.map((part) => set.parts[part])));
    if (parts.length) byId("marking-name").textContent = "Marking or part";
    options("marking", [
      ["", "any"], ["shown", "shown"], ["barely", "barely shown"], ["hidden", "hidden"], ["none", "no marking"],
      ...parts.flatMap((name) => [[`seen:${name}`, `${name} in view`], [`unseen:${name}`, `${name} out of sight`]]),
    ]);
    options("run", [["", "none"], ...[...runs.values()].map((one) => [one.key, one.label])]);
    byId("run-field").hidden = runs.size === 0;
    byId("run").value = runs.size ? [...runs.keys()][0] : "";
    fillOrders();
    byId("order").value = leadingOrder();
  }

  function ranking() {
    return run() ? [...run().metrics.values()].filter((metric) => metric.better) : [];
  }

  function leadingOrder() {
    return ranking().length ? `worst:${ranking()[0].name}` : "files";
  }

  function fillOrders() {
    options("order", [
      ["files", "as in the files"],
      ["largest", "largest set first"],
      ["smallest", "smallest set first"],
      ["least-marking", "least marking first"],
      ...ranking().map((metric) => [`worst:${metric.name}`, `worst first: ${metric.title}`]),
      ...ranking().slice(0, 1).map((metric) => [`best:${metric.name}`, `best first: ${metric.title}`]),
    ]);
  }

  function query() {
    const found = Object.fromEntries(FIELDS.map((id) => [id, byId(id).value]));
    return { ...found, redrawn: byId("redrawn").checked };
  }

  // The address

  function toAddress() {
    const parts = new URLSearchParams();
    for (const [key, value] of Object.entries(query())) if (value) parts.set(key, value === true ? "1" : value);
    if (current >= 0) parts.set("image", `${table.set[current]}/${table.row[current]}`);
    try { window.history.replaceState(null, "", `#${parts}`); } catch { /* not allowed here: then not */ }
  }

  function fromAddress() {
    const parts = new URLSearchParams(window.location.hash.slice(1));
    if (parts.has("run")) { byId("run").value = parts.get("run"); fillOrders(); byId("order").value = leadingOrder(); }
    for (const id of FIELDS) {
      if (!parts.has(id)) continue;
      byId(id).value = parts.get(id);
      if (byId(id).value === "" && byId(id).tagName === "SELECT") byId(id).selectedIndex = 0;
    }
    byId("redrawn").checked = parts.has("redrawn");
    const [set, row] = (parts.get("image") || "").split("/").map(Number);
    const isThere = set < index.sets.length && row < index.sets[set].images;
    current = isThere ? table.starts[set] + row : -1;
  }

  // What is shown

  function describe(id) {
    const set = index.sets[table.set[id]], row = table.row[id];
    const score = scoreOf(id);
    const name = `${set.object}, ${set.split} image ${row}`;
    const count = sizeInShort(index, table, id), volume = volumeOf(index, table, id);
    const size = `set of ${volume ? shareInWords(volume) : count}`;
    return {
      image: SYMSOL.detail.files(id).image,
      alt: `${name}, ${SYMSOL.detail.markingOf(id)}, ${size}${score ? `, ${score.title} ${score.text}` : ""}`,
      title: `${index.sets.length > 1 ? `${set.object} ` : ""}${row}`,
      note: table.stratum[id] ? `${count} · ${WORDS[table.stratum[id]]}` : count,
      score: score && score.text,
    };
  }

  // The figure that the order goes by, or the leading one.
  function scoreOf(id) {
    const name = byId("order").value.split(":")[1];
    const metric = run() && (run().metrics.get(name) || ranking()[0]);
    if (!metric || Number.isNaN(metric.values[id])) return null;
    return { title: metric.title, text: SYMSOL.detail.figure(metric.values[id]) };
  }

  function apply(keeps = true) {
    const found = select(index, table, query(), run());
    const of = found.length === table.total ? "" : ` of ${whole.format(table.total)}`;
    byId("count").textContent = `${whole.format(found.length)}${of} image${table.total === 1 ? "" : "s"}`;
    byId("nothing").hidden = found.length > 0;
    SYMSOL.summary.show(model, found);
    if (!found.length) { current = -1; SYMSOL.detail.hide(); }
    thumbnails.show(found, keeps ? current : -1);
    toAddress();
  }

  function onChoose(id, isOpened) {
    current = id;
    clearTimeout(pending);
    pending = setTimeout(() => {
      toAddress();
      const place = `${whole.format(thumbnails.position + 1)} / ${whole.format(thumbnails.count)}`;
      SYMSOL.detail.show(id, run(), place).catch((error) => { byId("count").textContent = `${error.message}.`; });
    }, isOpened ? 0 : 80); // so that a held key does not draw what nobody sees
    if (isOpened) open();
  }

  function open() {
    document.body.classList.add("opened");
    byId("detail").hidden = false;
    byId("detail-title").focus({ preventScroll: true });
  }

  function close() {
    document.body.classList.remove("opened");
    byId("window").focus({ preventScroll: true });
  }

  function toggleFilters(event) {
    const isOpen = document.body.classList.toggle("filtering");
    event.currentTarget.setAttribute("aria-expanded", isOpen);
  }

  function showKeys() {
    byId("keys").showModal();
  }

  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("keys").open) return;
    const isTyping = event.target.matches("input, select, textarea");
    const inDetail = byId("detail").contains(event.target) && !event.target.closest("#ball");
    if (event.key === "Escape") close();
    else if (isTyping) return;
    else if (event.key === "/") byId("find").focus();
    else if (event.key === "?") showKeys();
    else if (event.key === "t" || event.key === "T") SYMSOL.ball.toggle();
    else if (inDetail && event.key === "ArrowLeft") thumbnails.step(-1);
    else if (inDetail && event.key === "ArrowRight") thumbnails.step(1);
    else return;
    event.preventDefault();
  }

  SYMSOL.detail.connect(model);
  const thumbnails = SYMSOL.thumbnails.create(byId("window"), byId("strip"), describe, onChoose);
  fillControls();
  fromAddress();
  byId("filters").addEventListener("input", (event) => {
    if (event.target.id === "run") { fillOrders(); byId("order").value = leadingOrder(); }
    apply(!["run", "order"].includes(event.target.id)); // another order is looked at from its beginning
  });
  byId("filters").addEventListener("submit", (event) => { event.preventDefault(); byId("window").focus(); });
  byId("filters").addEventListener("reset", (event) => {
    event.preventDefault();
    for (const id of ["find", "object", "split", "marking", "least", "most"]) byId(id).value = "";
    byId("redrawn").checked = false;
    byId("order").value = leadingOrder();
    apply();
  });
  byId("before").addEventListener("click", () => thumbnails.step(-1));
  byId("after").addEventListener("click", () => thumbnails.step(1));
  byId("close").addEventListener("click", close);
  byId("skip").addEventListener("click", (event) => { event.preventDefault(); byId("window").focus(); }); // no address
  byId("keys-open").addEventListener("click", showKeys);
  byId("filters-open").addEventListener("click", toggleFilters);
  document.addEventListener("keydown", onKey);
  window.addEventListener("hashchange", () => { fromAddress(); apply(); });
  apply();
  document.body.dataset.ready = "yes";
})();
