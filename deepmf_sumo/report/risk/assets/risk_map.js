// The map: roads, places coloured by risk, attacks.

const view = { x: 0, y: 0, width: 1, height: 1 };
/** Least sizes on the screen, in pixels: places of a town are smaller than a pixel. */
const LEAST = { road: 1, place: 4, nothing: 1.5, dot: 6, ring: 3 };
const DOT_BELOW = 14;
/** A place that is picked fills this part of the map, but no less is shown than so many metres. */
const PICKED_SHARE = 0.4,
  PICKED_M = 80;
/** What is drawn, to be fitted to the zoom. */
const sizes = { lines: [], dots: [], rings: [] };

function path(points, closed = false) {
  return points.map(([x, y], place) => `${place ? "L" : "M"}${x} ${-y}`).join("") + (closed ? "Z" : "");
}

/** [least x, least y, most x, most y] of lines, in the map's coordinates; null of none. */
function boundsOf(lines) {
  let bounds = null;
  for (const [, points] of lines)
    for (const [x, y] of points)
      bounds = bounds
        ? [Math.min(bounds[0], x), Math.min(bounds[1], -y), Math.max(bounds[2], x), Math.max(bounds[3], -y)]
        : [x, -y, x, -y];
  return bounds;
}

/** Show what lies in the bounds, and at least so many metres. */
function fitTo(bounds, share = 0.92, least = PICKED_M) {
  if (!bounds) return;
  const [left, top, right, bottom] = bounds;
  view.width = Math.max((right - left) / share, least);
  view.height = Math.max((bottom - top) / share, least);
  view.x = (left + right - view.width) / 2;
  view.y = (top + bottom - view.height) / 2;
  applyView();
}

/** All of the network, or the places with attacks. */
function fitMap(content, all) {
  const shown = all ? content.roads : risk.all.flatMap((row) => row.shape);
  fitTo(boundsOf(shown) ?? boundsOf(content.roads), 0.92, 300);
}

/** Pixels a metre. */
function mapScale() {
  const box = byId("map").getBoundingClientRect();
  return Math.min(box.width / view.width, box.height / view.height) || 1;
}

function applyView() {
  byId("map").setAttribute("viewBox", `${view.x} ${view.y} ${view.width} ${view.height}`);
  const scale = mapScale();
  for (const { element, width, least, more } of sizes.lines)
    element.setAttribute("stroke-width", Math.max(width, least / scale) + more / scale);
  for (const { element, extent } of sizes.dots) {
    element.setAttribute("r", extent * scale < DOT_BELOW ? LEAST.dot / scale : 0);
    element.setAttribute("stroke-width", 1.5 / scale);
  }
  for (const { element, hit } of sizes.rings) {
    element.setAttribute("r", Math.max(1.6, LEAST.ring / scale));
    element.setAttribute("stroke-width", (hit ? 2 : 1) / scale);
  }
}

function drawMap(content, places, pick) {
  Object.assign(sizes, { lines: [], dots: [], rings: [] });
  const widths = new Map();
  for (const [width, points] of content.roads)
    widths.set(width, (widths.get(width) ?? "") + path(points));
  const roads = [...widths].map(([width, d]) => sized(drawn("path", { class: "road", d }), width, LEAST.road));
  const order = ["junction", "edge", "lane", "movement"];
  // the worst are drawn last, and so lie on top
  const sorted = [...places].sort(
    (one, other) =>
      order.indexOf(one.kind) - order.indexOf(other.kind) ||
      Boolean(one.events) - Boolean(other.events) ||
      one.risk - other.risk,
  );
  const spots = sorted.flatMap((row) => drawPlace(row, content, pick));
  const dots = [...sorted]
    .sort((one, other) => Boolean(one.events) - Boolean(other.events) || one.risk - other.risk)
    .map((row) => drawDot(row, content, pick))
    .filter(Boolean);
  byId("map").replaceChildren(...roads, ...spots, ...dots, ...drawAttacks(content));
  showLegend(content);
  applyView();
}

/** A line whose width is kept up on the screen, with `more` pixels around it. */
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
  return drawn("title", {}, `${row.title}: ${counted(row.attacks, "attack")}, ${row.events || "no"} ${happened}${estimate}`);
}

function drawPlace(row, content, pick) {
  const colour = row.events ? riskColour(row.risk, content.classes) : null;
  const listen = { onclick: () => pick(row.number) };
  const shape = row.shape.filter(([, points]) => points.length);
  const widthOf = (width) => (!row.events ? 0 : row.kind === "movement" ? 1.4 : width);
  const least = row.events ? LEAST.place : LEAST.nothing;
  const halo = shape
    .filter(([width]) => width && risk.picked === row.number)
    .map(([width, points]) => sized(drawn("path", { class: "halo", d: path(points) }), widthOf(width), least, 8));
  const parts = shape.map(([width, points]) => {
    if (!width)
      return drawn("path", { class: look(row, "area"), d: path(points, true), fill: colour, ...listen }, tooltip(row));
    const line = drawn("path", { class: look(row, "place"), d: path(points), stroke: colour, ...listen }, tooltip(row));
    return sized(line, widthOf(width), least);
  });
  return [...halo, ...parts];
}

