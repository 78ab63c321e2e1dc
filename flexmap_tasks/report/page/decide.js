// Decisions on values up for review: made here, saved as a file, carried out by the next run.

const decided = new Map();
let unsaved = false;

/** Buttons for one row of the transfers; nothing for rows that are no question of a value. */
function decisionButtons(row) {
  const t = data.transfers, now = decided.get(row);
  if (t.key[row] === "") return null;
  const value = el("input", { type: "text", value: now?.value ?? t.new[row], "aria-label": "value to set", maxlength: 255 });
  const button = (decision, text, key) => el("button", {
    type: "button", "data-decision": decision, title: `Key ${key}`, "aria-pressed": String(now?.decision === decision),
    onclick: () => decide(row, decision, value.value),
  }, text);
  return el("div", { class: "decide" }, value, button("accept", "Accept", "y"), button("reject", "Reject", "x"));
}

/** Note a decision, or take it back when it was made before; then go on to the next item. */
function decide(row, decision, value) {
  const same = decided.get(row)?.decision === decision && decided.get(row).value === value;
  if (same) decided.delete(row);
  else decided.set(row, { decision, value });
  unsaved = decided.size > 0;
  showDecided();
  if (same) stepTo(state.item);
  else step(1);
}

/** The same by key, for the item that is shown. */
function decideShown(decision) {
  if (state.item < 0 || data.review.kind[state.item] !== "value") return;
  document.querySelector(`.decide [data-decision=${decision}]`)?.click();
}

function showDecided() {
  $("decided").hidden = decided.size === 0;
  $("decided").textContent = `Save ${decided.size} decisions`;
}

function saveDecisions() {
  const t = data.transfers, lines = ["lanelet_id,way_id,key,old,new,decision,value,note"];
  const note = `decided in the report on ${new Date().toISOString().slice(0, 10)}`;
  for (const [row, { decision, value }] of [...decided].sort((a, b) => a[0] - b[0])) {
    const other = decision === "accept" && value !== t.new[row] ? value : "";
    lines.push([t.lanelet[row], t.way[row], t.key[row], t.old[row], t.new[row], decision, other, note].map(csvCell).join(","));
  }
  download("review_decisions.csv", `${lines.join("\r\n")}\r\n`);
  unsaved = false;
}

addEventListener("beforeunload", (event) => { if (unsaved) event.preventDefault(); });
