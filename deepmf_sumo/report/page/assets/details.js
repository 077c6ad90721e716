// An opened run.

const opened = { player: null, number: null, map: null };

/** Show a run by its number; its replay is unpacked only now. */
async function openRun(number, content) {
  closeRun();
  opened.number = number;
  const row = runs.all[number],
    page = byId("details");
  showView("details");
  page.replaceChildren(make("p", {}, "Loading …"));
  const details = await unpacked(stored(`run-${number}`));
  const road =
    typeof details.road === "number" ? await unpacked(stored(`road-${details.road}`)) : null;
  if (opened.number !== number) return; // the reader has opened another one
  const scene = details.replay ? sceneOf(details, road) : null;
  opened.player = scene ? new Player(scene) : null;
  page.replaceChildren(...pageElements(row, details, content));
  window.scrollTo(0, 0);
  page.focus({ preventScroll: true });
  opened.player?.draw();
}

function pageElements(row, details, content) {
  const { player } = opened;
  const notes = [row.note, details.road_note]
    .filter(Boolean)
    .map((note) => make("p", { class: "notice" }, note));
  const speed =
    row.collision_speed_mps === null
      ? ""
      : ` after ${fixed(row.collision_time_s, 1)} s at ${fixed(row.collision_speed_mps, 1)} m/s relative speed`;
  const kind = [row.sector, row.accident, row.element].filter(Boolean).join(", ");
  return [
    navigation(row),
    make("h2", {}, row.run),
    make(
      "p",
      {},
      `${row.status === "ok" ? row.outcome : row.status}${speed}${kind ? ` (${kind})` : ""}`,
    ),
    ...notes,
    ...(player ? [player.stage, make("h2", {}, "Over time"), player.charts.element] : []),
    ...[turnsOf(details, player)].filter(Boolean),
    ...(details.spec ? [commandsOf(row, details)] : []), // live attacks cannot be repeated
    factsOf(row, details, content),
    ...[metricsOf(details), eventsOf(details), ...textsOf(details)].filter(Boolean),
  ];
}

/** Back, and the runs before and behind it in the table as it is filtered. */
function navigation(row) {
  const listed = filteredRuns(),
    place = listed.indexOf(row);
  const link = (other, text) =>
    other ? make("a", { href: runAddress(other) }, text) : make("span", { class: "hint" }, text);
  return make(
    "nav",
    { "aria-label": "Runs" },
    make("a", { href: "#" }, "← All runs"),
    link(listed[place - 1], "previous"),
    link(place < 0 ? null : listed[place + 1], "next"),
    make(
      "span",
      { class: "hint" },
      place < 0 ? "not among the filtered runs" : `${place + 1} of ${listed.length}`,
    ),
  );
}

function runAddress(row) {
  return `#run=${encodeURIComponent(row.run)}`;
}

function closeRun() {
  opened.player?.stop();
  opened.player = null;
  opened.number = null;
}

/** Back to the table, to the run that was open. */
function showOverview() {
  const last = opened.number === null ? null : runs.all[opened.number];
  closeRun();
  showView("overview");
  if (!last) return;
  const links = [...byId("runs").querySelectorAll("a")];
  links.find((link) => link.getAttribute("href") === runAddress(last))?.focus();
}
