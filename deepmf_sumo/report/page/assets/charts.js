// Gap, time to collision and speeds over time.

const CHART = { width: 460, height: 150, left: 44, right: 10, top: 20, bottom: 22 };

/** Three drawings and a function that moves their cursors to a step. `seek` is called with a step. */
function chartsOf(scene, seek) {
  const end = scene.steps - 1;
  const speeds = scene.main.map((agent) => ({
    name: agent === scene.av ? "av" : "opponent",
    points: agent.speed.values.map((value, place) => [agent.speed.first + place, value]),
  }));
  const timeline = scene.timeline;
  const series = (values) => [
    { name: "", points: apart(timeline.step.map((step, place) => [step, values[place]])) },
  ];
  const charts = [
    chart(scene, end, "Speeds, m/s: AV (full), opponent (dashed)", speeds, null, seek),
  ];
  if (typeof timeline !== "string") {
    charts.unshift(
      chart(scene, end, "Gap between the boxes, m", series(timeline.gap), null, seek),
      chart(
        scene,
        end,
        "Time to collision, s (no line: none within 10 s)",
        series(timeline.ttc),
        10,
        seek,
      ),
    );
  }
  const note =
    typeof timeline === "string"
      ? make("p", { class: "hint" }, `No gap and time to collision: ${timeline}.`)
      : null;
  return {
    element: make("div", { class: "charts" }, note, ...charts.map((one) => one.element)),
    move: (step) => charts.forEach((one) => one.move(step)),
  };
}

function chart(scene, end, title, series, highest, seek) {
  const { width, height, left, right, top, bottom } = CHART;
  const values = series
    .flatMap((one) => one.points.map((point) => point[1]))
    .filter((value) => value !== null);
  const most = highest ?? Math.max(1, ...values) * 1.05;
  const x = (step) =>
    left + ((width - left - right) * (step - scene.now)) / Math.max(1, end - scene.now);
  const y = (value) => height - bottom - ((height - top - bottom) * value) / most;
  const cursor = drawn("line", { class: "cursor", y1: top, y2: height - bottom });
  const element = drawn(
    "svg",
    { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": described(title, values) },
    drawn("text", { x: left, y: 13 }, title),
    ...turnBands(scene, x, top, height - bottom),
    ...axes(scene, end, most, x, y),
    ...marks(scene).map(([name, step]) =>
      drawn(
        "line",
        { class: name, x1: x(step), x2: x(step), y1: top, y2: height - bottom },
        drawn("title", {}, name),
      ),
    ),
    ...series.map((one) =>
      drawn("path", {
        class: one.name,
        d: pathText(
          one.points.filter((point) => point[0] >= scene.now),
          x,
          y,
        ),
      }),
    ),
    cursor,
  );
  element.addEventListener("click", (event) => {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(
      element.getScreenCTM().inverse(),
    );
    seek(Math.round(scene.now + ((point.x - left) / (width - left - right)) * (end - scene.now)));
  });
  const move = (step) => {
    cursor.setAttribute("x1", x(Math.max(step, scene.now)));
    cursor.setAttribute("x2", x(Math.max(step, scene.now)));
  };
  return { element, move };
}

/** Steps that the charts mark. */
function marks(scene) {
  const contacts = scene.contacts.map((contact) => ["contact", contact.step]);
  return scene.onset === null ? contacts : [["onset", scene.onset], ...contacts];
}

/** Points with a break where steps are missing: between two turns. */
function apart(points) {
  return points.flatMap((point, place) =>
    place && point[0] > points[place - 1][0] + 1 ? [[point[0] - 1, null], point] : [point],
  );
}

function described(title, values) {
  if (!values.length) return `${title}: no values`;
  return `${title}: from ${Math.min(...values).toFixed(1)} to ${Math.max(...values).toFixed(1)}`;
}

function axes(scene, end, most, x, y) {
  const { width, height, left, right, bottom } = CHART;
  const marks = [0, most / 2, most].flatMap((value) => [
    drawn("line", { class: "axis", x1: left, x2: width - right, y1: y(value), y2: y(value) }),
    drawn(
      "text",
      { x: left - 5, y: y(value) + 4, "text-anchor": "end" },
      value.toFixed(most < 4 ? 1 : 0),
    ),
  ]);
  const seconds = (end - scene.now) * scene.dt;
  const every = [1, 2, 5, 10, 20, 60, 120].find((one) => seconds / one <= 10) ?? 300;
  for (let time = 0; time <= seconds + 1e-6; time += every) {
    marks.push(
      drawn(
        "text",
        {
          x: x(scene.now + time / scene.dt),
          y: height - bottom + 15,
          // the label at the right end must not be cut
          "text-anchor": x(scene.now + time / scene.dt) > width - 20 ? "end" : "middle",
        },
        `${time} s`,
      ),
    );
  }
  return marks;
}

/** A path that breaks where there is no value. */
function pathText(points, x, y) {
  let text = "",
    begun = false;
  for (const [step, value] of points) {
    if (value === null) {
      begun = false;
      continue;
    }
    text += `${begun ? "L" : "M"}${x(step).toFixed(1)} ${y(value).toFixed(1)}`;
    if (!begun) text += "h0.1"; // a single value is a dot
    begun = true;
  }
  return text;
}
