// The risk map: roads, places coloured by risk, attacks.

/** Least sizes on the screen, in pixels: places of a town are smaller than a pixel. */
const LEAST = { road: 1, place: 4, nothing: 1.5, dot: 6, ring: 3 };
const DOT_BELOW = 14;
/** A place that is picked fills this part of the map; a view shows at least these metres. */
const PICKED_SHARE = 0.4,
  PICKED_M = 80,
  LEAST_M = 300;
/** What is drawn, to be fitted to the zoom. */
const sizes = { lines: [], dots: [], rings: [] };
let mapCamera = null;

function path(points, closed = false) {
  return (
    points.map(([x, y], place) => `${place ? "L" : "M"}${x} ${-y}`).join("") + (closed ? "Z" : "")
  );
}

/** The corners of lines [width, points]. */
function cornersOf(lines) {
  return lines.flatMap(([, points]) => points);
}

/** Show these bounds in a share of the map, and at least `least` metres. */
function fitMap(bounds, share = 0.92, least = LEAST_M) {
  if (!bounds) return;
  const [left, bottom, right, top] = bounds;
  const across = Math.max((right - left) / share, least),
    up = Math.max((top - bottom) / share, least);
  const x = (left + right) / 2,
    y = (bottom + top) / 2;
  mapCamera.fit([x - across / 2, y - up / 2, x + across / 2, y + up / 2]);
  applyView();
}

function fitNetwork() {
  fitMap(boundsOf(cornersOf(risk.content.roads)));
}

function fitAttacked() {
  const attacked = boundsOf(cornersOf(risk.all.flatMap((row) => row.shape)));
  fitMap(attacked ?? boundsOf(cornersOf(risk.content.roads)));
}

function applyView() {
  const { x, y, scale } = mapCamera,
    box = byId("map").getBoundingClientRect();
  const width = box.width / scale,
    height = box.height / scale;
  byId("map").setAttribute("viewBox", `${x - width / 2} ${-y - height / 2} ${width} ${height}`);
  for (const { element, width: metres, least, more } of sizes.lines)
    element.setAttribute("stroke-width", Math.max(metres, least / scale) + more / scale);
  for (const { element, extent } of sizes.dots) {
    element.setAttribute("r", extent * scale < DOT_BELOW ? LEAST.dot / scale : 0);
    element.setAttribute("stroke-width", 1.5 / scale);
  }
  for (const { element, hit } of sizes.rings) {
    element.setAttribute("r", Math.max(1.6, LEAST.ring / scale));
    element.setAttribute("stroke-width", (hit ? 2 : 1) / scale);
  }
}

function drawMap(places) {
  Object.assign(sizes, { lines: [], dots: [], rings: [] });
  const widths = new Map();
  for (const [width, points] of risk.content.roads)
    widths.set(width, (widths.get(width) ?? "") + path(points));
  const roads = [...widths].map(([width, d]) =>
    sized(drawn("path", { class: "road", d }), width, LEAST.road),
  );
  const order = ["junction", "edge", "lane", "movement"];
  // the worst are drawn last, and so lie on top
  const byRisk = (one, other) =>
    Boolean(one.events) - Boolean(other.events) || one.risk - other.risk;
  const sorted = [...places].sort(
    (one, other) => order.indexOf(one.kind) - order.indexOf(other.kind) || byRisk(one, other),
  );
  const spots = sorted.flatMap(drawPlace);
  const dots = sorted.sort(byRisk).map(drawDot).filter(Boolean);
  byId("map").replaceChildren(...roads, ...spots, ...dots, ...drawAttacks());
  showLegend();
  applyView();
}

/** A line that keeps a least width on the screen, with `more` pixels around it. */
function sized(element, width, least, more = 0) {
  sizes.lines.push({ element, width, least, more });
  return element;
}

function look(row, kind) {
  return `${kind}${row.events ? "" : " nothing"}${risk.picked === row.number ? " picked" : ""}`;
}

