/* Sorts the report's tables by the heads of their columns and filters long ones. Without scripts they stay as written. */
"use strict";
(() => {
  const LEAST_SORTED = 3; /* rows */
  const LEAST_FILTERED = 9; /* rows */
  const SECONDS = { ms: 0.001, s: 1, min: 60, h: 3600, d: 86400 };
  const [NUMBER, TEXT, BLANK] = [0, 1, 2]; /* kinds of cells in this order, whichever way a column is sorted */

  /** The number that a cell begins with: `82 % [74, 89]`, `<0.001`, `[74, 89]`, `1,200`; a time in seconds. */
  function numberIn(text) {
    const times = [...text.matchAll(/(\d[\d.,]*) (ms|s|min|h|d)\b/g)];
    const plain = (digits) => Number(digits.replaceAll(",", ""));
    if (times.length) return times.reduce((sum, [, digits, unit]) => sum + plain(digits) * SECONDS[unit], 0);
    const found = /^([<>]?)[[+]*(-?\d[\d,]*(?:\.\d+)?)/.exec(text);
    return found && plain(found[2]) + { "<": -1e-9, ">": 1e-9, "": 0 }[found[1]];
  }

  function keyOf(cell, isNumeric) {
    const text = cell.textContent.trim();
    const number = isNumeric ? numberIn(text) : null;
    return { kind: number !== null ? NUMBER : text && text !== "–" ? TEXT : BLANK, number, text };
  }

  function compare(one, other, direction) {
    if (one.kind !== other.kind) return one.kind - other.kind;
    if (one.kind === NUMBER) return direction * (one.number - other.number);
    return direction * one.text.localeCompare(other.text, "en", { numeric: true });
  }

  /** Adds a button to each head: the first press sorts upwards, the second downwards, the third as written. */
  function makeSortable(table, written) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const isNumeric = head.classList.contains("number") || (table.classList.contains("matrix") && column > 0);
      const keys = new Map(written.map((row) => [row, keyOf(row.cells[column], isNumeric)]));
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      button.addEventListener("click", () => {
        const next = { ascending: "descending", descending: null }[head.ariaSort];
        for (const other of heads) other.removeAttribute("aria-sort");
        if (next !== null) head.ariaSort = next ?? "ascending";
        const direction = { ascending: 1, descending: -1 }[head.ariaSort];
        const sorted = direction ? written.toSorted((a, b) => compare(keys.get(a), keys.get(b), direction)) : written;
        table.tBodies[0].append(...sorted);
      });
      head.append(button);
    });
    table.classList.add("sortable");
  }

  /** Adds a field above the table: rows with all of its words, in any case, are shown. */
  function makeFilterable(table, rows) {
    const place = table.closest(".scroll");
    const field = document.createElement("input");
    field.type = "search";
    field.placeholder = "Filter rows";
    field.ariaLabel = `Filter rows: ${place.ariaLabel}`;
    const count = document.createElement("output");
    const texts = rows.map((row) => row.textContent.toLowerCase());
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/);
      rows.forEach((row, number) => (row.hidden = !words.every((word) => texts[number].includes(word))));
      count.textContent = field.value.trim() && `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
    });
    const line = document.createElement("p");
    line.className = "filter";
    line.append(field, count);
    place.before(line);
  }

  for (const table of document.querySelectorAll(".scroll > table:not(.heat)")) {
    const rows = [...table.tBodies[0].rows];
    if (rows.length >= LEAST_SORTED) makeSortable(table, rows);
    if (rows.length >= LEAST_FILTERED) makeFilterable(table, rows);
  }
})();
