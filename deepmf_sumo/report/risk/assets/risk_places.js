// The places: what is shown, and in which order.

const HEADINGS = {
  rank: "rank",
  title: "place",
  kind: "kind",
  risk: "risk (90 %)",
  attacks: "attacks",
  hits: "hits",
  hit_rate: "hit rate (95 %)",
  avoidable: "avoidable",
  avoidable_share: "avoidable of hits (95 %)",
  severe: "severe",
  conflicts: "conflicts",
  min_ttc_s: "min TTC, s",
  min_gap_m: "min gap, m",
  delta_v_mps: "mean Δv, m/s",
  delta_v_most_mps: "most Δv, m/s",
  criticality: "criticality (90 %)",
};
const DIGITS = {
  rank: 0,
  attacks: 0,
  hits: 0,
  hit_rate: 2,
  avoidable: 0,
  avoidable_share: 2,
  severe: 0,
  conflicts: 0,
  min_ttc_s: 2,
  min_gap_m: 2,
  delta_v_mps: 1,
  delta_v_most_mps: 1,
  criticality: 2,
  risk: 2,
};
const KIND_NAMES = {
  site: "movements and edges",
  movement: "movements",
  edge: "edges",
  junction: "junctions",
  lane: "lanes",
};
const COUNTED_NAMES = { decided: "decided there", began: "began there" };

/** The page's state: one object a place, what is chosen, how it is ordered. */
const risk = {
  all: [],
  kind: "site",
  counted: "decided",
  event: "hit",
  sort: { column: "rank", down: false },
  picked: null,
  most: 100,
};

function readPlaces(content) {
  risk.all = content.rows.map((values, number) => {
    const row = { number, shape: content.shapes[number] };
    content.columns.forEach((column, place) => {
      row[column] = values[place];
    });
    return row;
  });
}

/** The places that are shown, with risk and rank of the chosen event. */
function shownPlaces() {
  const { kind, counted, event, sort } = risk;
  const found = risk.all
    .filter((row) => row.counted === counted)
    .filter((row) => (kind === "site" ? ["movement", "edge"].includes(row.kind) : row.kind === kind));
  for (const row of found) {
    row.risk = row[`risk_${event}`];
    row.risk_lo = row[`risk_${event}_lo`];
    row.risk_hi = row[`risk_${event}_hi`];
  }
  found.sort(
    (one, other) =>
      other.risk_lo - one.risk_lo || other.risk - one.risk || (one.place < other.place ? -1 : 1),
  );
  found.forEach((row, place) => {
    const before = found[place - 1];
    const equal = before && before.risk_lo === row.risk_lo && before.risk === row.risk;
    row.rank = equal ? before.rank : place + 1;
  });
  return found.sort((one, other) => compared(one[sort.column], other[sort.column], sort.down));
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

/** Colour of a share (0 to 1) of the worst risk. */
function riskColour(share, stops) {
  const place = Math.min(Math.max(share, 0), 1) * 2,
    low = Math.min(Math.floor(place), 1);
  const mix = stops[low].map((value, part) =>
    Math.round(value + (place - low) * (stops[low + 1][part] - value)),
  );
  return `rgb(${mix.join(",")})`;
}
