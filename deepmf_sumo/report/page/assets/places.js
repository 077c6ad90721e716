// The places of the risk map: which are shown, in which order, and the attacks at the one picked.

/** Names of an event: one, several, and one with its article. */
const EVENT_NAMES = {
  hit: ["hit", "hits", "a hit"],
  finding: ["finding", "findings", "a finding"],
  severe: ["severe hit", "severe hits", "a severe hit"],
  conflict: ["conflict", "conflicts", "a conflict"],
};
const COUNTS = { hit: "hits", finding: "findings", severe: "severe", conflict: "conflicts" };
const KIND_NAMES = {
  site: "movements and edges",
  movement: "movements",
  edge: "edges",
  junction: "junctions",
  lane: "lanes",
};
const COUNTED_NAMES = { decided: "was decided", began: "began" };

const WITHOUT_REPLAYS =
  "Replays are in report.html, which deepmf-sumo report OUT writes: its map links to them.";

/** What is shown of the open map: a row per place, what is chosen, the place that is picked. */
const risk = {
  content: null,
  all: [],
  kind: "site",
  counted: "decided",
  event: "hit",
  picked: null,
  optional: false,
  table: null,
};

function readPlaces(content) {
  const rows = rowsOf(content.values, content.rows);
  risk.all = rows.map((row) => ({ ...row, shape: content.shapes[row.number] }));
  risk.content = content;
  risk.picked = null;
}

function kindsShown() {
  return risk.kind === "site" ? ["movement", "edge"] : [risk.kind];
}

/** The places that are shown, with risk and rank of the chosen event. */
function shownPlaces() {
  const { counted, event } = risk;
  const found = risk.all
    .filter((row) => row.counted === counted && kindsShown().includes(row.kind))
    .map((row) => ({
      ...row,
      events: row[COUNTS[event]],
      risk: row[`risk_${event}`],
      risk_lo: row[`risk_${event}_lo`],
      risk_hi: row[`risk_${event}_hi`],
    }))
    .sort(
      (one, other) =>
        other.risk_lo - one.risk_lo || other.risk - one.risk || (one.place < other.place ? -1 : 1),
    );
  found.forEach((row, place) => {
    const before = found[place - 1];
    const equal = before && before.risk_lo === row.risk_lo && before.risk === row.risk;
    row.rank = equal ? before.rank : place + 1;
  });
  return risk.table.sorted(found);
}

function showPlaces(places) {
  const columns = risk.content.columns.filter(
    ({ name, optional }) =>
      (risk.optional || !optional) && (risk.kind === "site" || name !== "kind"),
  );
  risk.table.fill(columns, places, (row) => ({
    class: row.number === risk.picked ? "picked" : null,
  }));
  const all = kindsShown().reduce((sum, kind) => sum + risk.content.places[kind], 0);
  const nothing = risk.counted === "decided" ? "no attack was decided" : "no attack began";
  byId("places-shown").textContent =
    `${places.length} of ${all}` + (places.length < all ? `; at the others ${nothing}` : "");
}

/** The cells that are not plain values: the button that picks a place, the risk with its colour. */
function placeCell(row, column) {
  const { name, heading } = column;
  if (name === "title")
    return make(
      "td",
      { class: "name", "data-label": heading },
      make("button", { type: "button", onclick: () => pickPlace(row.number) }, row.title),
    );
  if (name !== "risk") return null;
  const swatch = row.events
    ? { class: "swatch", style: `background: ${riskColour(row.risk)}` }
    : { class: "swatch nothing" };
  return make(
    "td",
    { class: "number", "data-label": heading },
    make("i", swatch),
    numberText(row, column),
  );
}

function pickPlace(number) {
  risk.picked = number;
  showRisk();
  showPicked();
  byId("places").querySelector("tr.picked button")?.focus({ preventScroll: true });
}

/** The attacks at the place that is picked, each with a link where the page has its run. */
function showAttacks() {
  const row = risk.all[risk.picked];
  if (!row) {
    byId("place").replaceChildren(
      make("p", { class: "hint" }, "Pick a place on the map or in the list."),
    );
    return;
  }
  const here = risk.content.attacks.filter(
    ([, , , , spots]) => spots[row.counted][row.kind] === row.place,
  );
  const what = row.counted === "decided" ? "decided there" : "that began there";
  byId("place").replaceChildren(
    make("p", {}, `${row.title}: ${counted(here.length, "attack")} ${what}`),
    make("ul", {}, ...here.map(attackItem)),
    ...(runs.all.length ? [] : [make("p", { class: "hint" }, WITHOUT_REPLAYS)]),
  );
}

function attackItem([run, turn, , hit, , against, kind]) {
  const shown = runs.all.find((row) => row.run === run);
  const outcome = `: ${hit ? "hit" : "no hit"}${kind ? `, ${kind}` : ""}${against ? `; opponent at ${against}` : ""}`;
  return make(
    "li",
    {},
    shown ? make("a", { href: runAddress(shown) }, run) : run,
    `${turn === null ? "" : `, turn ${turn}`}${outcome}`,
  );
}

/** Colour of a risk (0 to 1): that of the last class that begins below it. */
function riskColour(value) {
  const { classes } = risk.content;
  const [, colour] = classes.findLast(([low]) => value >= low) ?? classes[0];
  return `rgb(${colour.join(",")})`;
}
