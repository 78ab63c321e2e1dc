// Deviation along the route and as a histogram.

const charts = [];

function chartColours() {
  return { before: inks.get("slam-before"), after: inks.get("slam-after"), axis: inks.get("muted"), grid: inks.get("rule") };
}

function axis(label, extra = {}) {
  const { axis: stroke, grid } = chartColours(), line = { stroke: grid, width: 1 };
  return { label, labelSize: 18, labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif", stroke, grid: line, ticks: { ...line, size: 4 }, ...extra };
}

function along(values) {
  return Array.from(values, (v) => (v < 0 ? null : v));
}

function routeChart(node, size) {
  const colours = chartColours(), driven = Array.from(slam.driven);
  const shade = (chart) => {
    const { ctx, bbox } = chart;
    ctx.save();
    ctx.fillStyle = inks.get("shade");
    for (let i = 0; i < slam.valid.length; ) {
      if (slam.valid[i]) { i++; continue; }
      let j = i;
      while (j < slam.valid.length && !slam.valid[j]) j++;
      const a = Math.max(bbox.left, chart.valToPos(driven[i], "x", true));
      const b = Math.min(bbox.left + bbox.width, chart.valToPos(driven[Math.min(j, driven.length - 1)], "x", true));
      if (b > a) ctx.fillRect(a, bbox.top, b - a, bbox.height);
      i = j;
    }
    ctx.restore();
  };
  const show = (_, v) => (v === null || v === undefined ? "–" : `${number(v, 2)} m`);
  const further = [["predicted σ", "sheet", slam.sigma, 1.4], ["to withheld GNSS", "act-set", slam.held_out, 0]].filter(([, , values]) => values.some((v) => v >= 0));
  return new uPlot({
    ...size, title: "Distance to the GNSS line along the route",
    cursor: { points: { size: 6 }, drag: { x: true, y: false } },
    scales: { x: { time: false }, y: { range: (_, low, high) => [0, Math.max(0.1, (high ?? 1) * 1.05)] } },
    axes: [axis("driven, m", { size: 26, labelSize: 15 }), axis("distance, m", { size: 44 })],
    series: [{ label: "driven", value: show },
      { label: "rigid start", stroke: colours.before, width: 1.5, dash: [6, 4], value: show },
      { label: "aligned", stroke: colours.after, width: 1.8, fill: inks.get("slam-after-fill"), value: show },
      ...further.map(([name, colour, , width]) => ({ label: name, stroke: inks.get(colour), width, value: show, spanGaps: width > 0,
        points: { show: width === 0, size: 4, fill: inks.get(colour) } }))],
    hooks: {
      drawAxes: [shade],
      setCursor: [(chart) => showPose(chart.cursor.idx)],
      ready: [(chart) => chart.over.addEventListener("click", () => {
        const i = chart.cursor.idx;
        if (i !== null && i !== undefined) goTo(slam.after[2 * i], slam.after[2 * i + 1]);
      })],
    },
  }, [driven, along(slam.deviation_before), along(slam.deviation_after), ...further.map(([, , values]) => along(values))], node);
}

/** Shares of poses per bin of distance, equal bins up to the 99th percentile of the worse, all else in the last. */
function histogram() {
  const both = [slam.deviation_before, slam.deviation_after].map((v) => Array.from(v).filter((d) => d >= 0));
  const sorted = both[0].concat(both[1]).sort((a, b) => a - b);
  const top = Math.max(0.05, sorted[Math.floor(0.99 * (sorted.length - 1))] ?? 1), bins = 40, width = top / bins;
  const edges = Array.from({ length: bins }, (_, i) => (i + 0.5) * width);
  const shares = both.map((values) => {
    const out = new Array(bins).fill(0);
    for (const d of values) out[Math.min(bins - 1, Math.floor(d / width))] += 100 / values.length;
    return out;
  });
  return { edges, shares };
}

function histogramChart(node, size) {
  const colours = chartColours(), { edges, shares } = histogram(), bars = uPlot.paths.bars({ size: [0.9, 100] });
  const show = (_, v) => (v === null || v === undefined ? "–" : `${number(v, 1)} %`);
  return new uPlot({
    ...size, title: "Distribution over poses",
    scales: { x: { time: false, range: () => [0, edges[0] * 2 * edges.length] }, y: { range: (_, low, high) => [0, Math.max(1, (high ?? 1) * 1.05)] } },
    axes: [axis("distance, m", { size: 26, labelSize: 15 }), axis("poses, %", { size: 40 })],
    cursor: { points: { show: false }, drag: { x: false, y: false } },
    series: [{ label: "about", value: (_, v) => (v === null || v === undefined ? "–" : `${number(v, 2)} m`) },
      { label: "rigid start", stroke: colours.before, width: 1.4, fill: inks.get("slam-before-fill"), paths: bars, value: show, points: { show: false } },
      { label: "aligned", stroke: colours.after, width: 1.4, fill: inks.get("slam-after-fill"), paths: bars, value: show, points: { show: false } }],
  }, [edges, ...shares], node);
}

/** Both charts, side by side, as large as the panel allows. */
function drawCharts(panel) {
  charts.splice(0).forEach((chart) => chart.destroy());
  const width = panel.clientWidth, height = Math.max(120, panel.clientHeight - 54);
  const wide = width > 760, share = wide ? 0.62 : 1;
  const boxes = [el("div", { class: "chart" }), el("div", { class: "chart" })];
  panel.replaceChildren(el("div", { class: "charts" }, boxes));
  charts.push(routeChart(boxes[0], { width: Math.floor(width * share) - 16, height }));
  charts.push(histogramChart(boxes[1], { width: Math.floor(wide ? width * (1 - share) : width) - 16, height }));
}
