// Totals of the filtered runs, by method, planner and so on.

// Not by what contacts alone have: every share would be 100 %.
const TOTALS_BY = ["all runs", "method", "planner", "scene", "part", "edge", "turn"];
const totals = { by: "all runs" };

function showTotalsChoice() {
  const known = TOTALS_BY.filter(
    (column) => column === "all runs" || runs.all.some((row) => row[column] !== null),
  );
  const select = choice(
    known,
    totals.by,
    (value) => {
      totals.by = value;
      showTotals(filteredRuns());
    },
    (value) => columnOf(value)?.filter ?? value,
  );
  select.id = "totals-by";
  byId("totals-by").replaceWith(select);
}

function showTotals(rows) {
  const by = totals.by;
  const groups = [...grouped(rows, (row) => (by === "all runs" ? by : (row[by] ?? "–")))];
  const lines = groups.map(([name, group]) => totalsLine(String(name), group));
  byId("totals").replaceChildren(
    ...tableOf(
      [
        columnOf(by)?.filter ?? "",
        "runs",
        "succeeded",
        "attacked",
        "AV hit by opponent",
        "95 % interval",
        "",
        "findings",
        `contact ${columnOf("collision_speed_mps").heading}`,
        `mean of ${columnOf("ttc_min_s").heading}`,
      ],
      lines,
      [1, 2, 3, 4, 5, 7, 8, 9],
    ),
  );
}

function totalsLine(name, group) {
  const done = group.filter((row) => row.status === "ok");
  // a run without an opponent is no attempt
  const attacked = done.filter((row) => row.opponent !== null);
  const isHit = (row) => row.outcome === "AV hit by opponent";
  const hits = done.filter(isHit);
  const judged = hits.filter((row) => row.finding_rate !== null);
  const rate = rateOf(unitsOf(attacked, isHit));
  const found = judged.filter((row) => row.finding_rate >= 1).length;
  return [
    name,
    String(group.length),
    String(done.length),
    String(attacked.length),
    rate ? `${hits.length}/${attacked.length} = ${percent(rate.rate)}` : "–",
    rate ? `${percent(rate.low)} to ${percent(rate.high)}` : "–",
    rate ? intervalBar(rate) : "",
    judged.length ? `${found}/${judged.length} = ${percent(found / judged.length)}` : "–",
    meanOf(hits.map((row) => row.collision_speed_mps)),
    meanOf(attacked.map((row) => row.ttc_min_s)),
  ];
}

/** The interval on a scale from 0 to 1, decoration beside its numbers. */
function intervalBar({ rate, low, high }) {
  const x = (share) => 2 + 116 * share;
  return drawn(
    "svg",
    { width: 120, height: 14, "aria-hidden": "true" },
    drawn("line", { x1: x(0), x2: x(1), y1: 7, y2: 7, stroke: "var(--rule)" }),
    drawn("line", {
      x1: x(low),
      x2: x(high),
      y1: 7,
      y2: 7,
      stroke: "var(--bar)",
      "stroke-width": 5,
    }),
    drawn("circle", { cx: x(rate), cy: 7, r: 4, fill: "var(--ink)" }),
  );
}
