// Tables of the map: kinds of conflict, and what was attacked and what never was.

const KIND_HEADINGS = [
  "kind",
  "attacks",
  "hits",
  "findings",
  "least TTC, s",
  "median TTC, s",
  "least PET, s",
  "median PET, s",
  "mean delta-v, m/s",
  "greatest delta-v, m/s",
];
const COVERED_NAMES = {
  movement: ["movement", "movements"],
  edge: ["edge", "edges"],
};

function showKinds() {
  const rows = risk.content.types.map(([meaning, kind, attacks, hits, found, judged, ...numbers]) => [
    make("span", { title: meaning }, kind),
    String(attacks),
    String(hits),
    hits ? `${found} of ${judged}` : "–",
    ...numbers.map((value) => fixed(value, 1)),
  ]);
  byId("kinds").replaceChildren(
    ...tableOf(KIND_HEADINGS, rows, KIND_HEADINGS.map((_, column) => column).slice(1)),
  );
}

/** The tables of evidence: what was attacked, how it went, and why something never was. */
function showEvidence() {
  const { evidence, evidenceHeadings, evidenceNote } = risk.content;
  const numbers = evidenceHeadings.map((_, column) => column).slice(1, -1);
  byId("evidence").replaceChildren(
    make("p", { class: "hint" }, evidenceNote),
    ...evidence.flatMap(([title, rows]) => [
      make("h3", {}, title),
      make(
        "div",
        { class: "wide" },
        make("table", { class: "cards" }, ...tableOf(evidenceHeadings, rows, numbers)),
      ),
    ]),
  );
}

/** A line a subject; what was never attacked unfolds. */
function showCovered() {
  const lines = risk.content.covered.map(([of, attacked, all, never]) => {
    const [one, many] = COVERED_NAMES[of];
    const head = `${attacked} of ${counted(all, one, many)} attacked`;
    if (attacked === all) return make("p", {}, head);
    const more = all - attacked - never.length;
    return make(
      "details",
      {},
      make("summary", {}, `${head}; never: ${all - attacked}`),
      make("ul", {}, ...never.map((name) => make("li", {}, name))),
      more ? make("p", { class: "hint" }, `and ${more} more in coverage.csv`) : null,
    );
  });
  byId("covered").replaceChildren(...lines);
}