/** What stands for a place as long as that is too small to be seen. */
function drawDot(row, content, pick) {
  const bounds = boundsOf(row.shape);
  if (!bounds) return null;
  const [left, top, right, bottom] = bounds;
  const middle = { cx: (left + right) / 2, cy: (top + bottom) / 2, r: 0 };
  const colour = row.events ? riskColour(row.risk, content.classes) : null;
  const listen = { onclick: () => pick(row.number) };
  const element = drawn("circle", { class: look(row, "dot"), fill: colour, ...middle, ...listen }, tooltip(row));
  sizes.dots.push({ element, extent: Math.max(right - left, bottom - top) });
  return element;
}

/** A ring where each attack was decided. */
function drawAttacks(content) {
  return content.attacks.map(([run, [x, y], hit]) => {
    const element = drawn(
      "circle",
      { class: hit ? "attack hit" : "attack", cx: x, cy: -y },
      drawn("title", {}, `${run}: ${hit ? "hit" : "no hit"}`),
    );
    sizes.rings.push({ element, hit });
    return element;
  });
}

/** What the colours stand for: the same in every map. */
function showLegend(content) {
  const { classes } = content;
  const key = (attributes, text) => make("span", {}, make("i", attributes), text);
  const bands = classes.map(([low, colour], place) => {
    const next = classes[place + 1]?.[0];
    const text = next === undefined ? `${percent(low)} and more` : place ? `${100 * low} to ${percent(next)}` : `under ${percent(next)}`;
    return key({ style: `background: rgb(${colour.join(",")})` }, text);
  });
  byId("legend").replaceChildren(
    make("strong", {}, `Risk of ${EVENT_NAMES[risk.event][2]} in an attack:`),
    ...bands.reverse(),
    key({ class: "nothing" }, `attacked, no ${EVENT_NAMES[risk.event][0]}`),
    key({ class: "road" }, "no attack there"),
    key({ class: "ring hit" }, "where the AV was hit"),
    key({ class: "ring" }, "where it came nearest, no hit"),
  );
}

/** Show a place that was picked, with what is around it. */
function showPicked() {
  const row = risk.all[risk.picked];
  if (!row) return;
  fitTo(boundsOf(row.shape), PICKED_SHARE);
  byId("map").scrollIntoView({ block: "nearest" });
}

function zoomMap(factor, clientX = null, clientY = null) {
  const box = byId("map").getBoundingClientRect(),
    scale = mapScale();
  // metres from the middle of the map, which stays in the middle of the view
  const off = (client, low, size) => (client === null ? 0 : (client - low - size / 2) / scale);
  const x = view.x + view.width / 2 + off(clientX, box.left, box.width);
  const y = view.y + view.height / 2 + off(clientY, box.top, box.height);
  view.x = x + (view.x - x) * factor;
  view.y = y + (view.y - y) * factor;
  view.width *= factor;
  view.height *= factor;
  applyView();
}

/** Wheel and keys zoom, dragging moves. */
function steerMap(content) {
  const map = byId("map");
  map.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && document.activeElement !== map) return; // the page scrolls
      event.preventDefault();
      zoomMap(event.deltaY > 0 ? 1.2 : 1 / 1.2, event.clientX, event.clientY);
    },
    { passive: false },
  );
  map.addEventListener("keydown", (event) => {
    if (event.key === "+") zoomMap(1 / 1.2);
    else if (event.key === "-") zoomMap(1.2);
    else if (event.key === "Home") fitMap(content, true);
  });
  let moved = 0;
  map.addEventListener("pointerdown", () => {
    moved = 0;
  });
  map.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    moved += Math.abs(event.movementX) + Math.abs(event.movementY);
    const scale = mapScale();
    view.x -= event.movementX / scale;
    view.y -= event.movementY / scale;
    applyView();
  });
  // the end of a drag picks nothing
  map.addEventListener("click", (event) => moved > 4 && event.stopPropagation(), true);
  const buttons = {
    "Attacked places": () => fitMap(content, false),
    "Whole network": () => fitMap(content, true),
    "+": () => zoomMap(1 / 1.5),
    "−": () => zoomMap(1.5),
  };
  const labels = { "+": "Zoom in", "−": "Zoom out" };
  byId("steer").replaceChildren(
    ...Object.entries(buttons).map(([text, onclick]) =>
      make("button", { type: "button", "aria-label": labels[text], onclick }, text),
    ),
    make("span", { class: "hint" }, "Drag to move. After a click on the map the wheel zooms. A place that you pick is zoomed to."),
  );
  window.addEventListener("resize", applyView);
}
