// The runs: filters, order, table.

/** Columns that tell nothing apart where all runs have one value: a line above the table says it. */
const ALIKE = ["method", "planner", "seed"];

/** What is shown of the runs: a row per run, its columns, the filters. */
const runs = { all: [], columns: [], text: "", only: {}, table: null };

function readRuns(content) {
  runs.columns = content.columns;
  runs.all = rowsOf(
    runs.columns.map((column) => column.name),
    content.rows,
  );
  runs.table = new SortedTable("runs", showRuns, runCell);
  // Runs of other budgets and of figures would mix into the totals: the main part comes first.
  const parts = new Set(runs.all.map((row) => row.part));
  if (parts.size > 1 && parts.has("main")) runs.only.part = "main";
}

function columnOf(name) {
  return runs.columns.find((column) => column.name === name);
}

/** The runs that the filters leave, `but` one filter; in the table's order. */
function filteredRuns(but = null) {
  const wanted = Object.entries(runs.only).filter(([column]) => column !== but);
  const text = runs.text.toLowerCase();
  return runs.table.sorted(
    runs.all.filter(
      (row) =>
        wanted.every(([column, value]) => String(row[column]) === value) &&
        (!text || `${row.run} ${row.note ?? ""} ${row.opponent ?? ""}`.toLowerCase().includes(text)),
    ),
  );
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
  for (const { name, filter } of runs.columns.filter((column) => column.filter)) {
    const values = [...new Set(runs.all.map((row) => row[name]))].filter((value) => value !== null);
    if (values.length > 1) fields.push(make("label", {}, filter, filterChoice(name, values)));
  }
  const clear = () => {
    runs.text = "";
    runs.only = {};
    showAll();
  };
  fields.push(make("button", { type: "button", onclick: clear }, "Clear filters"));
  byId("filters").replaceChildren(...fields);
}

function filterChoice(column, values) {
  const sorted = values.map(String).sort((one, other) => compared(one, other));
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

/** Columns in which some run has a value that tells it from others. */
function shownColumns() {
  const alike = alikeColumns();
  const tells = (name, value) => value !== null && !(name === "status" && value === "ok");
  return runs.columns.filter(
    ({ name, heading }) =>
      heading && !alike.includes(name) && runs.all.some((row) => tells(name, row[name])),
  );
}

function showAlike() {
  const same = alikeColumns()
    .filter((column) => runs.all[0][column] !== null)
    .map((column) => `${columnOf(column).heading} ${runs.all[0][column]}`);
  byId("alike").textContent = same.length ? `The same in all runs: ${same.join(", ")}.` : "";
}

function showRuns() {
  const found = filteredRuns();
  showAlike();
  runs.table.fill(shownColumns(), found);
  const part = runs.only.part
    ? `; part of the plan: ${runs.only.part}, the filter shows others`
    : "";
  byId("shown").textContent =
    found.length === runs.all.length
      ? counted(found.length, "run")
      : `${found.length} of ${counted(runs.all.length, "run")}${part}`;
  showTotals(found);
  showGroups();
}

/** The cells that are not plain values: the link, and what went wrong in red. */
function runCell(row, { name, heading }) {
  const value = row[name];
  if (name === "run")
    return make(
      "td",
      { class: "name", "data-label": heading },
      make("a", { href: runAddress(row) }, value),
    );
  const bad =
    (name === "status" && value !== "ok") || (name === "outcome" && value?.startsWith("AV"));
  return bad ? make("td", { class: "bad", "data-label": heading }, value) : null;
}

/** Draw all that depends on the filters, and the filters. */
function showAll() {
  showFilters();
  showRuns();
}
