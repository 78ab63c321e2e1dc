// Tables that sort, filter and export; only the rows in view are in the page.

const ROW_PX = 26;

/** Text of a cell that no spreadsheet takes for a formula. */
function csvCell(value) {
  let text = typeof value === "number" ? (Number.isNaN(value) ? "" : String(value)) : String(value ?? "");
  if (typeof value !== "number" && /^'*[=+@\t\r]|^'*-(?![\d.]+$)/.test(text)) text = `'${text}`;
  return /[",\r\n;]/.test(text) || text !== text.trim() ? `"${text.replaceAll('"', '""')}"` : text;
}

function download(name, text) {
  const address = URL.createObjectURL(new Blob(["\ufeff", text], { type: "text/csv;charset=utf-8" }));
  const anchor = el("a", { href: address, download: name });
  document.body.append(anchor);
  anchor.click();
  anchor.remove();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}

/** columns: { name, width, get(row), show?(row), number? }; open(row) on click; shown(row) filters. */
class Table {
  constructor(name, count, columns, { open = null, shown = null } = {}) {
    Object.assign(this, { name, count, columns, open, shown, sort: null, descending: false, needle: "" });
    this.node = el("div", { class: "table", tabindex: 0, onscroll: () => this.fill() });
    this.head = el("tr");
    this.body = el("tbody");
    this.above = el("tr");
    this.below = el("tr");
    const group = el("colgroup", {}, columns.map((c) => {
      const col = el("col");
      if (c.width) col.style.width = `${c.width}px`;
      return col;
    }));
    this.node.append(el("table", {}, group, el("thead", {}, this.head), this.body));
    this.refresh();
  }

  refresh() {
    const needle = this.needle.toLowerCase();
    this.rows = [];
    for (let row = 0; row < this.count; row++) {
      if (this.shown && !this.shown(row)) continue;
      if (needle && !this.columns.some((c) => String(c.get(row)).toLowerCase().includes(needle))) continue;
      this.rows.push(row);
    }
    if (this.sort !== null) {
      const { get } = this.columns[this.sort], sign = this.descending ? -1 : 1;
      const compare = new Intl.Collator("en", { numeric: true }).compare;
      const keys = new Map(this.rows.map((row) => [row, get(row)]));
      this.rows.sort((a, b) => {
        const x = keys.get(a), y = keys.get(b);
        const order = typeof x === "number" && typeof y === "number" ? (x || 0) - (y || 0) : compare(String(x), String(y));
        return sign * order || a - b;
      });
    }
    this.head.replaceChildren(...this.columns.map((c, i) => el("th", {
      class: c.number ? "num" : null, scope: "col", tabindex: 0, title: "Sort",
      "aria-sort": this.sort === i ? (this.descending ? "descending" : "ascending") : "none",
      onclick: () => this.sortBy(i), onkeydown: (event) => { if (event.key === "Enter") this.sortBy(i); },
    }, c.name, this.sort === i ? (this.descending ? " ▾" : " ▴") : "")));
    this.fill(true);
  }

  sortBy(i) {
    this.descending = this.sort === i ? !this.descending : Boolean(this.columns[i].number);
    this.sort = i;
    this.refresh();
  }

  fill(anew = false, all = false) {
    const height = this.node.clientHeight || 400;
    const first = all ? 0 : Math.max(0, Math.floor(this.node.scrollTop / ROW_PX) - 10);
    const last = all ? this.rows.length : Math.min(this.rows.length, first + Math.ceil(height / ROW_PX) + 20);
    if (!anew && this.first === first && this.last === last) return;
    this.first = first;
    this.last = last;
    this.above.style.height = `${first * ROW_PX}px`;
    this.below.style.height = `${(this.rows.length - last) * ROW_PX}px`;
    this.body.replaceChildren(this.above, ...this.rows.slice(first, last).map((row) => this.line(row)), this.below);
    if (!this.rows.length) this.body.replaceChildren(el("tr", {}, el("td", { class: "empty", colspan: this.columns.length }, "No rows")));
  }

  line(row) {
    return el("tr", { class: this.open ? "opens" : null, onclick: this.open ? () => this.open(row) : null }, this.columns.map((c) => {
      const value = c.show ? c.show(row) : c.get(row);
      const cell = typeof value === "number" ? (c.digits === undefined ? String(value) : number(value, c.digits)) : value;
      return el("td", { class: c.number ? "num" : null }, typeof cell === "string" ? foreign(cell.slice(0, 300)) : cell);
    }));
  }

  csv() {
    const lines = [this.columns.map((c) => csvCell(c.name)).join(",")];
    for (const row of this.rows) lines.push(this.columns.map((c) => csvCell(c.get(row))).join(","));
    return `${lines.join("\r\n")}\r\n`;
  }
}

function qualityTable() {
  const q = data.quality;
  return new Table("quality", q.length, [
    { name: "figure", width: 330, get: (i) => q[i].name, show: (i) => readable(q[i].name) },
    { name: "value", width: 120, number: true, get: (i) => q[i].value ?? NaN, show: (i) => withUnit(q[i].value, q[i].unit) },
    { name: "unit", width: 70, get: (i) => q[i].unit },
    { name: "limit", width: 90, number: true, get: (i) => q[i].limit ?? NaN, show: (i) => (q[i].limit === null ? "" : String(q[i].limit)) },
    { name: "judged", get: (i) => (q[i].passed === null ? "" : q[i].passed ? "ok" : "missed"), show: (i) => (q[i].passed === null ? "" : badge(q[i].passed ? "ok" : "missed")) },
  ]);
}

function transferTable() {
  const t = data.transfers;
  return new Table("transfers", t.lanelet.length, [
    { name: "lanelet", width: 118, get: (i) => t.lanelet[i] },
    { name: "attribute", width: 130, get: (i) => t.key[i] },
    { name: "before", width: 120, get: (i) => t.old[i] },
    { name: "OSM says", width: 150, get: (i) => t.new[i] },
    { name: "decision", width: 86, get: (i) => t.action[i], show: (i) => badge(t.action[i]) },
    { name: "way", width: 100, get: (i) => (t.way[i] === "0" ? "" : t.way[i]) },
    { name: "version", width: 72, number: true, get: (i) => t.version[i] },
    { name: "date", width: 96, get: (i) => t.way_timestamp[i], show: (i) => t.way_timestamp[i].slice(0, 10) },
    { name: "confidence", width: 96, number: true, digits: 2, get: (i) => (t.confidence[i] < 0 ? NaN : t.confidence[i]) },
    { name: "why", get: (i) => t.reason[i] },
  ], { open: (i) => select("lanelet", t.lanelet[i], true), shown: passes });
}

const KINDS = { match: "match", value: "attribute", lanes: "lane count", fragment: "fragment", change: "OSM change" };

/** What item i of the review asks: { subject, have, offer, why }. */
function question(i) {
  const row = data.review.row[i], kind = data.review.kind[i];
  if (kind === "value" || kind === "fragment") {
    const t = data.transfers;
    return { subject: t.key[row] || "cut", have: t.old[row], offer: t.new[row], why: t.reason[row] };
  }
  if (kind === "match") {
    const m = data.matches;
    return { subject: "way", have: "", offer: m.way[row] === "0" ? "" : m.way[row], why: m.reason[row] };
  }
  if (kind === "change") {
    const c = data.changes, moved = c.moved_m[row] >= 0 ? `; its course moved by ${number(c.moved_m[row], 1)} m` : "";
    return { subject: c.key[row], have: c.old[row], offer: c.new[row], why: `OSM way ${c.way[row]}: version ${c.version_old[row] || "–"} to ${c.version_new[row] || "–"}, ${c.time_new[row].slice(0, 10) || "gone"}${moved}` };
  }
  const c = data.lane_check;
  return { subject: "lanes", have: String(c.lanes_map[row]), offer: String(c.lanes_osm[row]), why: c.reason[row] };
}

function reviewTable() {
  const r = data.review;
  return new Table("review", r.row.length, [
    { name: "no.", width: 56, number: true, get: (i) => i + 1 },
    { name: "lanelet", width: 118, get: (i) => r.lanelet[i] },
    { name: "kind", width: 100, get: (i) => KINDS[r.kind[i]] },
    { name: "about", width: 130, get: (i) => question(i).subject },
    { name: "map has", width: 140, get: (i) => question(i).have },
    { name: "OSM says", width: 160, get: (i) => question(i).offer },
    { name: "decision", width: 110, get: (i) => decisionOf(asked(i))?.decision ?? "open", show: (i) => badge(decisionOf(asked(i))?.decision ?? "open") },
    { name: "why", get: (i) => question(i).why },
  ], { open: (i) => stepTo(i) });
}

function laneTable() {
  const c = data.lane_check, count = (n) => (n < 0 ? NaN : n);
  return new Table("lane_check", c.lanelet.length, [
    { name: "lanelet", width: 118, get: (i) => c.lanelet[i] },
    { name: "verdict", width: 100, get: (i) => c.verdict[i], show: (i) => badge(c.verdict[i]) },
    { name: "lanes, map", width: 90, number: true, get: (i) => count(c.lanes_map[i]), show: (i) => number(count(c.lanes_map[i]), 0) },
    { name: "lanes, OSM", width: 90, number: true, get: (i) => count(c.lanes_osm[i]), show: (i) => number(count(c.lanes_osm[i]), 0) },
    { name: "way", width: 110, get: (i) => (c.way[i] === "0" ? "" : c.way[i]) },
    { name: "why", get: (i) => c.reason[i] },
  ], { open: (i) => select("lanelet", c.lanelet[i], true) });
}

function pointTable() {
  return new Table("control_points", points.label.length, [
    { name: "point", width: 110, get: (i) => points.label[i] },
    { name: "used", width: 60, get: (i) => (points.used[i] ? "yes" : "no") },
    { name: "start off, m", width: 100, number: true, digits: 3, get: (i) => pointShift(i).start },
    { name: "left off, m", width: 100, number: true, digits: 3, get: (i) => pointShift(i).left },
    { name: "sigma, m", width: 90, number: true, digits: 3, get: (i) => points.sigma[i] },
    { name: "target x, m", width: 110, number: true, digits: 3, get: (i) => points.target[2 * i] },
    { name: "target y, m", width: 110, number: true, digits: 3, get: (i) => points.target[2 * i + 1] },
    { name: "why", get: (i) => points.reason[i] },
  ], { open: (i) => select("point", String(i), true) });
}

function findingTable() {
  return new Table("findings", findings.id.length, [
    { name: "severity", width: 90, get: (i) => findings.severity[i], show: (i) => badge(findings.severity[i]) },
    { name: "rule", width: 210, get: (i) => findings.code[i] },
    { name: "primitive", width: 110, get: (i) => findings.primitive[i] },
    { name: "id", width: 110, get: (i) => (findings.id[i] === "0" ? "" : findings.id[i]) },
    { name: "message", get: (i) => findings.message[i] },
  ], { open: openFinding });
}

function changeTable() {
  const c = data.changes;
  return new Table("osm_changes", c.way.length, [
    { name: "way", width: 110, get: (i) => c.way[i] },
    { name: "what", width: 90, get: (i) => c.kind[i] },
    { name: "tag", width: 130, get: (i) => (c.kind[i] === "tag" ? c.key[i] : "") },
    { name: "before", width: 140, get: (i) => c.old[i] },
    { name: "now", width: 140, get: (i) => c.new[i] },
    { name: "moved, m", width: 84, number: true, digits: 1, get: (i) => (c.moved_m[i] < 0 ? NaN : c.moved_m[i]) },
    { name: "versions", width: 80, get: (i) => `${c.version_old[i] || "–"} → ${c.version_new[i] || "–"}` },
    { name: "changed", width: 96, get: (i) => c.time_new[i], show: (i) => c.time_new[i].slice(0, 10) },
    { name: "lanelets", get: (i) => c.lanelets[i] },
  ], { open: (i) => { if (roads?.rowOf.has(c.way[i])) select("way", c.way[i], true); else goTo(changePlaces[2 * i], changePlaces[2 * i + 1]); } });
}

/** What ran for this page, and how long it takes when it is not in the store. */
function stageTable() {
  const s = data.stages;
  return new Table("stages", s.length, [
    { name: "stage", width: 240, get: (i) => readable(s[i].stage) },
    { name: "state", width: 110, get: (i) => (s[i].cached ? "cached" : "computed"), show: (i) => badge(s[i].cached ? "cached" : "computed") },
    { name: "computing takes, s", width: 172, number: true, digits: 2, get: (i) => s[i].seconds },
    { name: "", get: () => "", show: (i) => { const bar = el("i", { class: `time ${s[i].cached ? "" : "ran"}` }); bar.style.width = `${(100 * s[i].seconds) / Math.max(...s.map((x) => x.seconds), 1e-9)}%`; return bar; } },
  ]);
}

function openFinding(i) {
  const primitive = findings.primitive[i], id = findings.id[i], at = placeOfFinding(i);
  if (primitive === "lanelet" && placeOf(id)) select("lanelet", id, true);
  else if (primitive === "road" && roads?.rowOf.has(id)) select("way", id, true);
  else if (at) goTo(...at);
}