function tooltip(row) {
  const happened = EVENT_NAMES[risk.event][row.events === 1 ? 0 : 1];
  const estimate = row.events ? `; risk ${percent(row.risk)}` : "";
  return drawn(
    "title",
    {},
    `${row.title}: ${counted(row.attacks, "attack")}, ${row.events || "no"} ${happened}${estimate}`,
  );
}

function drawPlace(row) {
  const colour = row.events ? riskColour(row.risk) : null;
  const onclick = () => pickPlace(row.number);
  const shape = row.shape.filter(([, points]) => points.length);
  const widthOf = (width) => (!row.events ? 0 : row.kind === "movement" ? 1.4 : width);
  const least = row.events ? LEAST.place : LEAST.nothing;
  const halo = shape
    .filter(([width]) => width && risk.picked === row.number)
    .map(([width, points]) =>
      sized(drawn("path", { class: "halo", d: path(points) }), widthOf(width), least, 8),
    );
  const parts = shape.map(([width, points]) => {
    const fill = width ? null : colour,
      stroke = width ? colour : null;
    const kind = look(row, width ? "place" : "area");
    const attributes = { class: kind, d: path(points, !width), fill, stroke, onclick };
    const element = drawn("path", attributes, tooltip(row));
    return width ? sized(element, widthOf(width), least) : element;
  });
  return [...halo, ...parts];
}

/** A dot instead of a place that is too small to be seen. */
function drawDot(row) {
  const bounds = boundsOf(cornersOf(row.shape));
  if (!bounds) return null;
  const [left, bottom, right, top] = bounds;
  const middle = { cx: (left + right) / 2, cy: -(bottom + top) / 2, r: 0 };
  const fill = row.events ? riskColour(row.risk) : null;
  const onclick = () => pickPlace(row.number);
  const element = drawn(
    "circle",
    { class: look(row, "dot"), fill, ...middle, onclick },
    tooltip(row),
  );
  sizes.dots.push({ element, extent: Math.max(right - left, top - bottom) });
  return element;
}

/** A ring where each attack was decided. */
function drawAttacks() {
  return risk.content.attacks.map(([run, turn, [x, y], hit]) => {
    const name = turn === null ? run : `${run}, turn ${turn}`;
    const element = drawn(
      "circle",
      { class: hit ? "attack hit" : "attack", cx: x, cy: -y },
      drawn("title", {}, `${name}: ${hit ? "hit" : "no hit"}`),
    );
    sizes.rings.push({ element, hit });
    return element;
  });
}

/** What the colours mean: the same in every map. */
function showLegend() {
  const { classes } = risk.content;
  const [one, , risky] = EVENT_NAMES[risk.event];
  const key = (attributes, text) => make("span", {}, make("i", attributes), text);
  const bands = classes.map(([low, colour], place) => {
    const next = classes[place + 1]?.[0];
    const text =
      next === undefined
        ? `${percent(low)} and more`
        : place
          ? `${100 * low} to ${percent(next)}`
          : `under ${percent(next)}`;
    return key({ style: `background: rgb(${colour.join(",")})` }, text);
  });
  byId("legend").replaceChildren(
    make("strong", {}, `Risk of ${risky} in an attack:`),
    ...bands.reverse(),
    key({ class: "nothing" }, `attacked, no ${one}`),
    key({ class: "road" }, "no attack there"),
    key({ class: "ring hit" }, "where the AV was hit"),
    key({ class: "ring" }, "where it came nearest, no hit"),
  );
}

/** Show a place that was picked, with its surroundings. */
function showPicked() {
  const row = risk.all[risk.picked];
  if (!row) return;
  fitMap(boundsOf(cornersOf(row.shape)), PICKED_SHARE, PICKED_M);
  byId("map").scrollIntoView({ block: "nearest" });
}

