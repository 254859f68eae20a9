// Draws the plots of explore.html again whenever a control, the colour scheme or the width of the window changes.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const config = { displaylogo: false, responsive: true };
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const isNarrow = () => window.innerWidth < 640;

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

  function drawLines() {
    const form = document.getElementById("lines-shown");
    if (!form) return;
    const chosen = new FormData(form);
    const axis = data.axes[chosen.get("axis")];
    const lines = data.lines.filter(
      ({ meta }) =>
        meta.axis === chosen.get("axis") &&
        chosen.getAll("policy").includes(meta.policy) &&
        chosen.getAll("simulator").includes(meta.simulator),
    );
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

  function drawMap() {
    const { tasks, conditions, levels, of } = data.maps;
    const found = of[new FormData(document.getElementById("map-shown")).get("policy")];
    const map = {
      type: "heatmap",
      ...found,
      x: tasks.map((_, place) => place),
      y: conditions.map((_, place) => place),
      text: levels.map((level) => tasks.map((task) => `${task}<br>${level}`)),
      hovertemplate: "%{text}: %{z:.0%} %{customdata[0]}, %{customdata[1]} episodes<extra></extra>",
      zmin: 0,
      zmax: 1,
      colorscale: [[0, colour("--paper")], [1, colour("--s0")]],
      colorbar: { tickformat: ".0%", title: { text: "success" }, thickness: isNarrow() ? 10 : 20 },
      xgap: 1,
      ygap: 1,
    };
    const plain = { ...axisStyle(), showgrid: false, zeroline: false, tickmode: "array" };
    Plotly.react("map", [map], layout({
      height: 220 + 19 * conditions.length,
      plot_bgcolor: colour("--rule"), // where there is no result
      xaxis: { ...plain, tickvals: map.x, ticktext: tasks, tickangle: isNarrow() ? 90 : 0, tickfont: { size: 11 } },
      yaxis: { ...plain, tickvals: map.y, ticktext: isNarrow() ? conditions : levels, autorange: "reversed" },
    }), config);
  }

  function draw() {
    drawLines();
    drawMap();
  }
  document.addEventListener("change", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  matchMedia("(max-width: 639px)").addEventListener("change", draw);
  draw();
})();
