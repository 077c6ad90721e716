// The map: roads, places coloured by risk, attacks.

const view = { x: 0, y: 0, width: 1, height: 1 };

function path(points, closed = false) {
  return points.map(([x, y], place) => `${place ? "L" : "M"}${x} ${-y}`).join("") + (closed ? "Z" : "");
}

/** Show all of the network. */
function fitMap(content) {
  const xs = [],
    ys = [];
  for (const [, points] of content.roads)
    for (const [x, y] of points) {
      xs.push(x);
      ys.push(-y);
    }
  const low = (values) => values.reduce((one, other) => Math.min(one, other), Infinity);
  const high = (values) => values.reduce((one, other) => Math.max(one, other), -Infinity);
  const margin = 10;
  view.x = low(xs) - margin;
  view.y = low(ys) - margin;
  view.width = high(xs) - low(xs) + 2 * margin;
  view.height = high(ys) - low(ys) + 2 * margin;
  applyView();
}

function applyView() {
  byId("map").setAttribute("viewBox", `${view.x} ${view.y} ${view.width} ${view.height}`);
}

function drawMap(content, places, pick) {
  const worst = Math.max(...places.map((row) => row.risk), 1e-9);
  const widths = new Map();
  for (const [width, points] of content.roads)
    widths.set(width, (widths.get(width) ?? "") + path(points));
  const roads = [...widths].map(([width, d]) => drawn("path", { class: "road", d, "stroke-width": width }));
  const order = ["junction", "edge", "lane", "movement"];
  const spots = [...places]
    .sort((one, other) => order.indexOf(one.kind) - order.indexOf(other.kind) || one.risk - other.risk)
    .flatMap((row) => drawPlace(row, riskColour(row.risk / worst, content.stops), pick));
  byId("map").replaceChildren(...roads, ...spots, ...drawAttacks(content));
  const gradient = content.stops.map((stop) => `rgb(${stop.join(",")})`).join(",");
  byId("legend").replaceChildren(
    make("span", { class: "scale", style: `background: linear-gradient(to right, ${gradient})` }),
    make("span", { class: "ends" }, make("span", {}, "risk 0"), make("span", {}, fixed(worst, 2))),
    make("span", {}, "rings: attacks; dark: hits"),
  );
}

function drawPlace(row, colour, pick) {
  const chosen = risk.picked === row.number ? " picked" : "";
  return row.shape
    .filter(([, points]) => points.length)
    .map(([width, points]) => {
      const title = drawn("title", {}, `${row.title}: ${row.hits} hits of ${row.attacks} attacks`);
      const listen = { onclick: () => pick(row.number) };
      return width
        ? drawn("path", { class: `place${chosen}`, d: path(points), stroke: colour,
            "stroke-width": row.kind === "movement" ? 1.4 : width, ...listen }, title)
        : drawn("path", { class: `area${chosen}`, d: path(points, true), fill: colour, ...listen }, title);
    });
}

/** A ring where each attack was decided. */
function drawAttacks(content) {
  return content.attacks.map(([run, [x, y], hit]) =>
    drawn(
      "circle",
      { class: hit ? "attack hit" : "attack", cx: x, cy: -y, r: 1.6, "stroke-width": hit ? 0.9 : 0.4 },
      drawn("title", {}, `${run}${hit ? ": hit" : ""}`),
    ),
  );
}

/** Wheel and keys zoom, dragging moves. */
function steerMap(content) {
  const map = byId("map");
  const zoom = (factor, x = 0.5, y = 0.5) => {
    view.x += view.width * (1 - factor) * x;
    view.y += view.height * (1 - factor) * y;
    view.width *= factor;
    view.height *= factor;
    applyView();
  };
  map.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const box = map.getBoundingClientRect();
      zoom(
        event.deltaY > 0 ? 1.2 : 1 / 1.2,
        (event.clientX - box.left) / box.width,
        (event.clientY - box.top) / box.height,
      );
    },
    { passive: false },
  );
  map.addEventListener("keydown", (event) => {
    if (event.key === "+") zoom(1 / 1.2);
    else if (event.key === "-") zoom(1.2);
    else if (event.key === "Home") fitMap(content);
  });
  map.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    const box = map.getBoundingClientRect();
    const scale = Math.max(view.width / box.width, view.height / box.height);
    view.x -= event.movementX * scale;
    view.y -= event.movementY * scale;
    applyView();
  });
}
