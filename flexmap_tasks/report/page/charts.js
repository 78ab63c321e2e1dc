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

const rootMeanSquare = (values) => Math.sqrt(values.reduce((sum, v) => sum + v * v, 0) / values.length);

/** Predicted against met: bins of equal count by predicted sigma, and the root mean square error of each. */
function calibration() {
  const { sigma, error } = data.calibration, order = Array.from(sigma.keys()).sort((a, b) => sigma[a] - sigma[b]);
  const bins = Math.max(1, Math.min(10, Math.floor(order.length / 20))), out = { predicted: [], met: [] };
  for (let b = 0; b < bins; b++) {
    const rows = order.slice(Math.floor((b * order.length) / bins), Math.floor(((b + 1) * order.length) / bins));
    out.predicted.push(rootMeanSquare(rows.map((i) => sigma[i])));
    out.met.push(rootMeanSquare(rows.map((i) => error[i])));
  }
  return out;
}

function calibrationChart(node, size) {
  const { predicted, met } = calibration(), colours = chartColours(), top = 1.1 * Math.max(...predicted, ...met);
  const show = (_, v) => (v === null || v === undefined ? "–" : `${number(v, 3)} m`);
  const x = [0, ...predicted, top], line = x.slice();
  return new uPlot({
    ...size, title: "Where GNSS was withheld: predicted σ and the error that was met",
    cursor: { points: { size: 6 }, drag: { x: false, y: false } },
    scales: { x: { time: false, range: () => [0, top] }, y: { range: () => [0, top] } },
    axes: [axis("predicted σ, m", { size: 26, labelSize: 15 }), axis("RMS error, m", { size: 50 })],
    series: [{ label: "predicted", value: show },
      { label: "met", stroke: colours.after, width: 1.8, value: show, points: { show: true, size: 6 }, spanGaps: true },
      { label: "as predicted", stroke: colours.axis, width: 1, dash: [5, 5], value: show, points: { show: false } }],
  }, [x, [null, ...met, null], line], node);
}

/** Metres of lanes by the confidence of their match; 20 bins. */
function confidenceChart(node, size) {
  const m = data.matches, bins = 20, parts = { match: new Array(bins).fill(0), review: new Array(bins).fill(0) };
  m.confidence.forEach((c, i) => { if (parts[m.decision[i]] && m.way[i] !== "0") parts[m.decision[i]][Math.min(bins - 1, Math.floor(c * bins))] += m.s_to_m[i] - m.s_from_m[i]; });
  const edges = Array.from({ length: bins }, (_, i) => (i + 0.5) / bins), bars = uPlot.paths.bars({ size: [0.9, 100] });
  const log = (values) => values.map((v) => (v > 0 ? v : null)), show = (_, v) => (v === null || v === undefined ? "–" : `${number(v, 0)} m`);
  const top = Math.max(10, ...parts.match, ...parts.review), colours_ = chartColours();
  const decades = (_, splits) => splits.map((v) => (Number.isInteger(Math.log10(v)) ? v : null));
  return new uPlot({
    ...size, title: "Length of lanes by confidence of the match",
    cursor: { points: { show: false }, drag: { x: false, y: false } },
    scales: { x: { time: false, range: () => [0, 1] }, y: { distr: 3, log: 10, range: () => [1, 10 ** Math.ceil(Math.log10(top))] } },
    axes: [axis("confidence", { size: 26, labelSize: 15 }), axis("length, m", { size: 56, grid: { stroke: colours_.grid, width: 1, filter: decades }, ticks: { show: false } })],
    series: [{ label: "about", value: (_, v) => (v === null || v === undefined ? "–" : number(v, 2)) },
      { label: "matched", stroke: inks.get("slam-after"), fill: inks.get("slam-after-fill"), width: 1.4, paths: bars, value: show, points: { show: false } },
      { label: "review", stroke: inks.get("review"), fill: inks.get("shade"), width: 1.4, paths: bars, value: show, points: { show: false } }],
  }, [edges, log(parts.match), log(parts.review)], node);
}

/** Charts side by side, as large as the panel allows: [maker, share of the width]. */
function drawSideBySide(panel, makers) {
  charts.splice(0).forEach((chart) => chart.destroy());
  const width = panel.clientWidth, height = Math.max(120, panel.clientHeight - 54), wide = width > 760;
  const boxes = makers.map(() => el("div", { class: "chart" }));
  panel.replaceChildren(el("div", { class: "charts" }, boxes));
  makers.forEach(([make, share], i) => charts.push(make(boxes[i], { width: Math.floor(width * (wide ? share : 1)) - 16, height })));
}

function drawCharts(panel) {
  drawSideBySide(panel, [[routeChart, 0.62], [histogramChart, 0.38]]);
}

function drawReliability(panel) {
  drawSideBySide(panel, [data.calibration && [calibrationChart, 0.5], data.matches && [confidenceChart, 0.5]].filter(Boolean));
}
