// Contacts of the AV, counted by kind; a bar is a filter.

const GROUPS = {
  sector: "Side of the AV that is hit",
  accident: "Accident",
  element: "Road element",
  turn: "AV's next turn at the start",
  edge: "Edge at the start",
  speed: "Relative speed",
};
const MOST_BARS = 8;
/** Orders that are known; other values come by count. */
const groupOrders = {};

function showGroups() {
  const known = Object.entries(GROUPS).filter(([column]) =>
    runs.all.some((row) => row[column] !== null),
  );
  const lists = known.map(([column, title]) => groupList(column, title));
  const reasons = unfinishedList();
  byId("groups").replaceChildren(...lists, ...(reasons ? [reasons] : []));
}

function groupList(column, title) {
  const rows = filteredRuns(column).filter(
    (row) => row.outcome?.startsWith("AV") && row[column] !== null,
  );
  const counts = [...grouped(rows, (row) => row[column])].map(([name, group]) => [
    name,
    group.length,
  ]);
  const order = groupOrders[column] ?? [];
  const place = (name) => (order.includes(name) ? order.indexOf(name) : order.length);
  counts.sort(
    (one, other) =>
      place(one[0]) - place(other[0]) || other[1] - one[1] || compared(one[0], other[0]),
  );
  const most = Math.max(...counts.map(([, count]) => count), 1);
  const bars = counts.slice(0, MOST_BARS).map(([name, count]) =>
    make(
      "button",
      {
        type: "button",
        "aria-pressed": String(runs.only[column] === name),
        "aria-label": `${title}: ${name}, ${counted(count, "run")}`,
        onclick: () => {
          setFilter(column, runs.only[column] === name ? "" : name);
          refocus(column, name);
        },
        "data-name": name,
      },
      make("span", {}, name),
      make("span", { class: "bar", style: `width:${((100 * count) / most).toFixed(1)}%` }),
      make("span", { class: "count" }, String(count)),
    ),
  );
  return make(
    "div",
    { class: "group", "data-column": column },
    make("h3", {}, title),
    ...(bars.length ? bars : [make("p", { class: "hint" }, "none")]),
    counts.length > MOST_BARS
      ? make("p", { class: "hint" }, `and ${counts.length - MOST_BARS} more with fewer`)
      : null,
  );
}

function refocus(column, name) {
  const list = byId("groups").querySelector(`[data-column="${column}"]`);
  [...list.querySelectorAll("button")].find((button) => button.dataset.name === name)?.focus();
}

/** Runs without a result, by the first words of the reason. */
function unfinishedList() {
  const rows = filteredRuns().filter((row) => row.status !== "ok");
  if (!rows.length) return null;
  const counts = [...grouped(rows, (row) => `${row.status}: ${(row.note ?? "").slice(0, 90)}`)];
  return make(
    "div",
    { class: "group" },
    make("h3", {}, "Runs without a result"),
    ...counts.map(([reason, group]) => make("p", { class: "hint" }, `${group.length} × ${reason}`)),
  );
}
