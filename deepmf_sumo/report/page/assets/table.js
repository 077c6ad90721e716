// The runs: filters, order, table.

const HEADINGS = {
  run: "run",
  status: "status",
  outcome: "outcome",
  method: "method",
  planner: "planner",
  seed: "seed",
  time_s: "contact, s",
  speed_mps: "speed, m/s",
  delta_v_mps: "Δv, m/s",
  sector: "AV hit at",
  accident: "accident",
  element: "road element",
  edge: "edge at the start",
  turn: "AV's next turn",
  min_ttc_s: "least TTC, s",
  min_gap_m: "least gap, m",
  avoidable: "avoidable",
  opponent: "opponent",
  score: "score",
  note: "note",
};
const DIGITS = {
  time_s: 1,
  speed_mps: 1,
  delta_v_mps: 1,
  min_ttc_s: 1,
  min_gap_m: 1,
  score: 2,
  seed: 0,
};
const FILTERS = {
  status: "status",
  outcome: "outcome",
  method: "method",
  planner: "planner",
  scene: "scene",
  part: "part of the plan",
  sector: "AV hit at",
  accident: "accident",
  element: "road element",
  edge: "edge at the start",
  turn: "AV's next turn",
  speed: "contact speed",
};
/** Columns that say nothing where all runs have the same in them: one line above the table does. */
const ALIKE = ["method", "planner", "seed"];
const PAGE_ROWS = 200;

/** The table's state: one object a run, what is filtered, how it is ordered. */
const runs = { all: [], text: "", only: {}, sort: { column: null, down: false }, most: PAGE_ROWS };

function readRows(content) {
  runs.all = content.rows.map((values, number) => {
    const row = { number };
    content.columns.forEach((column, place) => {
      row[column] = values[place];
    });
    return row;
  });
  // Other budgets and figures' runs would mix into the totals: the main part comes first.
  if (
    new Set(runs.all.map((row) => row.part)).size > 1 &&
    runs.all.some((row) => row.part === "main")
  ) {
    runs.only.part = "main";
  }
}

/** The runs that the filters leave, `but` one filter; in the table's order. */
function filteredRuns(but = null) {
  const wanted = Object.entries(runs.only).filter(([column]) => column !== but);
  const text = runs.text.toLowerCase();
  const found = runs.all.filter(
    (row) =>
      wanted.every(([column, value]) => String(row[column]) === value) &&
      (!text || `${row.run} ${row.note ?? ""} ${row.opponent ?? ""}`.toLowerCase().includes(text)),
  );
  const { column, down } = runs.sort;
  return column ? found.sort((one, other) => compared(one[column], other[column], down)) : found;
}

/** Order of two cells; those without a value come last either way. */
function compared(one, other, down) {
  if (one === other) return 0;
  if (one === null) return 1;
  if (other === null) return -1;
  const order =
    typeof one === "number" && typeof other === "number"
      ? one - other
      : String(one).localeCompare(String(other), "en", { numeric: true });
  return down ? -order : order;
}

function showFilters() {
  const search = make("input", {
    type: "search",
    value: runs.text,
    oninput: (event) => {
      runs.text = event.target.value;
      showRuns();
    },
  });
  const fields = [make("label", {}, "search", search)];
  for (const [column, label] of Object.entries(FILTERS)) {
    const values = [...new Set(runs.all.map((row) => row[column]))].filter(
      (value) => value !== null,
    );
    if (values.length > 1) fields.push(make("label", {}, label, filterChoice(column, values)));
  }
  fields.push(
    make(
      "button",
      {
        type: "button",
        onclick: () => {
          runs.text = "";
          runs.only = {};
          showAll();
        },
      },
      "Clear filters",
    ),
  );
  byId("filters").replaceChildren(...fields);
}

function filterChoice(column, values) {
  const sorted = values.map(String).sort((one, other) => compared(one, other, false));
  return choice(
    ["", ...sorted],
    runs.only[column] ?? "",
    (value) => setFilter(column, value),
    (value) => value || "all",
  );
}

/** Keep only the runs with this value; all for an empty one. */
function setFilter(column, value) {
  if (value) runs.only[column] = value;
  else delete runs.only[column];
  showAll();
}

/** The columns of `ALIKE` in which all runs have one value. */
function alikeColumns() {
  if (runs.all.length < 2) return [];
  return ALIKE.filter((column) => new Set(runs.all.map((row) => row[column])).size === 1);
}

function shownColumns() {
  const alike = alikeColumns();
  return Object.keys(HEADINGS).filter(
    (column) =>
      column === "run" ||
      (!alike.includes(column) &&
        runs.all.some(
          (row) => row[column] !== null && !(column === "status" && row[column] === "ok"),
        )),
  );
}

function showAlike() {
  const same = alikeColumns().filter((column) => runs.all[0][column] !== null);
  byId("alike").textContent =
    same.length
      ? `The same in all runs: ${same.map((column) => `${HEADINGS[column]} ${runs.all[0][column]}`).join(", ")}.`
      : "";
}

function showRuns() {
  const found = filteredRuns();
  const columns = shownColumns();
  showAlike();
  const head = make("tr", {}, ...columns.map(headingCell));
  const body = found
    .slice(0, runs.most)
    .map((row) => make("tr", {}, ...columns.map((column) => cell(row, column))));
  byId("runs").replaceChildren(make("thead", {}, head), make("tbody", {}, ...body));
  const part = runs.only.part
    ? `; part of the plan: ${runs.only.part}, the filter shows others`
    : "";
  byId("shown").textContent =
    found.length === runs.all.length
      ? counted(found.length, "run")
      : `${found.length} of ${counted(runs.all.length, "run")}${part}`;
  byId("more").hidden = found.length <= runs.most;
  byId("more").textContent = `Show ${Math.min(PAGE_ROWS, found.length - runs.most)} more`;
  showTotals(found);
  showGroups();
}

function headingCell(column) {
  const { column: sorted, down } = runs.sort;
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
  const { column: sorted, down } = runs.sort;
  runs.sort = { column, down: sorted === column ? !down : false };
  showRuns();
  const place = [...byId("runs").querySelectorAll("th button")];
  place.find((button) => button.textContent.startsWith(HEADINGS[column]))?.focus();
}

function cell(row, column) {
  const value = row[column];
  if (column === "run") {
    return make(
      "td",
      { class: "name", "data-label": HEADINGS.run },
      make("a", { href: `#run=${encodeURIComponent(value)}` }, value),
    );
  }
  const label = { "data-label": HEADINGS[column] };
  if (column in DIGITS)
    return make("td", { class: value === null ? "number none" : "number", ...label }, fixed(value, DIGITS[column]));
  if (column === "avoidable")
    return make("td", label, value === null ? "" : value >= 1 ? "yes" : "no");
  const bad =
    (column === "status" && value !== "ok") || (column === "outcome" && value?.startsWith("AV"));
  return make("td", { ...(bad ? { class: "bad" } : {}), ...label }, value ?? "");
}

/** Draw all that depends on the filters, the filters among it. */
function showAll() {
  showFilters();
  showRuns();
}
