// The places: what is shown, and in which order.

const HEADINGS = {
  rank: "rank",
  title: "place",
  kind: "kind",
  risk: "risk (90 % interval)",
  attacks: "attacks",
  hits: "hits",
  hit_rate: "hit rate (95 % interval)",
  avoidable: "avoidable hits",
  avoidable_share: "avoidable of hits (95 % interval)",
  severe: "severe hits",
  conflicts: "conflicts",
  other_contacts: "AV hit another",
  min_ttc_s: "least TTC, s",
  min_gap_m: "least gap, m",
  delta_v_mps: "mean Δv of hits, m/s",
  delta_v_most_mps: "most Δv, m/s",
  criticality: "criticality (90 % interval)",
};
const DIGITS = {
  rank: 0,
  attacks: 0,
  hits: 0,
  avoidable: 0,
  severe: 0,
  conflicts: 0,
  other_contacts: 0,
  min_ttc_s: 1,
  min_gap_m: 1,
  delta_v_mps: 1,
  delta_v_most_mps: 1,
  criticality: 2,
};
/** Chances, from 0 to 1, which are shown in percent. */
const SHARES = ["risk", "hit_rate", "avoidable_share"];
/** Columns that are shown when asked for. */
const MORE = ["hit_rate", "avoidable_share", "other_contacts", "min_gap_m", "delta_v_most_mps", "criticality"];
/** Of an event: one, several, and one as the risk is of. */
const EVENT_NAMES = {
  hit: ["hit", "hits", "a hit"],
  avoidable: ["avoidable hit", "avoidable hits", "an avoidable hit"],
  severe: ["severe hit", "severe hits", "a severe hit"],
  conflict: ["conflict", "conflicts", "a conflict"],
};
const COUNTS = { hit: "hits", avoidable: "avoidable", severe: "severe", conflict: "conflicts" };
const KIND_NAMES = {
  site: "movements and edges",
  movement: "movements",
  edge: "edges",
  junction: "junctions",
  lane: "lanes",
};

/** The page's state: one object a place, what is chosen, how it is ordered. */
const risk = {
  all: [],
  kind: "site",
  counted: "decided",
  event: "hit",
  sort: { column: "rank", down: false },
  picked: null,
  most: 100,
  every: false,
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
    row.events = row[COUNTS[event]];
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

/** Colour of a risk (0 to 1): of the last class that begins below. */
function riskColour(value, classes) {
  const [, colour] = classes.findLast(([low]) => value >= low) ?? classes[0];
  return `rgb(${colour.join(",")})`;
}

function percent(share) {
  return `${(100 * share).toFixed(0)} %`;
}
