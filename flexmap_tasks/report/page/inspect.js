// The panel on the right: the whole run, or what is selected.

function section(title, ...children) {
  return el("section", { class: "card" }, el("h3", {}, title), ...children);
}

function facts(rows) {
  return el("dl", { class: "facts" }, rows.filter(([, value]) => value !== null && value !== undefined)
    .flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
}

/** A bar of shares: [kind, count] in fixed order, with the numbers below. */
function shareBar(parts) {
  const total = parts.reduce((sum, [, count]) => sum + count, 0) || 1;
  const bar = el("div", { class: "shares", role: "img", "aria-label": parts.map(([kind, n]) => `${words[kind] ?? kind} ${n}`).join(", ") });
  for (const [kind, count] of parts) {
    if (!count) continue;
    const piece = el("i", { class: `s-${kind}` });
    piece.style.flexGrow = String(count / total);
    bar.append(piece);
  }
  return el("div", {}, bar, el("ul", { class: "share-list" }, parts.map(([kind, count]) =>
    el("li", {}, swatch(kind), el("span", {}, words[kind] ?? kind), el("b", {}, number(count, 0))))));
}

function overview() {
  const value = (name) => measures.get(name);
  const big = (label, figure, unit) => el("div", { class: "big" }, el("span", {}, label), el("b", {}, figure), el("small", {}, unit));
  const out = [el("h2", {}, "What this run did")];
  out.push(section("Alignment",
    el("div", { class: "pair" },
      big("rigid start", number(value("deviation_before_all_rmse")), "m RMSE"), el("span", { class: "to" }, "→"),
      big("aligned", number(value("deviation_after_all_rmse")), "m RMSE")),
    facts([["mean after", withUnit(value("deviation_after_all_mean"), "m")],
      ["RMSE with valid GNSS", withUnit(value("deviation_after_valid_rmse"), "m")],
      ["RMSE on withheld GNSS", measures.has("held_out_error_rmse") ? withUnit(value("held_out_error_rmse"), "m") : null],
      ["control points", points ? `${number(points.used.reduce((a, b) => a + b, 0), 0)} of ${points.label.length} used` : "none"]]),
    el("p", { class: "hint" }, "Distance of each SLAM pose to the GNSS line; straight across outages.")));
  if (data.matches) {
    out.push(section("Matching", facts([["references matched", percent(value("match_rate"))],
      ["by length", percent(value("match_rate_by_length"))], ["mean score", number(value("match_score_mean"), 3)]])));
  }
  if (data.transfers) {
    const n = counted(data.transfers.action);
    out.push(section("Attributes from OSM", shareBar(ACTIONS.map((action) => [action, n.get(action) ?? 0]))));
  }
  if (data.lane_check) {
    const n = counted(data.lane_check.verdict);
    out.push(section("Lane check", shareBar(VERDICTS.map((verdict) => [verdict, n.get(verdict) ?? 0]))));
  }
  if (data.review.row.length) {
    out.push(el("button", { class: "primary", type: "button", onclick: () => step(1) }, `Step through ${number(data.review.row.length, 0)} review items`));
  }
  return out;
}

function link(kind, id, text) {
  return el("button", { type: "button", class: "link", onclick: () => select(kind, id, true) }, text ?? id);
}

function score(value) {
  const fill = el("i");
  fill.style.width = `${Math.max(0, Math.min(1, value)) * 100}%`;
  return el("span", { class: "score" }, el("span", { class: "meter" }, fill), number(value, 2));
}

function heading(kind, id, extra) {
  return el("div", { class: "heading" }, el("div", {}, el("small", {}, kind), el("h2", {}, foreign(id))), extra,
    el("button", { type: "button", class: "close", title: "Clear (Esc)", onclick: () => select(null) }, "×"));
}

/** All attributes of a lanelet: before, now, where from and why. */
function attributeTable(id) {
  const old = before?.rowOf.has(sourceId(id)) ? new Map(tagsOf(before.lanelets.tags, before.rowOf.get(sourceId(id)))) : new Map();
  const now = after?.rowOf.has(id) ? new Map(tagsOf(after.lanelets.tags, after.rowOf.get(id))) : new Map();
  const rows = transfersOf.get(id) ?? [];
  const table = el("table", { class: "tags" }, el("thead", {}, el("tr", {}, ["attribute", "before", "now"].map((h) => el("th", {}, h)))));
  const body = el("tbody");
  const told = new Map();
  for (const row of rows) {
    const key = data.transfers.key[row];
    told.set(key, [...(told.get(key) ?? []), row]);
  }
  for (const key of new Set([...told.keys(), ...now.keys(), ...old.keys()])) {
    const was = old.get(key), is = now.get(key), changed = was !== is;
    if (key !== "") {
      body.append(el("tr", { class: changed ? "changed" : null }, el("th", {}, foreign(key)),
        el("td", {}, was === undefined ? "–" : foreign(was)), el("td", {}, is === undefined ? "–" : foreign(is))));
    }
    for (const row of told.get(key) ?? []) body.append(el("tr", { class: "why" }, el("td", { colspan: 3 }, provenance(row))));
  }
  table.append(body);
  return table;
}

/** Where a value came from: decision, value, way, version, date, confidence, reason. */
function provenance(row) {
  const t = data.transfers;
  return el("div", { class: "provenance" }, badge(t.action[row]),
    t.action[row] !== "set" && t.new[row] !== "" ? el("span", {}, "offers ", foreign(t.new[row], { class: "foreign value" })) : null,
    t.way[row] !== "0" ? el("span", {}, "way ", link("way", t.way[row]), t.version[row] > 0 ? ` v${t.version[row]}` : "",
      t.way_timestamp[row] ? `, ${t.way_timestamp[row].slice(0, 10)}` : "") : null,
    t.confidence[row] >= 0 ? score(t.confidence[row]) : null, el("span", { class: "reason" }, foreign(t.reason[row])));
}

function matchList(id) {
  const rows = matchesOf.get(id) ?? matchesOf.get(sourceId(id)) ?? [], m = data.matches;
  return rows.map((row) => el("div", { class: "piece" }, badge(m.decision[row]),
    el("span", {}, `${number(m.s_from_m[row], 1)}–${number(m.s_to_m[row], 1)} m`),
    m.way[row] !== "0" ? el("span", {}, "way ", link("way", m.way[row]), m.direction[row] < 0 ? " ⇠" : " ⇢") : null,
    m.way[row] !== "0" ? score(m.confidence[row]) : null, el("span", { class: "reason" }, foreign(m.reason[row])),
    m.decision[row] === "review" ? null : el("details", { open: Boolean(decisionOf(askedOfPiece(row))) }, el("summary", {}, "Decide otherwise"), decisionButtons(askedOfPiece(row)))));
}

function laneletPanel(id) {
  const row = after?.rowOf.get(id), check = lanesOf.get(id), source = sourceId(id);
  const out = [heading("Lanelet", id)];
  out.push(facts([["length", row !== undefined ? `${number(after.lanelets.length[row], 1)} m` : "not in the finished map"],
    ["cut from", source !== id ? link("lanelet", source) : null]]));
  const waiting = reviewOf.get(id) ?? [];
  if (waiting.length) out.push(el("p", { class: "notice" }, swatch("review"), `${waiting.length} for review`));
  out.push(section("Attributes", attributeTable(id)));
  if (data.matches) out.push(section("Match", ...(matchList(id).length ? matchList(id) : [el("p", { class: "hint" }, "no piece of it was matched")])));
  if (check !== undefined) {
    const c = data.lane_check, count = (n) => (n < 0 ? "?" : String(n));
    out.push(section("Lane check", el("div", { class: "piece" }, badge(c.verdict[check]),
      el("span", {}, `map ${count(c.lanes_map[check])}, OSM ${count(c.lanes_osm[check])}`), el("span", { class: "reason" }, foreign(c.reason[check])))));
  }
  return out;
}

function wayPanel(id) {
  const row = roads?.rowOf.get(id), out = [heading("OSM way", id)];
  if (row === undefined) return [...out, el("p", { class: "hint" }, "This way lies outside of what the report shows.")];
  out.push(facts([["version", roads.version[row] > 0 ? String(roads.version[row]) : "–"], ["changed", roads.timestamp[row] || "–"],
    ["length", `${number(roads.length[row], 1)} m`], ["repaired", roads.note?.[row] ? foreign(roads.note[row]) : null],
    ["open", el("a", { href: `https://www.openstreetmap.org/way/${id}`, target: "_blank", rel: "noopener noreferrer" }, "openstreetmap.org")]]));
  out.push(section("Tags", el("table", { class: "tags" }, el("tbody", {}, tagsOf(roads.tags, row).map(([key, value]) =>
    el("tr", {}, el("th", {}, foreign(key)), el("td", {}, foreign(value))))))));
  const lanelets = [...new Set((matchesOfWay.get(id) ?? []).map((m) => data.matches.lanelet[m]))];
  if (lanelets.length) out.push(section(`${lanelets.length} lanelets on it`, el("div", { class: "links" }, lanelets.slice(0, 200).map((l) => link("lanelet", l)))));
  return out;
}

function pointPanel(index) {
  const i = Number(index), { start, left } = pointShift(i), [lon, lat] = lonLat(points.target[2 * i], points.target[2 * i + 1]);
  return [heading("Control point", points.label[i]), facts([["used", points.used[i] ? "yes" : "no"], ["why", foreign(points.reason[i])],
    ["after the rigid start", `${number(start, 3)} m off`], ["after the sheet", `${number(left, 3)} m off`],
    ["sigma", `${number(points.sigma[i], 3)} m`], ["target", `${number(points.target[2 * i], 2)}, ${number(points.target[2 * i + 1], 2)} m`],
    ["latitude, longitude", `${lat.toFixed(7)}, ${lon.toFixed(7)}`]])];
}

function showDetails(kind, id) {
  const panels = { lanelet: laneletPanel, way: wayPanel, point: pointPanel };
  const inspector = document.getElementById("inspector");
  inspector.replaceChildren(...(kind ? panels[kind](id) : overview()));
  inspector.scrollTop = 0;
}
