// Updates the live status without reloading the page. Texts are set as text, never as HTML.
"use strict";
(() => {
  const EVERY_MS = 2000;
  const RETRY_MS = 10000;
  const ANNOUNCE_EVERY_MS = 30000;
  let timer = 0;
  let announcedAt = 0;
  let polling = false;
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
    run.messages.forEach((text, i) => {
      const line = named(article.querySelectorAll("[data-message]"), "message", String(i));
      if (line && line.textContent !== text) line.textContent = text;
    });
  }

  async function redraw() {
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

  function announce(runs, now) {
    if (!now && Date.now() - announcedAt < ANNOUNCE_EVERY_MS) return;
    announcedAt = Date.now();
    const words = runs.map((run) => `${run.name}: ${run.state_text}, ${number.format(run.done)} of ${number.format(run.planned)} ${run.planned === 1 ? "episode" : "episodes"}, success ${run.rate}`);
    document.getElementById("announced").textContent = words.join("; ") || "No suite is running.";
  }

  function note(text) {
    const place = document.getElementById("note");
    place.hidden = !text;
    place.textContent = text;
  }

  async function poll() {
    if (polling || document.visibilityState !== "visible" || !root().dataset.poll) return;
    polling = true;
    let wait = EVERY_MS;
    try {
      const answer = await fetch(root().dataset.poll, { headers: { accept: "application/json" } });
      if (!answer.ok) throw new Error(String(answer.status));
      const status = await answer.json();
      const changed = status.shape !== root().dataset.shape;
      if (changed) await redraw(); else status.runs.forEach(show);
      announce(status.runs, changed);
      note("");
    } catch (error) {
      wait = RETRY_MS;
      note(error.message === "401" ? "The token has changed. Reload the page to log in." : "The server does not answer; the numbers are outdated.");
    } finally {
      polling = false;
      clearTimeout(timer);
      timer = setTimeout(poll, wait);
    }
  }

  document.addEventListener("visibilitychange", () => {
    clearTimeout(timer);
    if (document.visibilityState === "visible") poll();
  });
  if (root()) timer = setTimeout(poll, EVERY_MS);
})();
