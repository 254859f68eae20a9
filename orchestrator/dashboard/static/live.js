// Keeps what runs up to date without loading the page anew. Texts are set as text, never as HTML.
"use strict";
(() => {
  const EVERY_MS = 2000;
  const LATER_MS = 10000;
  const SAY_EVERY_MS = 30000;
  let timer = 0;
  let saidAt = 0;
  let asking = false;
  const root = () => document.getElementById("live");
  const number = new Intl.NumberFormat("en-US");

  function set(part, values) {
    for (const field of part.querySelectorAll("[data-field]")) {
      if (field.closest("[data-simulator],[data-worker],[data-run]") !== part) continue;
      const value = values[field.dataset.field];
      if (value === undefined) continue;
      const text = typeof value === "number" ? number.format(value) : value;
      if (field.textContent !== text) field.textContent = text;
      if (field.dataset.field === "errors") field.classList.toggle("bad", value > 0);
    }
  }

  function fill(bar, one) {
    let at = 0;
    [...bar.querySelectorAll("rect")].forEach((rect, i) => {
      rect.setAttribute("x", `${at}%`);
      rect.setAttribute("width", `${one.shares[i]}%`);
      at += one.shares[i];
    });
    bar.setAttribute("aria-valuemax", Math.max(one.planned, 1));
    bar.setAttribute("aria-valuenow", one.done);
    bar.setAttribute("aria-valuetext", one.progress);
  }

  function named(parts, name, value) {
    return [...parts].find((part) => part.dataset[name] === value);
  }

  function show(run) {
    const article = named(root().querySelectorAll("[data-run]"), "run", run.id);
    if (!article) return;
    set(article, run);
    for (const one of run.simulators) {
      const line = named(article.querySelectorAll("[data-simulator]"), "simulator", one.simulator);
      if (line) { set(line, one); fill(line.querySelector("[role=progressbar]"), one); }
    }
    for (const one of run.workers) {
      const row = named(article.querySelectorAll("[data-worker]"), "worker", one.worker);
      if (row) set(row, one);
    }
    run.says.forEach((text, i) => {
      const line = named(article.querySelectorAll("[data-say]"), "say", String(i));
      if (line && line.textContent !== text) line.textContent = text;
    });
  }

  async function drawAnew() {
    const answer = await fetch(location.href, { headers: { accept: "text/html" } });
    if (!answer.ok) throw new Error(String(answer.status));
    const page = new DOMParser().parseFromString(await answer.text(), "text/html");
    const fresh = page.getElementById("live");
    if (!fresh) throw new Error("no page");
    const focused = document.activeElement?.getAttribute?.("href");
    root().replaceWith(document.adoptNode(fresh));
    const again = focused && [...root().querySelectorAll("a[href]")].find((a) => a.getAttribute("href") === focused);
    if (again && document.activeElement === document.body) again.focus();
  }

  function say(runs, now) {
    if (!now && Date.now() - saidAt < SAY_EVERY_MS) return;
    saidAt = Date.now();
    const words = runs.map((run) => `${run.name}: ${run.said}, ${number.format(run.done)} of ${number.format(run.planned)} episodes, success ${run.rate}`);
    document.getElementById("announced").textContent = words.join("; ") || "No suite is running.";
  }

  function note(text) {
    const place = document.getElementById("note");
    place.hidden = !text;
    place.textContent = text;
  }

  async function ask() {
    if (asking || document.visibilityState !== "visible" || !root().dataset.poll) return;
    asking = true;
    let wait = EVERY_MS;
    try {
      const answer = await fetch(root().dataset.poll, { headers: { accept: "application/json" } });
      if (!answer.ok) throw new Error(String(answer.status));
      const found = await answer.json();
      const changed = found.shape !== root().dataset.shape;
      if (changed) await drawAnew(); else found.runs.forEach(show);
      say(found.runs, changed);
      note("");
    } catch (error) {
      wait = LATER_MS;
      note(error.message === "401" ? "Your session has ended. Load the page again to log in." : "The server does not answer; these numbers are old.");
    } finally {
      asking = false;
      clearTimeout(timer);
      timer = setTimeout(ask, wait);
    }
  }

  document.addEventListener("visibilitychange", () => {
    clearTimeout(timer);
    if (document.visibilityState === "visible") ask();
  });
  if (root()) timer = setTimeout(ask, EVERY_MS);
})();
