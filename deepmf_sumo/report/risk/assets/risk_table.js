// The list of places, and the attacks at the one that is picked.

function showTable(places, pick) {
  const columns = Object.keys(HEADINGS).filter((column) => column !== "kind" || risk.kind === "site");
  const head = make("tr", {}, ...columns.map(headingCell));
  const body = places.slice(0, risk.most).map((row) =>
    make("tr", { class: row.number === risk.picked ? "picked" : null },
      ...columns.map((column) => placeCell(row, column, pick))),
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
      class: column in DIGITS ? "number" : null,
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
  const first = column in DIGITS && !["rank", "min_ttc_s", "min_gap_m"].includes(column);
  risk.sort = { column, down: sorted === column ? !down : first };
  risk.show();
}

function placeCell(row, column, pick) {
  const value = row[column];
  if (column === "title")
    return make("td", { class: "name" }, make("button", { type: "button", onclick: () => pick(row.number) }, value));
  if (!(column in DIGITS)) return make("td", {}, value ?? "");
  const ends = [row[`${column}_lo`], row[`${column}_hi`]];
  const known = value !== null && ends.every((end) => typeof end === "number");
  const interval = known ? ` (${fixed(ends[0], 2)}–${fixed(ends[1], 2)})` : "";
  return make("td", { class: "number" }, fixed(value, DIGITS[column]) + interval);
}

/** The attacks at the place that is picked. */
function showAttacks(content) {
  const row = risk.all[risk.picked];
  if (!row) return;
  const here = content.attacks.filter(([, , , spots]) => spots[row.counted][row.kind] === row.place);
  byId("place").replaceChildren(
    make("p", {}, `${row.title} (${row.place}): ${here.length} attacks ${COUNTED_NAMES[row.counted]}`),
    make("ul", {}, ...here.map(([run, , hit, , against]) =>
      make("li", {}, `${run}${hit ? ": hit" : ""}${against ? ` (opponent at ${against})` : ""}`))),
  );
}
