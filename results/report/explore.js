// Draws the plots of explore.html, and the tables of their values, again whenever a control, the colour scheme or the width of the window changes.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const config = { displaylogo: false, responsive: true };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const isNarrow = () => window.innerWidth < 640;
  const COLUMN = 17; // least width of a task in the map (px): a label in one line beside the next
  const LETTER = 6.8; // width of a letter of such a label (px)
  const escaped = (text) => text.replace(/[&<>]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[sign]);

  const axisStyle = () => ({ gridcolor: colour("--grid"), linecolor: colour("--rule"), zerolinecolor: colour("--rule"), automargin: true });
  const layout = (more) => ({
    paper_bgcolor: colour("--paper"),
    plot_bgcolor: colour("--paper"),
    font: { color: colour("--ink"), family: "system-ui, sans-serif", size: isNarrow() ? 11 : 13 },
    hoverlabel: { bgcolor: colour("--paper"), bordercolor: colour("--soft"), font: { color: colour("--ink") } },
    modebar: { bgcolor: "rgba(0, 0, 0, 0)", color: colour("--soft"), activecolor: colour("--ink") },
    margin: { l: 50, r: 10, t: 30, b: 50 },
    ...more,
  });

  function chosenLines() {
    const chosen = new FormData(document.getElementById("lines-shown"));
    return data.lines.filter(
      ({ meta }) =>
        meta.axis === chosen.get("axis") &&
        chosen.getAll("policy").includes(meta.policy) &&
        chosen.getAll("simulator").includes(meta.simulator),
    );
  }

  function drawLines() {
    const lines = chosenLines();
    const axis = data.axes[document.querySelector("#lines-shown [name=axis]").value];
    const coloured = lines.map((line) => {
      const own = colour(`--s${line.meta.series}`);
      return { ...line, line: { ...line.line, color: own }, marker: { ...line.marker, color: own } };
    });
    const ticks = { tickmode: "array", tickvals: axis.severities, ticktext: axis.levels };
    Plotly.react("lines", coloured, layout({
      height: (isNarrow() ? 380 : 480) + 22 * Math.ceil(lines.length / (isNarrow() ? 1 : 3)),
      showlegend: true,
      legend: { orientation: "h", x: 0, y: -0.2, yanchor: "top" },
      xaxis: { ...axisStyle(), ...ticks, title: { text: axis.title } },
      yaxis: { ...axisStyle(), title: { text: "success" }, range: [-0.03, 1.03], tickformat: ".0%" },
    }), config);
  }

  const chosenMap = () => data.maps.of[document.querySelector("#map-shown [name=policy]").value];

  function drawMap() {
    const { tasks, conditions, levels } = data.maps;
    const narrow = isNarrow();
    const along = { orientation: "h", x: 0, xanchor: "left", y: 1, yanchor: "bottom", thickness: 10, title: { text: "success", side: "top" } };
    const beside = { thickness: 20, title: { text: "success" } };
    const map = {
      type: "heatmap",
      ...chosenMap(),
      x: tasks.map((_, place) => place),
      y: conditions.map((_, place) => place),
      text: levels.map((level) => tasks.map((task) => `${escaped(task)}<br>${escaped(level)}`)),
      hovertemplate: "%{text}: %{customdata[0]} %{customdata[1]}, %{customdata[2]}<extra></extra>",
      zmin: 0,
      zmax: 1,
      colorscale: [[0, colour("--paper")], [1, colour("--s0")]],
      colorbar: { ...(narrow ? along : beside), tickformat: ".0%" },
      xgap: 1,
      ygap: 1,
    };
    const plain = { ...axisStyle(), showgrid: false, zeroline: false, tickmode: "array" };
    // Room for the labels of conditions and the colours; Plotly makes it smaller where they are shorter.
    const room = narrow ? 150 : 420;
    const width = Math.max(document.getElementById("map").parentElement.clientWidth, room + COLUMN * tasks.length);
    const longest = LETTER * Math.max(...tasks.map((task) => task.length));
    const areLevel = longest < (width - room) / tasks.length;
    Plotly.react("map", [map], layout({
      width,
      height: 120 + (narrow ? 70 : 0) + (areLevel ? 0 : longest) + 19 * conditions.length,
      plot_bgcolor: colour("--rule"), // where there is no result
      xaxis: { ...plain, tickvals: map.x, ticktext: tasks.map(escaped), tickangle: areLevel ? 0 : -90, tickfont: { size: 11 } },
      yaxis: { ...plain, tickvals: map.y, ticktext: (narrow ? conditions : levels).map(escaped), autorange: "reversed" },
    }), config);
  }

  // Texts are set as text, never as HTML: names come from the suite.
  function fill(table, header, rows, labels) {
    const cell = (tag, text, className) => Object.assign(document.createElement(tag), { textContent: text, className });
    const line = (texts, tag) => {
      const row = document.createElement("tr");
      row.append(...texts.map((text, place) => cell(place ? tag : "th", text, place < labels ? "" : "number")));
      row.firstElementChild.scope = tag === "th" ? "col" : "row";
      return row;
    };
    table.tHead.replaceChildren(line(header, "th"));
    table.tBodies[0].replaceChildren(...rows.map((row) => line(row, "td")));
  }

  function writeLines() {
    const rows = chosenLines().flatMap(({ meta, customdata }) =>
      customdata.map(([rate, interval, episodes, level]) => [meta.policy, meta.simulator, level, rate, interval, episodes]),
    );
    fill(document.querySelector("#lines-values table"), ["policy", "simulator", "severity", "success", "95 % interval", "episodes"], rows, 3);
  }

  function writeMap() {
    const { tasks, levels } = data.maps;
    const cells = chosenMap().customdata.map((row) => row.map(([rate, interval, episodes]) => episodes ? `${rate} ${interval}, ${episodes}` : "–"));
    fill(document.querySelector("#map-values table"), ["condition", ...tasks], cells.map((row, place) => [levels[place], ...row]), 1);
  }

  function draw() {
    for (const [name, plot, write] of [["lines", drawLines, writeLines], ["map", drawMap, writeMap]]) {
      if (!document.getElementById(name)) continue;
      plot();
      if (document.getElementById(`${name}-values`).open) write();
    }
  }
  document.addEventListener("change", draw);
  document.addEventListener("toggle", draw, true); // the event of details does not bubble
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  let waiting;
  addEventListener("resize", () => {
    clearTimeout(waiting);
    waiting = setTimeout(draw, 150);
  });
  draw();
})();
