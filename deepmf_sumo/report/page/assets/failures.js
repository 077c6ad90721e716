// Failures in groups, the worst first: a sentence, how often, and the replay of an example.

const MOST_FAILURES = 6;
const BEFORE_S = 4;
const AFTER_S = 0.5;
const REST_S = 1;
const failures = { groups: [], causes: "", shown: MOST_FAILURES };

function showFailures() {
  const { groups, causes, shown } = failures;
  const apart = groups.findIndex((group) => group.apart);
  byId("failures-section").hidden = !runs.all.length;
  byId("failures").replaceChildren(
    ...(causes ? [make("p", { class: "causes" }, `${causes}.`)] : []),
    ...groups
      .slice(0, shown)
      .flatMap((group, number) => [
        ...(number === apart ? [make("h3", {}, "Apart: hits that are no findings")] : []),
        failureCard(group),
      ]),
    ...(groups.length ? [] : [make("p", {}, `No failure in ${counted(runs.all.length, "run")}.`)]),
    ...(groups.length > shown
      ? [
          make(
            "button",
            {
              type: "button",
              onclick: () => {
                failures.shown = groups.length;
                showFailures();
              },
            },
            `Show ${groups.length - shown} more`,
          ),
        ]
      : []),
  );
}

function failureCard(group) {
  const example = runs.all[group.runs[0]];
  const facts = group.facts.map(([name, value]) =>
    make("div", {}, make("dt", {}, name), make("dd", {}, value)),
  );
  return make(
    "article",
    { class: "failure" },
    group.replay ? moving(group.runs[0]) : null,
    make(
      "div",
      {},
      make(
        "h3",
        {},
        group.title,
        " ",
        make("span", { class: "count" }, `${group.runs.length} of ${counted(group.of, "run")}`),
      ),
      make("p", { class: "sentence" }, group.sentence),
      make("dl", {}, ...facts),
      make("p", {}, make("a", { href: runAddress(example) }, `Example: ${example.run}`)),
      otherRuns(group),
    ),
  );
}

function otherRuns(group) {
  if (group.runs.length < 2) return null;
  const links = group.runs
    .slice(1)
    .map((number) =>
      make("li", {}, make("a", { href: runAddress(runs.all[number]) }, runs.all[number].run)),
    );
  return make(
    "details",
    {},
    make("summary", {}, `${counted(links.length, "other run")}`),
    make("ul", {}, ...links),
  );
}

/** A small replay that begins when it is seen, and repeats; still for readers who want no motion. */
function moving(number) {
  const canvas = make("canvas", { role: "img", "aria-label": `Replay of ${runs.all[number].run}` });
  const watch = new IntersectionObserver(async ([entry]) => {
    if (!entry.isIntersecting) return;
    watch.disconnect();
    const details = await unpacked(stored(`run-${number}`));
    if (!details.replay) return;
    const road =
      typeof details.road === "number" ? await unpacked(stored(`road-${details.road}`)) : null;
    loop(canvas, sceneOf(details, road));
  });
  watch.observe(canvas);
  return canvas;
}

function loop(canvas, scene) {
  const contact = scene.decisive ?? scene.steps - 1;
  const first = Math.max(0, contact - BEFORE_S / scene.dt);
  const last = Math.min(scene.steps - 1, contact + AFTER_S / scene.dt);
  const bounds = nearBounds(scene, first, last);
  const layers = { map: true, lights: true, driven: true };
  const draw = (step) => {
    drawMoment(canvas, scene, fitting(canvas, bounds), step, layers, null);
  };
  draw(last);
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
  const steps = last - first;
  const round = steps + REST_S / scene.dt;
  const begun = performance.now();
  const advance = (now) => {
    if (!canvas.isConnected) return;
    if (canvas.clientWidth) draw(first + Math.min(((now - begun) / 1000 / scene.dt) % round, steps));
    requestAnimationFrame(advance);
  };
  requestAnimationFrame(advance);
}

/** What `drawMoment` needs of a camera, without anything that moves it. */
function fitting({ clientWidth, clientHeight }, [left, bottom, right, top]) {
  const scale = Math.min(clientWidth / (right - left), clientHeight / (top - bottom), 14) || 1;
  return { x: (left + right) / 2, y: (bottom + top) / 2, scale };
}

/** Bounds of AV and opponent in these steps. */
function nearBounds(scene, first, last) {
  const places = [];
  for (const agent of scene.main) {
    for (let step = Math.ceil(first); step <= last; step += 1) {
      const pose = poseAt(agent, step);
      if (pose) places.push([pose.x, pose.y]);
    }
  }
  return widened(boundsOf(places) ?? [0, 0, 0, 0], 8);
}
