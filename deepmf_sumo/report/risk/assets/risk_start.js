// What happens when the page is opened.

function showChoices() {
  const field = (label, name, names) =>
    make(
      "label",
      {},
      label,
      choice(
        Object.keys(names),
        risk[name],
        (value) => {
          risk[name] = value;
          risk.picked = null;
          risk.show();
        },
        (value) => names[value],
      ),
    );
  const events = Object.fromEntries(Object.keys(risk.definitions).map((name) => [name, EVENT_NAMES[name][2]]));
  byId("choices").replaceChildren(
    field("places", "kind", KIND_NAMES),
    field("an attack counts where it", "counted", { decided: "was decided", began: "began" }),
    field("risk of", "event", events),
  );
}

function showNotices(content) {
  const left = Object.entries(content.leftOut).map(([reason, count]) => `${counted(count, "run")} ${reason}`);
  const notices = [];
  if (left.length) notices.push(`Not counted here: ${left.join(", ")}.`);
  const off = content.off[risk.counted];
  if (off) {
    const when = off === 1 ? "when it" : "when they";
    const event = risk.counted === "began" ? `${when} began` : `${when} ${off === 1 ? "was" : "were"} decided`;
    notices.push(
      `${counted(off, "attack is", "attacks are")} counted at no place: ${event}, the centre of the AV was ` +
        `neither on a lane nor inside a junction of the network.`,
    );
  }
  byId("notices").replaceChildren(...notices.map((text) => make("p", { class: "notice" }, text)));
}

/** As high as the network asks for: wide networks leave no empty bands. */
function shapeMap(content) {
  const [left, top, right, bottom] = boundsOf(content.roads) ?? [0, 0, 1, 1];
  const ratio = Math.max(right - left, 1) / Math.max(bottom - top, 1);
  byId("map").style.aspectRatio = Math.min(Math.max(ratio, 0.8), 4);
}

function start() {
  const content = JSON.parse(byId("content").textContent);
  readPlaces(content);
  risk.definitions = content.definitions;
  document.title = `${content.title} – deepmf-sumo risk map`;
  byId("title").textContent = `Risk map: ${content.title}`;
  byId("origin").textContent = `network ${content.network} · ${counted(content.attacks.length, "attack")}`;
  const pick = (number) => {
    risk.picked = number;
    risk.show();
    showPicked();
    byId("places").querySelector("tr.picked button")?.focus({ preventScroll: true });
  };
  risk.show = () => {
    const places = shownPlaces();
    showChoices();
    showNotices(content);
    drawMap(content, places, pick);
    showTable(places, pick, content);
    showAttacks(content);
    const kinds = risk.kind === "site" ? ["movement", "edge"] : [risk.kind];
    const all = kinds.reduce((sum, kind) => sum + content.places[kind], 0);
    const nothing = risk.counted === "decided" ? "no attack was decided" : "no attack began";
    byId("shown").textContent =
      `${places.length} of ${all}` + (places.length < all ? `; at the others ${nothing}` : "");
    const [one, , risky] = EVENT_NAMES[risk.event];
    byId("meaning").textContent =
      `${one[0].toUpperCase()}${one.slice(1)}: ${content.definitions[risk.event]}. Risk: estimated chance of ${risky} in an ` +
      `attack at the place, with its ${content.confidence} % interval. Few attacks say little, so it lies between ` +
      `the place's own rate and that of all places. Ranks go by the interval's lower end.`;
  };
  shapeMap(content);
  fitMap(content, false);
  steerMap(content);
  byId("every").addEventListener("change", (event) => {
    risk.every = event.target.checked;
    risk.show();
  });
  byId("more").addEventListener("click", () => {
    risk.most += 100;
    risk.show();
  });
  byId("choices").addEventListener("submit", (event) => event.preventDefault());
  risk.show();
}

start();
