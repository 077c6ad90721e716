// The list of places, and the attacks at the one that is picked.

function showTable(places, pick, content) {
  const columns = Object.keys(HEADINGS)
    .filter((column) => column !== "kind" || risk.kind === "site")
    .filter((column) => risk.every || !MORE.includes(column));
  const head = make("tr", {}, ...columns.map(headingCell));
  const body = places.slice(0, risk.most).map((row) =>
    make("tr", { class: row.number === risk.picked ? "picked" : null },
      ...columns.map((column) => placeCell(row, column, pick, content))),
  );
  byId("places").replaceChildren(make("thead", {}, head), make("tbody", {}, ...body));
  byId("more").hidden = places.length <= risk.most;
}

function headingCell(column) {
  const { column: sorted, down } = risk.sort;
  const here = sorted === column;
  return make(
    "th",
    {
      scope: "col",
      "aria-sort": here ? (down ? "descending" : "ascending") : "none",
      class: isNumber(column) ? "number" : null,
    },
    make(
      "button",
      { type: "button", onclick: () => sortBy(column) },
      `${HEADINGS[column]}${here ? (down ? " ▼" : " ▲") : ""}`,
    ),
  );
}

function sortBy(column) {
  const { column: sorted, down } = risk.sort;
  // most numbers are worse the larger they are
  const first = isNumber(column) && !["rank", "min_ttc_s", "min_gap_m"].includes(column);
  risk.sort = { column, down: sorted === column ? !down : first };
  risk.show();
}

function isNumber(column) {
  return column in DIGITS || SHARES.includes(column);
}

function placeCell(row, column, pick, content) {
  const value = row[column];
  if (column === "title")
    return make("td", { class: "name", "data-label": HEADINGS.title }, make("button", { type: "button", onclick: () => pick(row.number) }, value));
  if (!isNumber(column)) return make("td", { "data-label": HEADINGS[column] }, value ?? "");
  const share = SHARES.includes(column);
  const shown = (number) => (share ? (100 * number).toFixed(0) : fixed(number, DIGITS[column]));
  const ends = [row[`${column}_lo`], row[`${column}_hi`]];
  const known = typeof value === "number" && ends.every((end) => typeof end === "number");
  const text = typeof value === "number" ? shown(value) + (share ? " %" : "") : "–";
  const interval = known ? ` (${shown(ends[0])} to ${shown(ends[1])}${share ? " %" : ""})` : "";
  return make("td", { class: "number", "data-label": HEADINGS[column] }, column === "risk" ? swatch(row, content) : null, text + interval);
}

/** The colour that a place has on the map. */
function swatch(row, content) {
  if (!row.events) return make("i", { class: "swatch nothing" });
  return make("i", { class: "swatch", style: `background: ${riskColour(row.risk, content.classes)}` });
}

/** The attacks at the place that is picked. */
function showAttacks(content) {
  const row = risk.all[risk.picked];
  if (!row) {
    byId("place").replaceChildren(make("p", { class: "hint" }, "Pick a place on the map or in the list."));
    return;
  }
  const here = content.attacks.filter(([, , , spots]) => spots[row.counted][row.kind] === row.place);
  const what = row.counted === "decided" ? "decided there" : "that began there";
  byId("place").replaceChildren(
    make("p", {}, `${row.title}: ${counted(here.length, "attack")} ${what}`),
    make("ul", {}, ...here.map(([run, , hit, , against]) =>
      make("li", {}, `${run}: ${hit ? "hit" : "no hit"}${against ? `; opponent at ${against}` : ""}`))),
  );
}
