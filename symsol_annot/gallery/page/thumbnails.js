// The window of thumbnails: of thousands of images only the rows in view are in the document.
"use strict";

SYMSOL.thumbnails = (() => {
  const LEAST_WIDTH = 104, CAPTION = 34, GAP = 8, MARGIN = 12, SPARE_ROWS = 2;

  // box: the listbox; strip: its inside. describe(id): { image, alt, title, note, score }. onChoose(id, isOpened).
  function create(box, strip, describe, onChoose) {
    let ids = [], at = 0, columns = 1, width = LEAST_WIDTH, scheduled = false;
    const cells = new Map(); // position to element

    const rowHeight = () => width + CAPTION + GAP;

    function measure() {
      const inside = box.clientWidth - 2 * MARGIN;
      columns = Math.max(1, Math.floor((inside + GAP) / (LEAST_WIDTH + GAP)));
      width = Math.floor((inside + GAP) / columns) - GAP;
      strip.style.height = `${Math.ceil(ids.length / columns) * rowHeight() + 2 * MARGIN}px`;
    }

    function draw() {
      scheduled = false;
      const first = Math.max(0, Math.floor((box.scrollTop - MARGIN) / rowHeight()) - SPARE_ROWS) * columns;
      const rows = Math.ceil(box.clientHeight / rowHeight()) + 2 * SPARE_ROWS + 1;
      const last = Math.min(ids.length, first + rows * columns);
      for (const [position, cell] of cells) {
        if (position !== at && (position < first || position >= last)) { cell.remove(); cells.delete(position); }
      }
      for (let position = first; position < last; position++) place(position);
      if (ids.length) place(at); // the active one stays, for who reads with ears
    }

    function place(position) {
      if (!cells.has(position)) {
        const cell = element(position);
        cells.set(position, cell);
        strip.append(cell);
      }
      const cell = cells.get(position);
      const row = Math.floor(position / columns), column = position % columns;
      cell.style.width = `${width}px`;
      cell.style.transform = `translate(${MARGIN + column * (width + GAP)}px, ${MARGIN + row * rowHeight()}px)`;
      cell.setAttribute("aria-selected", String(position === at));
    }

    function element(position) {
      const about = describe(ids[position]);
      const cell = document.createElement("div");
      cell.id = `option-${position}`;
      cell.className = "cell";
      cell.setAttribute("role", "option");
      cell.setAttribute("aria-label", about.alt);
      cell.setAttribute("aria-setsize", ids.length);
      cell.setAttribute("aria-posinset", position + 1);
      cell.dataset.position = position;
      const picture = document.createElement("img");
      picture.src = about.image;
      picture.alt = "";
      picture.decoding = "async";
      const title = document.createElement("span");
      title.className = "cell-title";
      title.textContent = about.title;
      const note = document.createElement("span");
      note.className = "cell-note";
      note.textContent = about.note;
      if (about.score) {
        const score = document.createElement("span");
        score.className = "cell-score";
        score.textContent = about.score;
        title.append(score);
      }
      cell.append(picture, title, note);
      return cell;
    }

    function clear() {
      cells.forEach((cell) => cell.remove());
      cells.clear();
    }

    function schedule() {
      if (!scheduled) { scheduled = true; requestAnimationFrame(draw); }
    }

    function choose(position, isOpened = false) {
      if (!ids.length) return;
      at = Math.max(0, Math.min(ids.length - 1, position));
      const top = MARGIN + Math.floor(at / columns) * rowHeight();
      if (top - MARGIN < box.scrollTop) box.scrollTop = top - MARGIN;
      else if (top + rowHeight() > box.scrollTop + box.clientHeight) box.scrollTop = top + rowHeight() - box.clientHeight;
      draw();
      box.setAttribute("aria-activedescendant", `option-${at}`);
      onChoose(ids[at], isOpened);
    }

    function show(newIds, active) {
      ids = newIds;
      at = Math.max(0, ids.indexOf(active));
      clear();
      box.removeAttribute("aria-activedescendant");
      measure();
      box.scrollTop = 0;
      if (ids.length) choose(at);
    }

    const page = () => Math.max(1, Math.floor(box.clientHeight / rowHeight())) * columns;
    const moves = {
      ArrowLeft: () => at - 1,
      ArrowRight: () => at + 1,
      ArrowUp: () => (at >= columns ? at - columns : at),
      ArrowDown: () => (at + columns < ids.length ? at + columns : at),
      PageUp: () => at - page(),
      PageDown: () => at + page(),
      Home: () => 0,
      End: () => ids.length - 1,
    };

    box.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (moves[event.key]) choose(moves[event.key]());
      else if (event.key === "Enter" || event.key === " ") choose(at, true);
      else return;
      event.preventDefault();
    });
    box.addEventListener("click", (event) => {
      const cell = event.target.closest(".cell");
      if (cell) choose(Number(cell.dataset.position), true);
    });
    box.addEventListener("scroll", schedule, { passive: true });
    new ResizeObserver(() => { measure(); schedule(); }).observe(box);

    return {
      show,
      step: (by) => choose(at + by),
      get position() { return at; },
      get count() { return ids.length; },
    };
  }

  return { create };
})();