/** Buttons, keys and pointer of the map. */
function steerMap() {
  mapCamera = new Camera(byId("map"), applyView, { Home: fitNetwork }, [1e-3, 60]);
  const buttons = {
    "Attacked places": fitAttacked,
    "Whole network": fitNetwork,
    "+": () => mapCamera.zoom(1.5),
    "−": () => mapCamera.zoom(1 / 1.5),
  };
  const labels = { "+": "Zoom in", "−": "Zoom out" };
  byId("steer").replaceChildren(
    ...Object.entries(buttons).map(([text, onclick]) =>
      make("button", { type: "button", "aria-label": labels[text], onclick }, text),
    ),
    make(
      "span",
      { class: "hint" },
      "Drag to move. After a click on the map the wheel zooms. A place that you pick is zoomed to.",
    ),
  );
}

/** As high as the network needs: wide networks leave no empty bands. */
function shapeMap() {
  const [left, bottom, right, top] = boundsOf(cornersOf(risk.content.roads)) ?? [0, 0, 1, 1];
  const ratio = Math.max(right - left, 1) / Math.max(top - bottom, 1);
  byId("map").style.aspectRatio = Math.min(Math.max(ratio, 0.8), 4);
}

function showMapChoices(content) {
  const field = (label, names, chosen, choose) =>
    make(
      "label",
      {},
      label,
      choice(Object.keys(names), chosen, choose, (value) => names[value]),
    );
  const set = (name) => (value) => {
    risk[name] = value;
    risk.picked = null;
    showRisk();
  };
  const events = Object.keys(risk.content.definitions);
  const eventNames = Object.fromEntries(events.map((name) => [name, EVENT_NAMES[name][2]]));
  const networks = { ...content.maps };
  byId("choices").replaceChildren(
    ...(content.maps.length > 1
      ? [field("network", networks, String(opened.map), (value) => openMap(Number(value), content))]
      : []),
    field("places", KIND_NAMES, risk.kind, set("kind")),
    field("an attack counts where it", COUNTED_NAMES, risk.counted, set("counted")),
    field("risk of", eventNames, risk.event, set("event")),
  );
}

function showMapNotices() {
  const { leftOut, off } = risk.content,
    notices = [];
  const left = Object.entries(leftOut).map(([why, count]) => `${counted(count, "run")} ${why}`);
  if (left.length) notices.push(`Not counted here: ${left.join(", ")}.`);
  const count = off[risk.counted];
  if (count) {
    const [are, they, were] = count === 1 ? ["is", "it", "was"] : ["are", "they", "were"];
    const event = risk.counted === "began" ? `${they} began` : `${they} ${were} decided`;
    notices.push(
      `${counted(count, "attack")} ${are} counted at no place: when ${event}, the centre of the ` +
        "AV was neither on a lane nor inside a junction of the network.",
    );
  }
  showTexts("map-notices", notices);
}

function showMeaning() {
  const { definitions, confidence } = risk.content,
    [one, , risky] = EVENT_NAMES[risk.event];
  byId("meaning").textContent =
    `${one[0].toUpperCase()}${one.slice(1)}: ${definitions[risk.event]}. Risk: estimated chance ` +
    `of ${risky} in an attack at the place, with its ${confidence} % interval. Few attacks say ` +
    "little, so it lies between the place's own rate and that of all places. Ranks go by the " +
    "interval's lower end.";
}

/** Draw all that depends on what is chosen and picked. */
function showRisk() {
  const places = shownPlaces();
  showMapNotices();
  showMeaning();
  drawMap(places);
  showPlaces(places);
  showAttacks();
}

/** Unpack a map, and show it. */
async function openMap(number, content) {
  if (opened.map === number) return;
  opened.map = number;
  readPlaces(await unpacked(stored(`map-${number}`)));
  risk.table ??= new SortedTable("places", showRisk, placeCell, { name: "rank", down: false });
  if (!mapCamera) steerMap();
  const attacks = counted(risk.content.attacks.length, "attack");
  byId("map-origin").textContent = `network ${risk.content.network} · ${attacks}`;
  showKinds();
  showEvidence();
  showCovered();
  shapeMap();
  fitAttacked();
  showMapChoices(content);
  showRisk();
}
